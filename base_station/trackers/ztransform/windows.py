"""What the look-up compares: windows of 12 x 12 cells in a frame at many levels, each described by 48 numbers.

Three row bands and three column bands, each read by two-sided second-order complex poles about its middle, projected to
eight numbers; all of length 1.
"""

from __future__ import annotations

import cv2
import numpy as np

from base_station.trackers.ztransform.kernels import WIDTH, sample_patch
from base_station.trackers.ztransform.lookup_kernels import gather_profiles
from base_station.trackers.ztransform.poles import PoleSettings, scale_weights, spiral_poles
from base_station.trackers.ztransform.pyramid import Pyramid

SIDE, BANDS, FUNCTIONS = 12, 3, 8
DESCRIPTOR_SIZE = 2 * BANDS * FUNCTIONS
POLES = PoleSettings(count=3, longest_cells=3.0, shortest_cells=1.0)
LEVELS_PER_OCTAVE = 5
LEVEL_STEP = 2 ** (1 / LEVELS_PER_OCTAVE)
SMALLEST_CELL_PX = 3.0
COLUMN_STEP = 2
"""In cells: how far apart the windows are that are looked at (`gather_profiles` knows)."""


class Levels:
    """A frame of this size in cells of 3 px and coarser, while a window fits in: an octave of levels, then its halves.

    `cells`: all of them, float32, one after the other; the other fields say where and how large.
    """

    def __init__(self, rows: int, columns: int) -> None:
        sizes = [SMALLEST_CELL_PX * 2 ** (n / LEVELS_PER_OCTAVE) for n in range(LEVELS_PER_OCTAVE)]
        shapes = [(round(rows / size), round(columns / size)) for size in sizes]
        scale = [(rows / down, columns / across) for down, across in shapes]
        while shapes[-LEVELS_PER_OCTAVE][0] // 2 >= SIDE and shapes[-LEVELS_PER_OCTAVE][1] // 2 >= SIDE:
            down, across = shapes[-LEVELS_PER_OCTAVE]
            cell_y, cell_x = scale[-LEVELS_PER_OCTAVE]
            shapes.append((down // 2, across // 2))
            scale.append((2 * cell_y, 2 * cell_x))
        self.heights, self.widths = np.array(shapes, np.int64).T.copy()
        self.cell_y_px, self.cell_x_px = np.array(scale).T.copy()
        self.offsets = np.concatenate([[0], np.cumsum(self.heights * self.widths)])[:-1].astype(np.int64)
        self.cells = np.empty(int((self.heights * self.widths).sum()), np.float32)
        self._views = [
            self.cells[offset : offset + down * across].reshape(down, across)
            for offset, (down, across) in zip(self.offsets, shapes, strict=True)
        ]

    def read(self, pyramid: Pyramid) -> None:
        """Fill `cells`."""
        for n, view in enumerate(self._views):
            if n < LEVELS_PER_OCTAVE:
                source = pyramid.at(4 if self.cell_x_px[n] >= 4.3 else 2)
                view[:] = cv2.resize(source, view.shape[::-1], interpolation=cv2.INTER_LINEAR)
            else:
                finer = self._views[n - LEVELS_PER_OCTAVE][: 2 * view.shape[0], : 2 * view.shape[1]]
                cv2.resize(finer, view.shape[::-1], dst=view, interpolation=cv2.INTER_AREA)


def _windows() -> np.ndarray:
    """What a profile of 12 cells is read with: central difference, then second-order poles about the middle.

    float32 (8, 12): the eight strongest orthogonal combinations of them, from their singular value decomposition.
    """
    difference = np.zeros((SIDE, SIDE))
    for n in range(1, SIDE - 1):
        difference[n, n + 1], difference[n, n - 1] = 0.5, -0.5
    u = np.arange(SIDE) - (SIDE - 1) / 2
    read = []
    for pole, weight in zip(spiral_poles(POLES), scale_weights(POLES), strict=True):
        for side in (u, -u):
            window = np.where(side > 0, side * pole ** np.maximum(side, 0), 0) * weight
            read += [window.real, window.imag]
    _, strength, directions = np.linalg.svd(np.array(read) @ difference)
    return (strength[:FUNCTIONS, None] * directions[:FUNCTIONS]).astype(np.float32)


WINDOWS = _windows()


def descriptor_at(pyramid: Pyramid, window: np.ndarray) -> np.ndarray:
    """float32 (48,) of this square of a flat picture."""
    patch, seen = np.empty((SIDE, SIDE), np.float32), np.empty((SIDE, SIDE), np.uint8)
    image, scale, reads = pyramid.for_cell(window[WIDTH] / SIDE)
    sample_patch(image, scale, window, np.zeros(4), reads, patch, seen)
    none, profiles = np.zeros(1, np.int64), np.empty((SIDE, 2 * BANDS, 1), np.float32)
    gather_profiles(patch.ravel(), none, none + SIDE, none, SIDE, BANDS, profiles, np.empty(2, np.int64))
    read = WINDOWS @ profiles.reshape(SIDE, -1)
    return np.asarray(read.ravel() / max(float(np.sqrt((read**2).sum())), 1e-3), np.float32)
