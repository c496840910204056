"""The safety supervisor: which wheel speeds are allowed now, and why not the ones asked for.

Pure: it reads no clock, no sensor and no socket; everything comes in as arguments and the decision goes out. The agent
calls it from a thread of its own, so that a camera or a bus that blocks cannot disable it. On any doubt the wheels
stop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

FRONT, REAR = slice(0, 5), slice(5, 7)
SENSORS = 7


class SafetyState(Enum):
    """OK: the command goes through. LIMITED: an obstacle bends it. STOPPED: the wheels stand."""

    OK = "ok"
    LIMITED = "limited"
    STOPPED = "stopped"


@dataclass(frozen=True, kw_only=True)
class SafetySettings:
    """When to stop, and how near is too near."""

    command_timeout_s: float = 0.5
    """No command for longer than this: stop."""
    frame_timeout_s: float = 0.5
    """No picture from the camera for longer than this: stop, the station drives blind."""
    obstacle: int = 2000
    """A proximity reading above this is an obstacle (Thymio II: about 4500 at contact, 0 beyond some 12 cm)."""
    edge: int | None = 100
    """A ground reading below this is a table's edge (Thymio II: about 900 over a light floor); None: do not look."""
    tilt_rad: float | None = 0.45
    """A robot tilted further than this was picked up or is falling; None: do not look."""
    limit_units: int = 500
    """Largest wheel speed, motor units."""
    thesis_rule: bool = False
    """Listing A.1 to the letter instead: sensors [2] > 1000 or [4] > 1000 or [3] > 2000 stop both wheels."""


PRESETS: dict[str, SafetySettings] = {"default": SafetySettings(), "thesis": SafetySettings(thesis_rule=True)}


@dataclass(frozen=True)
class WheelCommand:
    """Asked wheel speeds in motor units, and when they came (s, the clock that `step` is given)."""

    left: float
    right: float
    received_s: float


@dataclass(frozen=True, kw_only=True)
class LinkState:
    """What the agent knows of station and camera. `last_frame_s` is None before the camera's first picture."""

    connected: bool
    last_frame_s: float | None
    problem: str = ""
    """A failure that by itself stops the robot, in words; empty when there is none."""


@dataclass(frozen=True)
class Decision:
    """The wheel speeds allowed, motor units, with state and reason (empty when OK)."""

    left: int
    right: int
    state: SafetyState
    reason: str = ""


class SafetySupervisor:
    """Holds one thing only: whether the emergency stop is latched."""

    def __init__(self, settings: SafetySettings | None = None) -> None:
        self.settings = settings or SafetySettings()
        self._emergency: str | None = None

    def emergency_stop(self, reason: str = "") -> None:
        """Stop until `release`, whatever is commanded."""
        self._emergency = f"emergency stop: {reason}" if reason else "emergency stop"

    def release(self) -> None:
        """End the emergency stop. The next command moves the wheels again."""
        self._emergency = None

    @property
    def emergency(self) -> bool:
        """Whether the emergency stop is latched."""
        return self._emergency is not None

    def step(
        self,
        now_s: float,
        command: WheelCommand | None,
        proximity: tuple[int, ...] | None,
        link: LinkState,
        *,
        ground: tuple[int, int] | None = None,
        acceleration: tuple[int, int, int] | None = None,
    ) -> Decision:
        """Decide. `proximity`: seven readings, five in front and two behind, or None for a robot without them;
        `ground` and `acceleration` likewise, as in RobotState.

        The same arguments give the same decision, however often it is asked.
        """
        reason = self._why_stop(now_s, command, proximity, link) or self._why_not_upright(acceleration)
        if reason or command is None:
            return Decision(0, 0, SafetyState.STOPPED, reason)
        if ground is not None and self.settings.edge is not None and min(ground) < self.settings.edge:
            mean, half_turn = (command.left + command.right) / 2, (command.right - command.left) / 2
            if mean > 0:
                return self._clamped(-half_turn, half_turn, SafetyState.LIMITED, "an edge in front")
        if proximity is not None:
            return self._around_obstacles(command, proximity)
        return self._clamped(command.left, command.right, SafetyState.OK, "")

    def _why_not_upright(self, acceleration: tuple[int, int, int] | None) -> str:
        """A robot at rest or driving feels gravity only, from below. All zeros is no accelerometer (the playground)."""
        if self.settings.tilt_rad is None or acceleration is None or not any(acceleration):
            return ""
        right, forward, up = acceleration
        tilt_rad = math.atan2(math.hypot(right, forward), up)
        return f"picked up: tilted by {math.degrees(tilt_rad):.0f} degrees" if tilt_rad > self.settings.tilt_rad else ""

    def _why_stop(
        self, now_s: float, command: WheelCommand | None, proximity: tuple[int, ...] | None, link: LinkState
    ) -> str:
        if self._emergency is not None:
            return self._emergency
        if link.problem:
            return link.problem
        if not link.connected:
            return "no station is connected"
        if link.last_frame_s is None:
            return "the camera has not given a picture yet"
        camera_silent_s = now_s - link.last_frame_s
        if not camera_silent_s <= self.settings.frame_timeout_s:  # so that no number at all stops too
            return f"the camera hangs: no picture for {camera_silent_s * 1000:.0f} ms"
        if command is None:
            return "no command yet"
        silent_s = now_s - command.received_s
        if not silent_s <= self.settings.command_timeout_s:
            return f"no command for {silent_s * 1000:.0f} ms"
        if not (math.isfinite(command.left) and math.isfinite(command.right)):
            return f"the command {command.left}, {command.right} is no speed"
        if proximity is not None and len(proximity) != SENSORS:
            return f"the proximity sensors gave {len(proximity)} readings instead of {SENSORS}"
        return ""

    def _around_obstacles(self, command: WheelCommand, proximity: tuple[int, ...]) -> Decision:
        if self.settings.thesis_rule:
            if proximity[2] > 1000 or proximity[4] > 1000 or proximity[3] > 2000:
                return Decision(0, 0, SafetyState.STOPPED, "obstacle (rule of listing A.1)")
            return self._clamped(command.left, command.right, SafetyState.OK, "")
        mean = (command.left + command.right) / 2
        half_turn = (command.right - command.left) / 2
        if mean > 0 and max(proximity[FRONT]) > self.settings.obstacle:
            return self._clamped(-half_turn, half_turn, SafetyState.LIMITED, "obstacle in front")
        if mean < 0 and max(proximity[REAR]) > self.settings.obstacle:
            return self._clamped(-half_turn, half_turn, SafetyState.LIMITED, "obstacle behind")
        return self._clamped(command.left, command.right, SafetyState.OK, "")

    def _clamped(self, left: float, right: float, state: SafetyState, reason: str) -> Decision:
        """Both scaled by one factor to the robot's limit, so that the curve driven stays the one asked for."""
        largest = max(abs(left), abs(right), 1.0)
        factor = min(1.0, self.settings.limit_units / largest)
        return Decision(round(left * factor), round(right * factor), state, reason)
