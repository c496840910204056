"""A Thymio II over D-Bus and asebamedulla, as the thesis drives it (listing A.1), without ever waiting for the bus.

Wheel targets are written when they change and when the write before was answered, so the bus sets the pace and the
newest target wins. Sensors are asked for in turn, one question under way at a time. While the robot is away its wheels
are unknown: `state` says so, the supervisor stops, and after its return it is stopped first and then obeys again.
"""

from __future__ import annotations

import functools
import itertools
import logging
import threading
import time
from collections.abc import Callable, Iterator

from protocol import RobotLimits
from robot_agent.errors import AgentError
from robot_agent.robots.aseba import AsebaBus
from robot_agent.robots.base import RobotState

log = logging.getLogger(__name__)

LEFT_TARGET, RIGHT_TARGET = "motor.left.target", "motor.right.target"
PROXIMITY = "prox.horizontal"
SLOW_SENSORS = ("prox.ground.delta", "acc", "button.center", "motor.left.speed", "motor.right.speed")
"""Read one per turn between two readings of the proximity sensors."""
POLL_S = 0.02
CONFIRM_S = 2.0
FIND_S = 5.0
STALE_S = 0.6
"""Sensor readings older than this are none."""


class ThymioRobot:
    """Implements Robot. Raises AgentError when the node is not found within some seconds.

    `trim`: right wheel's speed over left's at equal targets; the targets are corrected by it.
    """

    kind = "thymio"
    limits = RobotLimits()

    def __init__(
        self,
        *,
        bus: str = "session",
        node: str = "thymio-II",
        trim: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock, self._trim = clock, trim
        self._lock = threading.Lock()
        self._wanted = (0, 0)
        self._written: tuple[int, int] | None = None
        self._writing = False
        self._asking = False
        self._readings: dict[str, tuple[float, list[int]]] = {}
        self._turn: Iterator[str] = itertools.cycle(())
        self._found = threading.Event()
        self._bus = AsebaBus(bus=bus, node=node, listener=self)
        self._bus.call_every(POLL_S, self._ask)
        if not self._found.wait(FIND_S):
            why = self._bus.why_absent
            self._bus.close()
            raise AgentError(f"No Thymio: {why}. Plug it in, switch it on, and start asebamedulla.")

    # -- Robot (any thread) ----------------------------------------------------------------------------------------

    def set_wheels(self, left: int, right: int) -> None:
        """See Robot. Returns at once; the bus's thread writes."""
        right = max(-self.limits.max_units, min(self.limits.max_units, round(right / self._trim)))
        with self._lock:
            changed, self._wanted = (left, right) != self._wanted, (left, right)
        if changed:
            self._bus.call_soon(self._write)

    def state(self) -> RobotState:
        """See Robot."""
        left, right = self._reading("motor.left.speed"), self._reading("motor.right.speed")
        proximity = self._reading(PROXIMITY)
        return RobotState(
            proximity=tuple(proximity) if proximity is not None else None,
            ground=_pair(self._reading("prox.ground.delta")),
            acceleration=_triple(self._reading("acc")),
            button=bool(pressed[0]) if (pressed := self._reading("button.center")) else False,
            wheels_measured=(left[0], right[0]) if left and right else None,
            problem=self._problem(proximity),
        )

    def close(self) -> None:
        """Stop the wheels, read back that they stand, let go of the bus."""
        self.set_wheels(0, 0)
        if self._found.is_set() and not self._confirm_stop():
            log.error(
                "the robot did not confirm that its wheels stand: %s", self._bus.why_absent or "no answer in time"
            )
        self._bus.close()

    def _problem(self, proximity: list[int] | None) -> str:
        if self._bus.why_absent:
            return f"the robot is away, its wheels are unknown: {self._bus.why_absent}"
        return "" if proximity is not None else "the robot's sensors do not answer"

    def _reading(self, variable: str) -> list[int] | None:
        with self._lock:
            read_s, values = self._readings.get(variable, (float("-inf"), []))
        return values if self._clock() - read_s < STALE_S else None

    def _confirm_stop(self) -> bool:
        stopped = threading.Event()

        def check() -> None:
            self._bus.get(LEFT_TARGET, check_right, lambda why: None)

        def check_right(left: list[int]) -> None:
            if left == [0]:
                self._bus.get(RIGHT_TARGET, lambda right: stopped.set() if right == [0] else None, lambda why: None)

        deadline_s = time.monotonic() + CONFIRM_S
        while time.monotonic() < deadline_s and not self._bus.why_absent:
            self._bus.call_soon(check)
            if stopped.wait(0.2):
                return True
        return False

    # -- the bus's thread ------------------------------------------------------------------------------------------

    def node_found(self, variables: frozenset[str]) -> None:
        """Whatever the robot was doing: it stands first."""
        self._turn = itertools.cycle([name for name in SLOW_SENSORS if name in variables] or [PROXIMITY])
        self._asking = self._writing = False
        self._written = None
        self._write()
        self._found.set()

    def node_lost(self, why: str) -> None:
        """Nothing is known of it any more."""
        with self._lock:
            self._wanted = (0, 0)
            self._readings.clear()
        self._written, self._writing, self._asking = None, False, False

    def _write(self) -> None:
        with self._lock:
            wanted = self._wanted
        if self._writing or wanted == self._written or self._bus.why_absent:
            return
        self._writing = True
        waiting = {LEFT_TARGET, RIGHT_TARGET}

        def done(name: str) -> None:
            waiting.discard(name)
            if not waiting:
                self._writing, self._written = False, wanted
                self._write()

        def failed(why: str) -> None:
            log.warning("the robot did not take its wheel speeds: %s", why)
            self._writing, self._written = False, None

        for name, value in zip((LEFT_TARGET, RIGHT_TARGET), wanted, strict=True):
            self._bus.set(name, [value], functools.partial(done, name), failed)

    def _ask(self) -> None:
        """Read the proximity sensors, then one of the slower ones; the next round begins when both have answered."""
        if self._bus.why_absent or self._asking:
            return
        self._asking = True
        self._write()  # a write that failed is tried again
        self._bus.get(PROXIMITY, self._ask_slow_sensor, self._not_answered)

    def _ask_slow_sensor(self, proximity: list[int]) -> None:
        self._keep(PROXIMITY, proximity)
        name = next(self._turn)

        def take(values: list[int]) -> None:
            self._keep(name, values)
            self._asking = False

        self._bus.get(name, take, self._not_answered)

    def _not_answered(self, why: str) -> None:
        self._asking = False

    def _keep(self, name: str, values: list[int]) -> None:
        with self._lock:
            self._readings[name] = (self._clock(), values)


def _pair(values: list[int] | None) -> tuple[int, int] | None:
    return (values[0], values[1]) if values is not None and len(values) >= 2 else None


def _triple(values: list[int] | None) -> tuple[int, int, int] | None:
    return (values[0], values[1], values[2]) if values is not None and len(values) >= 3 else None
