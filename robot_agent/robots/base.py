"""What the agent asks of a robot: turn the wheels, tell the sensors. Hardware and simulation are twins behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from protocol import RobotLimits


@dataclass(frozen=True, kw_only=True)
class RobotState:
    """The newest measurements. What the robot has not, or has not told lately, is None."""

    proximity: tuple[int, ...] | None = None
    """Five front sensors left to right, two rear; 0 far and about 4500 at contact."""
    ground: tuple[int, int] | None = None
    """Light reflected from the floor below the front, left and right; small over an edge."""
    acceleration: tuple[int, int, int] | None = None
    """Right, forward, up, in units of which 23 are 1 g."""
    button: bool = False
    """The robot's own stop button is held."""
    wheels_measured: tuple[int, int] | None = None
    """Left, right in motor units."""
    battery_v: float | None = None
    """Voltage of the battery (Thymio II: 4.2 full, below 3.4 soon empty)."""
    problem: str = ""
    """Why the robot cannot be driven just now (it is away), in words; empty when it can."""


class Robot(Protocol):
    """Two driven wheels and proximity sensors. Any thread may call; no call blocks for longer than some
    milliseconds. A robot with lights also has `show(what)`: "tracking", "lost", "idle" or "stopped"."""

    kind: str
    limits: RobotLimits
    """`speed_scale` here is 1: the agent applies its own."""

    def set_wheels(self, left: int, right: int) -> None:
        """Ask for wheel speeds in motor units. They hold until the next call."""
        ...

    def state(self) -> RobotState: ...

    def close(self) -> None:
        """Stop the wheels and let go of the robot."""
        ...
