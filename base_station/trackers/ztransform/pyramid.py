"""A frame at full, half and quarter size, and the running sums of each, made when they are first asked for.

A patch cell should be read from pixels about half its size: finer reads cost time, coarser ones are blurred. Running
sums are made of the surroundings of the target alone, as long as no more is asked for.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

COARSEST = 4
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
        self._sums: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._whole: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def at(self, scale: int) -> np.ndarray:
        """The frame at 1 / scale of its size, by means of 2x2 pixels; an odd last row or column is left out."""
        if scale not in self._sizes:
            finer = self.at(scale // 2)
            rows, columns = finer.shape[0] // 2, finer.shape[1] // 2
            even = finer[: rows * 2, : columns * 2]
            self._sizes[scale] = _read_only(cv2.resize(even, (columns, rows), interpolation=cv2.INTER_AREA))
        return self._sizes[scale]

    def sums(
        self, cell_px: float, around: tuple[float, float, float, float] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Running sums of at least the box `around` (left, top, right, bottom in px; None: the whole frame), and where
        they are: see `boxes`. From pixels that suit cells of this size."""
        scale, known = self._scale_for(cell_px), None
        if scale in self._sums:
            known = self._sums[scale]
            if known is self._whole.get(scale) or (around is not None and _holds(*known, around)):
                return known
        rows, columns = self.image.shape[0] // scale, self.image.shape[1] // scale
        if known is None and around is not None:
            left, top = max(int(around[0]) // scale, 0), max(int(around[1]) // scale, 0)
            right, bottom = min(int(around[2]) // scale + 2, columns), min(int(around[3]) // scale + 2, rows)
            if right - left > 1 and bottom - top > 1:
                table = cv2.integral(self._part(scale, left, top, right, bottom))
                self._sums[scale] = known = table, np.array((scale, left, top, columns, rows), np.float64)
                return known
        table = cv2.integral(self.at(scale))
        self._sums[scale] = self._whole[scale] = known = table, np.array((scale, 0, 0, columns, rows), np.float64)
        return known

    def coarser(self, where: np.ndarray) -> float:
        """Cells of this many px and more are read from coarser sums than those that are here."""
        scale = float(where[0])
        return PIXELS_PER_CELL * 2 * scale if self._scale_for(math.inf) > scale else math.inf

    def _part(self, scale: int, left: int, top: int, right: int, bottom: int) -> np.ndarray:
        """A part of the frame at 1 / scale of its size, without making the rest of it."""
        if scale in self._sizes:
            return self._sizes[scale][top:bottom, left:right]
        finer = self._part(scale // 2, 2 * left, 2 * top, 2 * right, 2 * bottom)
        return cv2.resize(finer, (right - left, bottom - top), interpolation=cv2.INTER_AREA)

    def _scale_for(self, cell_px: float) -> int:
        scale, largest = 1, min(self.image.shape) // FEWEST_PIXELS
        while scale < COARSEST and cell_px >= PIXELS_PER_CELL * 2 * scale and 2 * scale <= largest:
            scale *= 2
        return scale

    def for_cell(self, cell_px: float) -> tuple[np.ndarray, int, int]:
        """For cells of this size, in px of the full frame: which image to read, its scale, reads per cell and axis."""
        scale = self._scale_for(cell_px)
        reads = min(max(math.ceil(cell_px / scale / PIXELS_PER_READ), 1), 4)
        return self.at(scale), scale, reads


def _holds(table: np.ndarray, where: np.ndarray, around: tuple[float, float, float, float] | None) -> bool:
    """Whether these sums are of all of that box that lies in the frame."""
    if around is None:
        return False
    scale, left, top, columns, rows = where.tolist()
    right, bottom = left + table.shape[1] - 1, top + table.shape[0] - 1
    return (
        left <= max(around[0] / scale, 0)
        and top <= max(around[1] / scale, 0)
        and right >= min(around[2] / scale, columns)
        and bottom >= min(around[3] / scale, rows)
    )


def _read_only(image: np.ndarray) -> np.ndarray:
    if image.flags.c_contiguous and not image.flags.writeable:
        return image
    view = np.ascontiguousarray(image).view()
    view.flags.writeable = False
    return view
