"""The Thymio II in asebaplayground: the driver of the real one, on the playground's own bus."""

from __future__ import annotations

from robot_agent.robots.thymio import ThymioRobot


class PlaygroundRobot(ThymioRobot):
    """Differs from a real Thymio in name only. Close it before the playground."""

    kind = "playground"
