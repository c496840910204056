"""What a Thymio II's variables mean, whichever way they come: the part that both of its drivers share.

A driver brings the variables' values in (`keep`) and takes wheel targets and the colour of the lights out, in a thread
of its own. While the robot is away its wheels are unknown: `state` says so, the supervisor stops, and after its return
it is stopped first and then obeys again. The names are those of the firmware's variables (aseba-target-thymio2).
"""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from protocol import RobotLimits
from robot_agent.errors import AgentError
from robot_agent.robots.base import RobotState
from robot_agent.settings_file import RobotSettings

log = logging.getLogger(__name__)

LEFT_TARGET, RIGHT_TARGET = "motor.left.target", "motor.right.target"
LEFT_SPEED, RIGHT_SPEED = "motor.left.speed", "motor.right.speed"
PROXIMITY, GROUND, ACCELERATION = "prox.horizontal", "prox.ground.delta", "acc"
BUTTON, BATTERY = "button.center", "_vbat"
LIGHT = "leds.top"
"""Firmware of 2020 has the lights as variables; older firmware, and asebaplayground, only as functions that a program
on the robot may call. No program is put there for their sake: it would take the place of the user's own."""
COLOURS = {"tracking": (0, 32, 0), "lost": (32, 12, 0), "idle": (0, 0, 32), "stopped": (32, 0, 0)}
"""Red, green, blue, each up to 32."""
DARK = (0, 0, 0)

BATTERY_PER_VOLT = 397.8
"""Sum of `_vbat`'s two readings per volt: 3978 for 10 V, as the firmware itself reckons for its battery lights."""
CONFIRM_S = 2.0
FIND_S = 5.0
STALE_S, SLOW_STALE_S = 0.6, 1.0
"""Readings of the proximity sensors, and of the others, that are older than this are none."""
BATTERY_STALE_S = 30.0
"""The battery is asked for seldom, and changes slowly."""


