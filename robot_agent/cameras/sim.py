"""The simulated camera. It is also what makes simulated time pass: with the wall clock, or one frame period per read.

In real time the world advances in slices of a few milliseconds, so that a wheel command acts almost at once. A machine
that is too slow loses simulated time instead of falling ever further behind.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from protocol import Intrinsics
from robot_agent.cameras.base import CameraFrame
from robot_agent.sim.world import World

_SLICE_S = 0.004
_MAX_CATCH_UP_S = 0.1
_SAME_TIME_S = 1e-6


class SimCamera:
    """Pictures from a world's robot. Implements Camera; `capture_s` is simulated time."""

    def __init__(
        self,
        world: World,
        *,
        realtime: bool = True,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """`realtime`: keep step with `clock`; otherwise each read advances the world by exactly one frame period (a
        lost frame by another one), the first read by none."""
        self.width, self.height, self.fps = world.width, world.height, world.fps
        self.intrinsics: Intrinsics | None = world.intrinsics
        self._world, self._realtime, self._clock, self._sleep = world, realtime, clock, sleep
        self._first_s = world.time_s
        self._next_frame = 0
        self._moments: list[float] = []
        """Simulated times of the exposures that the next frame still needs, the last one its capture."""
        self._zero_s: float | None = None
        """What the wall clock showed when simulated time was zero, lost ground included."""

    def begin(self) -> None:
        """Let the scenario start."""
        self._world.start()

    def read(self, timeout_s: float) -> CameraFrame | None:
        """Wait for the next frame that is not lost. None when none came in time; in lockstep only when the camera
        hangs. Raises CameraError after `close`."""
        deadline_s = self._clock() + timeout_s
        while not self._world.camera_hangs:
            if not self._expose(deadline_s):
                return None
            frame = self._world.capture()
            if frame is not None:
                return frame
        if self._realtime:
            self._keep_step(math.inf, deadline_s)
        else:
            self._sleep(timeout_s)
        return None

    def close(self) -> None:
        """Free the world's drawing resources."""
        self._world.close()

    def _expose(self, deadline_s: float) -> bool:
        """Advance to the next frame's capture, exposing on the way. False when the deadline comes first; the next call
        goes on from there."""
        if not self._moments:
            frame_s = self._next_frame_s()
            self._moments = [*(frame_s - before_s for before_s in self._world.exposure_times_s), frame_s]
        while True:
            if not self._advance_to(self._moments[0], deadline_s):
                return False
            del self._moments[0]
            if not self._moments:
                return True
            self._world.expose()

    def _next_frame_s(self) -> float:
        passed = math.ceil((self._world.time_s - self._first_s) * self.fps - 1e-6)
        due = max(self._next_frame, passed)
        self._next_frame = due + 1
        return self._first_s + due / self.fps

    def _advance_to(self, time_s: float, deadline_s: float) -> bool:
        if self._realtime:
            return self._keep_step(time_s, deadline_s)
        self._world.advance_to(time_s)
        return True

    def _keep_step(self, time_s: float, deadline_s: float) -> bool:
        """Let simulated time follow the wall clock up to `time_s`. False when the deadline comes first."""
        while (now_s := self._world.time_s) < time_s - _SAME_TIME_S:
            clock_s = self._clock()
            if clock_s >= deadline_s:
                return False
            if self._zero_s is None:
                self._zero_s = clock_s - now_s
            behind_s = clock_s - self._zero_s - now_s
            if behind_s > _MAX_CATCH_UP_S:
                self._zero_s += behind_s - _MAX_CATCH_UP_S
            slice_s = min(_SLICE_S, time_s - now_s)
            if behind_s < slice_s - _SAME_TIME_S:
                self._sleep(min(slice_s - behind_s, deadline_s - clock_s))
            else:
                self._world.advance_to(now_s + slice_s)
        return True
