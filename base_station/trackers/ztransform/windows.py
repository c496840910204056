"""What the look-up compares: windows of 12 x 12 cells in a frame at many levels, each described by 48 numbers.

Three row bands and three column bands, each read by two-sided second-order complex poles about its middle, projected to
eight numbers; all of length 1.
"""

from __future__ import annotations

import cv2
import numpy as np

from base_station.trackers.ztransform.lookup_kernels import (
    BANDS,
    COLUMN_STEP,
    SLOPES_SIDE,
    SLOPES_SIZE,
    gather_bands,
    power_of,
    put_together,
    spots,
)
from base_station.trackers.ztransform.poles import PoleSettings, scale_weights, spiral_poles
from base_station.trackers.ztransform.pyramid import Pyramid

SIDE, FUNCTIONS = SLOPES_SIDE, 8
DEPTH = SIDE // BANDS
"""Of a band, in cells; and how far apart the rows of windows are."""
WIDER = (BANDS - 1) * DEPTH // COLUMN_STEP
"""So many more places there are in a level for a band of columns than for a window."""
DESCRIPTOR_SIZE = 2 * BANDS * FUNCTIONS
POLES = PoleSettings(count=3, longest_cells=3.0, shortest_cells=1.0)
LEVELS_PER_OCTAVE = 3
LEVEL_STEP = 2 ** (1 / LEVELS_PER_OCTAVE)
SMALLEST_CELL_PX = 3.0


class Levels:
    """A frame of this size in cells of 3 px and coarser, while a window fits in: an octave of levels, then its halves.

    `cells`: all of them, float32, one after the other; the other fields say where and how large. Rows of windows are
    DEPTH cells apart, and one of them begins at the horizon.
    """

    def __init__(self, rows: int, columns: int, horizon_px: float) -> None:
        sizes = [SMALLEST_CELL_PX * 2 ** (n / LEVELS_PER_OCTAVE) for n in range(LEVELS_PER_OCTAVE)]
        shapes = [(round(rows / size), round(columns / size)) for size in sizes]
        scale = [(rows / down, columns / across) for down, across in shapes]
        while shapes[-LEVELS_PER_OCTAVE][0] // 2 >= SIDE and shapes[-LEVELS_PER_OCTAVE][1] // 2 >= SIDE:
            down, across = shapes[-LEVELS_PER_OCTAVE]
            cell_y, cell_x = scale[-LEVELS_PER_OCTAVE]
            shapes.append((down // 2, across // 2))
            scale.append((2 * cell_y, 2 * cell_x))
        self.cell_y_px, self.cell_x_px = np.array(scale).T.copy()
        heights, widths = np.array(shapes, np.int64).T
        self.horizons = np.round((horizon_px + 0.5) / self.cell_y_px).astype(np.int64)
        """The row of cells that begins there."""
        self.table = _table(heights, widths, self.horizons % DEPTH)
        """See `lookup_kernels`."""
        self.spots = np.maximum([spots(width, SIDE) for width in widths], 0)
        """Places for a band of columns in each level."""
        self.rows = np.maximum((heights - self.horizons % DEPTH - SIDE) // DEPTH + 1, 0)
        """How many rows of windows there are in each level."""
        self.windows = np.maximum(self.spots - WIDER, 0)
        """How many windows there are in each of them."""
        self.cells = np.empty(int((heights * widths).sum()), np.float32)
        self._views = [
            self.cells[offset : offset + down * across].reshape(down, across)
            for offset, (down, across) in zip(self.table[:, 0], shapes, strict=True)
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


def _table(heights: np.ndarray, widths: np.ndarray, first_rows: np.ndarray) -> np.ndarray:
    cells = np.concatenate([[0], np.cumsum(heights * widths)[:-1]])
    return np.stack([cells, heights, widths, first_rows], 1).astype(np.int64)


def _windows() -> np.ndarray:
    """What a profile of 12 cells is read with: central difference, then second-order poles about the middle.

    float32 (8, 12): the eight strongest orthogonal combinations of them, from their singular value decomposition, and
    by the root of their strength: by all of it, the fine ones among them would hardly count.
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
    return (np.sqrt(strength[:FUNCTIONS, None]) * directions[:FUNCTIONS]).astype(np.float32)


WINDOWS = _windows()


def descriptor_of(cells: np.ndarray) -> np.ndarray:
    """float32 (48,) of a window of 12 x 12 cells, of length 1."""
    side, none, out = np.array([SIDE]), np.zeros(1, np.int64), np.empty((DESCRIPTOR_SIZE, 1), np.float32)
    count = spots(SIDE, SIDE)
    table, begins = _table(side, side, none), np.array([[[0, 1, 2]], [[3, -1, -1]]]) * count
    taps = np.empty((SIDE, 4 * count), np.float32)
    gather_bands(cells.ravel(), table, begins, taps)
    read, power = WINDOWS @ taps, np.empty(4 * count, np.float32)
    power_of(read, power)
    put_together(read, power, table, begins, none, SIDE, np.empty(2, np.int64), out)
    return out[:, 0].copy()


def known_slopes(cells: np.ndarray) -> np.ndarray:
    """float32 (2, SLOPES_SIZE) of a window of 12 x 12 cells: central differences across, then down, of length 1.

    In rows of 12 and of 14, which is how they lie in a window that is a cell larger all around.
    """
    known = np.zeros((2, SLOPES_SIZE), np.float32)
    known[0].reshape(SIDE, SIDE)[:, : SIDE - 2] = cells[:, 2:] - cells[:, :-2]
    down = known[1, : (SIDE - 2) * (SIDE + 2)].reshape(SIDE - 2, SIDE + 2)
    down[:, :SIDE] = cells[2:] - cells[:-2]
    return known / max(float(np.sqrt((known**2).sum())), 1e-3)
