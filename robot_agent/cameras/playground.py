"""The camera of a robot in asebaplayground: the simulator's picture of the playground's poses, by the wall clock."""

from __future__ import annotations

import time
from collections.abc import Callable

from protocol import Intrinsics
from robot_agent.cameras.base import CameraFrame
from robot_agent.playground.world import PlaygroundWorld


class PlaygroundCamera:
    """Implements Camera; `capture_s` is the clock's. Closing it ends the playground."""

    def __init__(
        self,
        world: PlaygroundWorld,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.width, self.height, self.fps = world.width, world.height, world.fps
        self.intrinsics: Intrinsics | None = world.intrinsics
        self._world, self._clock, self._sleep = world, clock, sleep
        self._due_s = clock()

    def begin(self) -> None:
        """Let the scenario start."""
        self._world.start()

    def read(self, timeout_s: float) -> CameraFrame | None:
        """Wait for the next frame. None when it is not due in time. Raises CameraError when the playground is gone."""
        wait_s = self._due_s - self._clock()
        if wait_s > 0.0:
            self._sleep(min(wait_s, timeout_s))
            if wait_s > timeout_s:
                return None
        # A machine that is too slow gets fewer frames instead of falling behind.
        self._due_s = max(self._due_s + 1.0 / self.fps, self._clock())
        return self._world.capture()

    def close(self) -> None:
        """End the playground and its programs."""
        self._world.close()
