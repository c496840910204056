"""The playground's world: a stage whose robots live in asebaplayground, drawn by the simulator's engine.

The follower is wherever the playground says, moved by its own Aseba program's motors; the leader, and a follower that
somebody holds, are put where the stage wants them. The engine is never stepped: it draws and measures only.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack

import cv2

from protocol import Intrinsics, Scenario
from robot_agent.cameras.base import CameraFrame
from robot_agent.errors import AgentError, CameraError
from robot_agent.playground.bodies import find_bodies
from robot_agent.playground.description import playground_file
from robot_agent.playground.programs import END_S, Programs
from robot_agent.robots.aseba import BusCalls
from robot_agent.sim.scene import Scene

_TOUCH_M = 0.005
"""Nearer than this counts as a contact: the playground lets nothing overlap, and its robots' outline differs a little
from the engine's."""
_EPISODE_GAP_S = 0.2


class PlaygroundWorld:
    """Starts the programs; `close` ends them. `start` may be called from any thread, the rest from the camera's."""

    def __init__(
        self,
        *,
        scenario: str,
        seed: int,
        width: int = 640,
        height: int = 480,
        fps: float = 30.0,
        noise_sigma: float = 2.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Raises AgentError as Scene does, and when a program is missing or does not come up."""
        self.width, self.height, self.fps = width, height, fps
        self._clock = clock
        self._scene = Scene(scenario=scenario, seed=seed, width=width, height=height, fps=fps, noise_sigma=noise_sigma)
        self.intrinsics: Intrinsics = self._scene.intrinsics
        self.scenario: Scenario = self._scene.announcement
        self._stage = stage = self._scene.stage
        self._started_s: float | None = None
        self._held = stage.held(0.0) is not None
        self._collisions = 0
        self._last_touch_s = -math.inf
        self._drawing = threading.Lock()
        self._closed = False
        with ExitStack() as opened:
            opened.callback(self._scene.engine.close)
            self.programs = Programs(
                lambda follower, leader: playground_file(stage, follower_port=follower, leader_port=leader)
            )
            opened.callback(self.programs.close)
            bus = BusCalls(self.programs.bus)
            opened.callback(bus.close)
            starts = [stage.robot_start] if stage.leader is None else [stage.robot_start, stage.leader(0.0)]
            self._follower, *leaders = find_bodies(bus, starts)
            self._leader = leaders[0] if leaders else None
            self._release = opened.pop_all().close

    def start(self) -> None:
        """Let the scenario begin: the leader drives off. Later calls do nothing."""
        if self._started_s is None:
            self._started_s = self._clock()

    def capture(self) -> CameraFrame:
        """Move who is moved, look where everybody is, draw it. Raises CameraError when the playground is gone."""
        with self._drawing:
            if self._closed:
                raise CameraError("The playground is closed; start the agent again.")
            try:
                return self._capture()
            except CameraError:
                raise
            except AgentError as error:
                # Its connections end before the process does.
                why = self.programs.why_ended("asebaplayground", within_s=END_S) or str(error)
                raise CameraError(f"The playground is gone: {why}") from error

    def close(self) -> None:
        """End the programs and free the drawing resources."""
        with self._drawing:
            if not self._closed:
                self._closed = True
                self._release()

    def _capture(self) -> CameraFrame:
        engine, stage = self._scene.engine, self._stage
        scenario_s = 0.0 if self._started_s is None else self._clock() - self._started_s
        if self._leader is not None and stage.leader is not None:
            self._leader.place(stage.leader(scenario_s))
            engine.place_leader(self._leader.pose())
        self._hold(scenario_s)
        self._scene.move_background(scenario_s)
        engine.place_robot(self._follower.pose())
        capture_s = self._clock()
        engine.refresh()
        self._count_collisions(capture_s)
        truth = self._scene.truth(self._collisions)
        engine.aim()
        image, light = engine.draw(), stage.light(scenario_s)
        if light != 1.0:
            image = cv2.convertScaleAbs(image, alpha=light)
        return CameraFrame(image=self._scene.noisy(image), capture_s=capture_s, truth=truth)

    def _hold(self, scenario_s: float) -> None:
        """Where the stage holds the follower, and once where it is set down."""
        held = self._stage.held(scenario_s)
        if held is not None:
            self._follower.place(held)
        elif self._held and self._stage.set_down is not None:
            self._follower.place(self._stage.set_down)
        self._held = held is not None

    def _count_collisions(self, now_s: float) -> None:
        """Contacts closer together than a moment are one collision."""
        if self._held or self._scene.engine.clearance_m(2.0 * _TOUCH_M) > _TOUCH_M:
            return
        self._collisions += now_s - self._last_touch_s > _EPISODE_GAP_S
        self._last_touch_s = now_s
