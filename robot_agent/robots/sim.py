"""The simulated robot: the twin of a Thymio II, plus what only a simulation knows."""

from __future__ import annotations

from protocol import RobotLimits
from robot_agent.robots.base import RobotState
from robot_agent.sim.world import World


class SimRobot:
    """Drives the robot of a world. Implements Robot."""

    kind = "sim"

    def __init__(self, world: World) -> None:
        self._world = world
        self.limits: RobotLimits = world.limits

    def set_wheels(self, left: int, right: int) -> None:
        """Ask for wheel speeds in motor units. They hold until the next call."""
        self._world.set_wheels(left, right)

    def state(self) -> RobotState:
        """Proximity and measured wheel speeds."""
        return self._world.state()

    def close(self) -> None:
        """Stop the wheels. The world stays with whoever made it."""
        self._world.set_wheels(0, 0)
