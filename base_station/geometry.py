"""The camera as a pinhole: pixels to directions and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

DEFAULT_FOV_RAD = math.radians(62.2)
"""Horizontal field of view assumed when nothing is known: the Raspberry Pi camera 2."""


@dataclass(frozen=True, kw_only=True)
class PinholeCamera:
    """Focal lengths and principal point in px. Pixel centres are at integer coordinates: a picture of width w has its
    middle at (w - 1) / 2."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @classmethod
    def with_fov(
        cls, width: int, height: int, fov_rad: float = DEFAULT_FOV_RAD, *, first_row: int = 0, full_height: int = 0
    ) -> PinholeCamera:
        """Square pixels, the axis through the middle of the whole picture, a known horizontal field of view."""
        focal_px = width / 2 / math.tan(fov_rad / 2)
        middle = ((full_height or height) - 1) / 2 - first_row
        return cls(width=width, height=height, fx=focal_px, fy=focal_px, cx=(width - 1) / 2, cy=middle)

    def bearing_rad(self, x_px: float) -> float:
        """Angle from the optical axis of what is seen in column x, to the left positive."""
        return math.atan2(self.cx - x_px, self.fx)

    def elevation_rad(self, y_px: float) -> float:
        """Angle from the optical axis of what is seen in row y (at the middle column), upwards positive."""
        return math.atan2(self.cy - y_px, self.fy)


@dataclass(frozen=True, kw_only=True)
class FlatPose:
    """Of a robot on the floor: place, and heading from the x axis, counter-clockwise from above (not wrapped)."""

    x_m: float
    y_m: float
    heading_rad: float

    def sees(self, x_m: float, y_m: float) -> tuple[float, float]:
        """How far ahead of it and to its left a point lies, in m."""
        c, s = math.cos(self.heading_rad), math.sin(self.heading_rad)
        dx, dy = x_m - self.x_m, y_m - self.y_m
        return c * dx + s * dy, c * dy - s * dx
