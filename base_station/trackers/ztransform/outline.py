"""Placements against pixels: lenses, outlines, and at which side something left."""

from __future__ import annotations

import math

import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y
from base_station.types import Box

PLACE_WIDTH, PLACE_HEIGHT = 0.8, 0.85


def lens_of(camera: PinholeCamera, *, curved: bool) -> np.ndarray:
    """The four numbers that the kernels take, see `kernels`."""
    return np.array([1.0 if curved else 0.0, camera.fx, camera.cx, camera.cy])


def place_placement(camera: PinholeCamera) -> np.ndarray:
    """The generous middle of the view, on the cylinder: a margin is left for learning how shifts look."""
    half_width_px = camera.fx * math.atan(camera.width / 2 / camera.fx)
    x, y = camera.fx * math.atan(((camera.width - 1) / 2 - camera.cx) / camera.fx) + camera.cx, (camera.height - 1) / 2
    return np.array([x, y, 2 * half_width_px * PLACE_WIDTH, camera.height * PLACE_HEIGHT, 0.0])


def to_pixel(x: float, y: float, lens: np.ndarray) -> tuple[float, float]:
    """The pixel at which a point of the placement's plane, or cylinder, is seen."""
    curved, focal, middle_x, middle_y = lens.tolist()
    if curved <= 0:
        return x, y
    azimuth = min(max((x - middle_x) / focal, -1.4), 1.4)
    return middle_x + focal * math.tan(azimuth), middle_y + (y - middle_y) / math.cos(azimuth)


def outline(placement: np.ndarray, lens: np.ndarray) -> Box:
    """The upright box about the placement, in pixels. May stick out of the frame."""
    x, y, width, height, _ = placement.tolist()
    if lens[0] <= 0:
        return Box.around(x, y, width, height)
    left, right = (to_pixel(x + side * width / 2, y, lens)[0] for side in (-1, 1))
    top, bottom = (to_pixel(x, y + side * height / 2, lens)[1] for side in (-1, 1))
    return Box.around((left + right) / 2, (top + bottom) / 2, right - left, bottom - top)


def left_side(placement: np.ndarray, columns: int, rows: int) -> str:
    """left, right, top or bottom: where less than half of the placement is still in the frame; else empty."""
    outside = {
        "left": -placement[X] / placement[WIDTH],
        "right": (placement[X] - columns) / placement[WIDTH],
        "top": -placement[Y] / placement[HEIGHT],
        "bottom": (placement[Y] - rows) / placement[HEIGHT],
    }
    side = max(outside, key=lambda name: outside[name])
    return side if outside[side] > 0 else ""
