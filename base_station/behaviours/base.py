"""What a behaviour is: tracker results in, wheel speeds out. It knows no tracker, no socket and no clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from base_station.types import TrackerResult
from protocol import Command, PanTiltLimits, RobotLimits


class Behaviour(Protocol):
    """Asked once per frame, from one thread."""

    def command(self, result: TrackerResult | None, time_s: float) -> Command:
        """The wheel speeds for this frame. `result` is None before anything was learned; `time_s` is the frame's
        time."""
        ...


class Head(Protocol):
    """The camera on its pan-tilt. Trackers know nothing of it: they measure from the optical axis."""

    limits: PanTiltLimits
    pan_rad: float
    """Where the camera looked, left of the robot's heading, in the frame that is dealt with."""

    def look(self, pan_rad: float) -> None:
        """Turn the camera there; returns at once, and the newest goal wins."""
        ...


@runtime_checkable
class Steered(Behaviour, Protocol):
    """A behaviour that a person steers."""

    def steer(self, forward: float, left: float, time_s: float) -> None:
        """Go so fast (-1..1 of what it allows) from the frame of `time_s` on, for a moment: whoever steers says it
        again and again, and when nothing is said the robot stands."""
        ...


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a journey ended."""

    there: bool
    text: str
    """For a person."""


@runtime_checkable
class Journey(Behaviour, Protocol):
    """A behaviour that comes to an end."""

    @property
    def outcome(self) -> Outcome | None:
        """None while it goes on. May become None again: the robot was carried away, the target moved."""
        ...


@dataclass(frozen=True)
class Drive:
    """Turns motion of the robot's body into wheel speeds of the wire, within what the wire can carry."""

    limits: RobotLimits

    @property
    def metres_per_wire_unit_s(self) -> float:
        """Speed of a wheel at one wire unit."""
        return self.limits.metres_per_unit_s * self.limits.speed_scale

    @property
    def fastest_m_s(self) -> float:
        """The largest wheel speed that robot and wire allow."""
        return min(127 * self.metres_per_wire_unit_s, self.limits.max_units * self.limits.metres_per_unit_s)

    def command(self, forward_m_s: float, turn_rad_s: float) -> Command:
        """Wheel speeds for a forward speed and a rate of turn (left positive).

        Turning goes first: where both do not fit, the forward speed gives way, so the target is kept in view.
        """
        fastest = self.fastest_m_s
        turn_m_s = max(-fastest, min(fastest, turn_rad_s * self.limits.wheel_base_m / 2))
        room_m_s = fastest - abs(turn_m_s)
        forward_m_s = max(-room_m_s, min(room_m_s, forward_m_s))
        unit = self.metres_per_wire_unit_s
        return Command.clamped((forward_m_s - turn_m_s) / unit, (forward_m_s + turn_m_s) / unit)
