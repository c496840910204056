"""Why a target cannot be learned, and why one is lost, in words."""

from __future__ import annotations

import math

import numpy as np

from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH
from base_station.trackers.ztransform.outline import left_side
from base_station.trackers.ztransform.settings import ZTransformSettings
from base_station.trackers.ztransform.texture import texture_of
from base_station.types import Box, Frame

NOISE_LINES = 16
"""Of a frame without the target, in which the noise is measured: all would take as long as the search."""


def check_box(target: Box, shape: tuple[int, int], settings: ZTransformSettings) -> None:
    """Raises ValueError when it lies outside of a frame of this shape, or is too small."""
    rows, columns = shape
    if target.clipped(columns, rows) is None:
        raise ValueError("the box is outside of the frame")
    if min(target.width, target.height) < settings.smallest_side_px:
        raise ValueError(f"the target is too small: {target.width:.0f}x{target.height:.0f} px")


def pixel_texture(frame: Frame, target: Box | None, settings: ZTransformSettings) -> float:
    """Texture of the frame's own pixels, 0 if it is but their noise: a patch of a plain wall has that too."""
    rows, columns = frame.image.shape
    inside = (target or Box(0, 0, columns, rows)).clipped(columns, rows)
    if inside is None or min(inside.width, inside.height) < 8:
        return math.inf  # too few pixels to tell
    top, left = int(inside.y), int(inside.x)
    pixels = frame.image[top : top + math.ceil(inside.height), left : left + math.ceil(inside.width)]
    block = min(max(min(pixels.shape) // 16, 2), 20)
    return texture_of(pixels, block, noise_factor=settings.above_noise)


def why_lost(frame: Frame, ahead: np.ndarray, confidence: float, settings: ZTransformSettings) -> str:
    """What probably happened. `ahead`: the placement where the target should be now."""
    rows, columns = frame.shape
    texture = texture_of(frame.image, max(1, min(columns // 32, frame.image.shape[0] // 3)), noise_lines=NOISE_LINES)
    if texture < settings.least_texture:
        return f"featureless: the view's texture is {texture:.1f} grey levels"
    side = left_side(ahead, columns, rows)
    if side:
        return f"the target left the frame at the {side}"
    if min(ahead[WIDTH], ahead[HEIGHT]) < settings.smallest_side_px * 1.1:
        return f"too small: {ahead[WIDTH]:.0f}x{ahead[HEIGHT]:.0f} px"
    if ahead[WIDTH] > 0.9 * settings.largest_share * columns:
        return f"too large: {ahead[WIDTH]:.0f} px wide"
    return f"the target is hidden or gone (confidence {max(confidence, 0.0):.2f})"
