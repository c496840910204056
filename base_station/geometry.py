"""The camera as a pinhole: pixels to directions and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

DEFAULT_FOV_RAD = math.radians(62.2)
"""Horizontal field of view assumed when nothing is known: the Raspberry Pi camera 2."""

NEWTON_STEPS, LEAST_SLOPE = 6, 0.2


@dataclass(frozen=True, kw_only=True)
class PinholeCamera:
    """Focal lengths and principal point in px. Pixel centres are at integer coordinates: a picture of width w has its
    middle at (w - 1) / 2. `distortion`: OpenCV's k1, k2, p1, p2[, k3] of a calibrated lens, empty for an ideal one."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    @classmethod
    def with_fov(
        cls, width: int, height: int, fov_rad: float = DEFAULT_FOV_RAD, *, first_row: int = 0, full_height: int = 0
    ) -> PinholeCamera:
        """Square pixels, the axis through the middle of the whole picture, a known horizontal field of view."""
        focal_px = width / 2 / math.tan(fov_rad / 2)
        middle = ((full_height or height) - 1) / 2 - first_row
        return cls(width=width, height=height, fx=focal_px, fy=focal_px, cx=(width - 1) / 2, cy=middle)

    def bearing_rad(self, x_px: float) -> float:
        """Angle from the optical axis of what is seen in column x (at the middle row), to the left positive."""
        if not any(self.distortion):
            return math.atan2(self.cx - x_px, self.fx)
        _, _, _, p2, *_ = self.distortion
        return -math.atan(self._ideal((x_px - self.cx) / self.fx, p2))

    def elevation_rad(self, y_px: float) -> float:
        """Angle from the optical axis of what is seen in row y (at the middle column), upwards positive."""
        if not any(self.distortion):
            return math.atan2(self.cy - y_px, self.fy)
        _, _, p1, *_ = self.distortion
        return -math.atan(self._ideal((y_px - self.cy) / self.fy, p1))

    def _ideal(self, seen: float, tangential: float) -> float:
        """What an ideal pinhole would see there, on one of the picture's axes (in focal lengths from the middle).

        Newton's steps; a lens that folds the picture's rim over leaves them where it is steep, never in a loop.
        """
        k1, k2, _, _, k3 = (*self.distortion, 0.0)[:5]
        ideal = seen
        for _ in range(NEWTON_STEPS):
            r2 = ideal * ideal
            shown = ideal * (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) + 3 * tangential * r2
            slope = 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3)) + 6 * tangential * ideal
            ideal += (seen - shown) / max(slope, LEAST_SLOPE)
        return ideal


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
