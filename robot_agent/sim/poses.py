"""Where something stands on the floor of the simulated room, and which way it looks."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Position in the room (origin in its middle) and heading, counter-clockwise from the x axis seen from above."""

    x_m: float
    y_m: float
    heading_rad: float

    def moved(self, *, ahead_m: float = 0.0, left_m: float = 0.0, turned_rad: float = 0.0) -> Pose:
        """The pose that lies so far ahead and to the left of this one, turned to the left by an angle."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return Pose(
            x_m=self.x_m + ahead_m * c - left_m * s,
            y_m=self.y_m + ahead_m * s + left_m * c,
            heading_rad=self.heading_rad + turned_rad,
        )


def wrapped(angle_rad: float) -> float:
    """The same angle in -pi..pi."""
    return math.remainder(angle_rad, 2.0 * math.pi)
