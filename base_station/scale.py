"""Metres: a camera alone sees only ratios, and one known length makes distances of them.

Known is either how wide the target is, or how far away it was when it was learned. Both give its depth then (along the
optical axis), and later depths follow from the zoom.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

from base_station.geometry import PinholeCamera
from base_station.types import Box, TrackerResult


@dataclass(frozen=True, kw_only=True)
class Scale:
    """What is known of the scene's size. `learned_depth_m`: depth of the target when it was learned."""

    learned_depth_m: float

    def measured(self, result: TrackerResult) -> TrackerResult:
        """The result with `range_m`, the distance from camera to target, where it can be told (else as it is).

        A result with a range of its own keeps it.
        """
        if result.zoom is None or result.bearing_rad is None or result.range_m is not None:
            return result
        depth_m = self.learned_depth_m / result.zoom
        range_m = depth_m * _ray_length(result.bearing_rad, result.elevation_rad or 0.0)
        return dataclasses.replace(result, range_m=range_m)


def scale_from_width(width_m: float, box: Box, camera: PinholeCamera) -> Scale:
    """From the width of what the box encloses, seen squarely."""
    return Scale(learned_depth_m=camera.fx * width_m / box.width)


def scale_from_distance(distance_m: float, box: Box | None, camera: PinholeCamera) -> Scale:
    """From the distance between camera and target (without a box: what is straight ahead) when it was learned."""
    if box is None:
        return Scale(learned_depth_m=distance_m)
    x, y = box.center_px
    return Scale(learned_depth_m=distance_m / _ray_length(camera.bearing_rad(x), camera.elevation_rad(y)))


def _ray_length(bearing_rad: float, elevation_rad: float) -> float:
    """Of the line of sight, for a depth of 1. The elevation is that of the row, as results have it."""
    return math.sqrt(1 + math.tan(bearing_rad) ** 2 + math.tan(elevation_rad) ** 2)