class ThymioNode(ABC):
    """Implements Robot, but for how the variables come and go.

    `trim`: right wheel's speed over left's at equal targets; the targets are corrected by it. Raises AgentError when it
    is out of range.
    """

    limits = RobotLimits()
    if_silent = ""
    """What a person may do about a robot that is there and does not answer, in words after a sentence."""

    def __init__(self, *, trim: float, clock: Callable[[], float]) -> None:
        self._trim, self._clock = RobotSettings(trim=trim).trim, clock
        self._lock = threading.Lock()
        self._wanted = (0, 0)
        self._colour = COLOURS["stopped"]
        self._readings: dict[str, tuple[float, list[int]]] = {}
        self._found, self._stands, self._closed = threading.Event(), threading.Event(), False
        self.why_absent = "looking for the robot"
        """Why the robot is not there, in words; empty while it is."""

    # -- Robot (any thread) ----------------------------------------------------------------------------------------

    def set_wheels(self, left: int, right: int) -> None:
        """See Robot. Returns at once; the driver's thread writes."""
        wanted = self._trimmed(left, right)
        with self._lock:
            changed, self._wanted = wanted != self._wanted, wanted
        if changed:
            self._write_soon()

    def show(self, what: str) -> None:
        """Light the robot for one of COLOURS; anything else: dark."""
        with self._lock:
            self._colour = COLOURS.get(what, DARK)
        self._write_soon()

    def state(self) -> RobotState:
        """See Robot."""
        proximity = self._reading(PROXIMITY, stale_s=STALE_S)
        button = self._reading(BUTTON, 1)
        battery = self._reading(BATTERY, 2, BATTERY_STALE_S)
        return RobotState(
            proximity=tuple(proximity) if proximity is not None else None,
            ground=_pair(self._reading(GROUND, 2)),
            acceleration=_triple(self._reading(ACCELERATION, 3)),
            button=button is not None and button[0] != 0,
            wheels_measured=self._wheels_measured(),
            battery_v=sum(battery[:2]) / BATTERY_PER_VOLT if battery is not None else None,
            problem=self._problem(proximity),
        )

    def close(self) -> None:
        """Stop the wheels, read back that they stand, darken the lights, let go of the robot."""
        if self._closed:
            return
        self._closed = True
        self.set_wheels(0, 0)
        self.show("nothing")
        if self._found.is_set() and not self._confirm_stop():
            log.error("the robot did not confirm that its wheels stand: %s", self.why_absent or "no answer in time")
        self._disconnect()

    def _wait_until_found(self, advice: str) -> None:
        """At the end of construction. Raises AgentError, having let go, when the robot does not turn up."""
        if not self._found.wait(FIND_S):
            why = self.why_absent
            self._disconnect()
            raise AgentError(f"No Thymio: {why}. {advice}")

    def _confirm_stop(self) -> bool:
        deadline_s = time.monotonic() + CONFIRM_S
        self._stands.clear()
        while time.monotonic() < deadline_s and not self.why_absent:
            self._read_back()
            if self._stands.wait(0.2):
                return True
        return False

    def _trimmed(self, left: float, right: float) -> tuple[int, int]:
        """Targets that give these speeds, scaled by one factor to the robot's limit: the curve stays."""
        right = right / self._trim
        factor = min(1.0, self.limits.max_units / max(abs(left), abs(right), 1.0))
        return round(left * factor), round(right * factor)

    def _wheels_measured(self) -> tuple[int, int] | None:
        """As the motors tell, in units of the left wheel: equal numbers mean straight ahead."""
        left, right = self._reading(LEFT_SPEED, 1), self._reading(RIGHT_SPEED, 1)
        return (left[0], round(right[0] * self._trim)) if left is not None and right is not None else None

    def _problem(self, proximity: list[int] | None) -> str:
        if why := self.why_absent:
            return f"the robot is away, its wheels are unknown: {why}"
        return "" if proximity is not None else f"the robot does not answer, its wheels are unknown{self.if_silent}"

    def _reading(self, variable: str, count: int = 0, stale_s: float = SLOW_STALE_S) -> list[int] | None:
        """The variable's newest values; None when they are old, or fewer than `count`."""
        with self._lock:
            read_s, values = self._readings.get(variable, (float("-inf"), []))
        return values if self._clock() - read_s < stale_s and len(values) >= count else None

    # -- for the driver, in its thread -----------------------------------------------------------------------------

    def wanted(self) -> tuple[tuple[int, int], tuple[int, int, int]]:
        """The wheel targets and the colour that the robot is to have now."""
        with self._lock:
            return self._wanted, self._colour

    def keep(self, variable: str, values: list[int]) -> None:
        """The robot has told these values."""
        with self._lock:
            self._readings[variable] = (self._clock(), values)

    def has_come(self) -> None:
        """The robot is there, and whatever it was doing: the driver stops it first."""
        self.why_absent = ""
        self._found.set()

    def has_gone(self, why: str) -> None:
        """Nothing is known of it any more, and what was wanted is not wanted on its return."""
        if why != self.why_absent:
            if self._found.is_set():  # until then construction waits, and tells the reason itself
                log.warning("robot: %s", why)
            self.why_absent = why
        with self._lock:
            self._wanted = (0, 0)
            self._readings.clear()

    def targets_read_back(self, left: Sequence[int], right: Sequence[int]) -> None:
        """What the robot answered when it was asked (`_read_back`) for its wheel targets."""
        if list(left) == [0] and list(right) == [0]:
            self._stands.set()

    # -- the driver's ----------------------------------------------------------------------------------------------

    @abstractmethod
    def _write_soon(self) -> None:
        """Write what is wanted in the driver's thread, as soon as the robot can take it. Any thread may call."""

    @abstractmethod
    def _read_back(self) -> None:
        """Ask the robot for its wheel targets: `targets_read_back` gets the answer. Any thread may call."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Let go of the robot."""


def _pair(values: list[int] | None) -> tuple[int, int] | None:
    return (values[0], values[1]) if values is not None else None


def _triple(values: list[int] | None) -> tuple[int, int, int] | None:
    return (values[0], values[1], values[2]) if values is not None else None
