"""What the agent asks of a robot: turn the wheels, tell the sensors. Hardware and simulation are twins behind it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from protocol import RobotLimits


@dataclass(frozen=True, kw_only=True)
class RobotState:
    """The newest measurements. `proximity`: five front sensors left to right, two rear, 0 far and about 4500 at
    contact, None when the robot has none. `wheels_measured`: left, right in motor units, None when not measured.
    """

    proximity: tuple[int, ...] | None = None
    wheels_measured: tuple[int, int] | None = None


class Robot(Protocol):
    """Two driven wheels and proximity sensors. Any thread may call; no call blocks for longer than some
    milliseconds."""

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
