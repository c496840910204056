"""Cheap camera noise.

Drawing a Gaussian number for each pixel of each frame costs half as much as rendering. Noise is drawn once, more than a
frame of it, and each frame reads it from another random place; positive and negative parts are kept apart so that two
saturating 8-bit additions do the work.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

_SPARE = 1 << 18
"""Places to start from. Two frames share their noise exactly with a chance of one in so many."""
_ROUNDING_VARIANCE = 1.0 / 12.0


class NoiseBank:
    """Gaussian noise of `sigma` gray levels for uint8 pictures of one size."""

    def __init__(self, *, sigma: float, width: int, height: int, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._shape = (height, width)
        # Rounding to whole gray levels adds variance of its own.
        drawn = math.sqrt(max(sigma * sigma - _ROUNDING_VARIANCE, 0.0))
        noise = self._rng.standard_normal(width * height + _SPARE, dtype=np.float32) * np.float32(drawn)
        levels = np.clip(np.rint(noise), -255, 255).astype(np.int16)
        self._above = np.maximum(levels, 0).astype(np.uint8)
        self._below = np.maximum(-levels, 0).astype(np.uint8)

    def add_to(self, image: np.ndarray) -> np.ndarray:
        """The picture (uint8, height x width) with fresh noise, saturating at 0 and 255."""
        start = int(self._rng.integers(_SPARE))
        part = slice(start, start + image.size)
        lighter = cv2.add(image, self._above[part].reshape(self._shape))
        return cv2.subtract(lighter, self._below[part].reshape(self._shape), dst=lighter)
