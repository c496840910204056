"""No robot: for streaming a camera or a recording. Commands are taken and nothing moves."""

from __future__ import annotations

from protocol import RobotLimits
from robot_agent.robots.base import RobotState


class NoRobot:
    """Obeys nothing and has no sensors; telemetry still shows what it was asked."""

    kind = "none"
    limits = RobotLimits()

    def set_wheels(self, left: int, right: int) -> None:
        """Nothing turns."""

    def state(self) -> RobotState:
        return RobotState()

    def close(self) -> None:
        """Nothing to let go of."""
