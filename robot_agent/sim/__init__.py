"""A robot, a room and something to follow, simulated with MuJoCo (the `sim` extra)."""

from robot_agent.sim.faults import Faults
from robot_agent.sim.scenarios import SCENARIOS
from robot_agent.sim.world import World

__all__ = ["SCENARIOS", "Faults", "World"]
