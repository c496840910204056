"""A frame at full, half and quarter size, each made when it is first asked for.

A patch cell should be read from pixels about half its size: finer reads cost time, coarser ones are blurred.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

SCALES = (1, 2, 4)
FEWEST_PIXELS = 8
PIXELS_PER_CELL = 1.5
"""At least this many of the chosen size in a cell."""
PIXELS_PER_READ = 2.4
"""With more of them in a cell than this, it is read more than once."""


class Pyramid:
    """One frame's sizes. Pixel centres are at integers, so x of the full frame is (x - (scale - 1) / 2) / scale.

    `first_row`: of the whole frame, where the image is a band of it.
    """

    def __init__(self, image: np.ndarray, first_row: int = 0) -> None:
        self.first_row = first_row
        self.image = _read_only(image)
        """The frame itself, uint8 (height, width), contiguous and not writable: the one type the kernels know."""
        self._sizes = {1: self.image}

    def at(self, scale: int) -> np.ndarray:
        """The frame at 1 / scale of its size, by means of 2x2 pixels; an odd last row or column is left out."""
        if scale not in self._sizes:
            finer = self.at(scale // 2)
            rows, columns = finer.shape[0] // 2, finer.shape[1] // 2
            even = finer[: rows * 2, : columns * 2]
            self._sizes[scale] = _read_only(cv2.resize(even, (columns, rows), interpolation=cv2.INTER_AREA))
        return self._sizes[scale]

    def for_cell(self, cell_px: float) -> tuple[np.ndarray, int, int]:
        """For cells of this size, in px of the full frame: which image to read, its scale, reads per cell and axis."""
        largest = min(self.image.shape) // FEWEST_PIXELS
        scale = max(s for s in SCALES if s == 1 or (cell_px >= PIXELS_PER_CELL * s and s <= largest))
        reads = min(max(math.ceil(cell_px / scale / PIXELS_PER_READ), 1), 4)
        return self.at(scale), scale, reads


def _read_only(image: np.ndarray) -> np.ndarray:
    view = np.ascontiguousarray(image).view()
    view.flags.writeable = False
    return view
