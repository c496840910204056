"""Which of many landmarks may be in a frame, and about where: cheap for hundreds of them, and rarely wrong.

Which rows of windows (see `windows`) are read? A robot's camera keeps its height, so a landmark's row follows from its
size: y_h + g (y0 - y_h). In units of the window that is the same row at every level, for all landmarks that stand at
the same height against their size. They share one row of windows per level, and comparing them with all windows of all
levels is one matrix product.

Descriptors are coarse, and levels far apart. The best 224 are therefore looked at again: the slopes of the 144 cells
themselves against those of the landmark's small picture, also a cell further left and right, up and down. Hardly any
but true ones are left.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y
from base_station.trackers.ztransform.landmark import Landmark
from base_station.trackers.ztransform.lookup_kernels import (
    best_windows,
    compare_slopes,
    gather_bands,
    power_of,
    put_together,
)
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.windows import (
    BANDS,
    DEPTH,
    DESCRIPTOR_SIZE,
    FUNCTIONS,
    LEVEL_STEP,
    SIDE,
    WINDOWS,
    Levels,
    descriptor_of,
    known_slopes,
)

SIZES = tuple(0.93 * LEVEL_STEP**power for power in (-0.25, 0.25))
"""Of the windows that describe a landmark: between them they halve the step of the levels."""
BLOCK_LEVELS = 3
FINER = 4
"""The small picture is read so many times per cell and axis."""


@dataclass(frozen=True, kw_only=True)
class ShortlistSettings:
    """What to look for, and what to leave out."""

    zooms: tuple[float, float] = (0.42, 2.4)
    """Of targets, against the learned size."""
    place_zooms: tuple[float, float] = (0.8, 1.25)
    place_window: float = 0.45
    """A place is first looked for by its middle; this share of the frame's height."""
    windows: int = 224
    """How many windows, of those that resemble a landmark's most, are looked at again."""
    resemblance: float = 0.5
    """Of the descriptors (normalised correlation), to be looked at again."""
    agreement: float = 0.68
    """Of the slopes (normalised correlation), to be handed on."""
    candidates: int = 24
    """How many landmarks to hand on."""


@dataclass(frozen=True)
class _Block:
    """Landmarks' windows that are compared in one product: they need about the same levels."""

    windows: slice
    """Which, of all the landmarks' windows."""
    descriptors: np.ndarray
    low: np.ndarray
    """Of each the first level in its range of zooms."""
    high: np.ndarray
    """One after the last."""


@dataclass(frozen=True)
class _Group:
    """Landmarks' windows that share a row of windows in the frame."""

    blocks: list[_Block]
    rows: np.ndarray
    """Which row in each level; -1 where it would not lie in the frame, or nobody asks for it."""
    count: int
    """How many windows of the frame that makes."""


class Shortlist:
    """These landmarks, made ready for being looked for in frames of one camera."""

    def __init__(self, landmarks: Sequence[Landmark], camera: PinholeCamera, settings: ShortlistSettings) -> None:
        self._settings, self._camera = settings, camera
        self._levels = Levels(camera.height, camera.width, camera.cy)
        self.placements = np.stack([landmark.placement(camera) for landmark in landmarks])
        """Of each landmark, as it was learned; see `kernels`."""
        self._is_place = np.array([landmark.box is None for landmark in landmarks])
        self._owners = np.repeat(np.arange(len(landmarks)), len(SIZES))
        self._sides, self._rows = self._windows_of(camera)
        cells = [self._cells_of(landmarks[int(owner)], window) for window, owner in enumerate(self._owners)]
        order = self._group(np.stack([descriptor_of(window) for window in cells]))
        self._slopes = np.stack([known_slopes(cells[window]) for window in order])
        self._begins, places = self._places_of_bands()
        self._taps, self._power = np.empty((SIDE, places), np.float32), np.empty(places, np.float32)
        self._read = np.empty((FUNCTIONS, places), np.float32)
        most = max(group.count for group in self._groups)
        self._descriptors = np.empty(DESCRIPTOR_SIZE * most, np.float32)
        largest = max(len(block.low) * group.count for group in self._groups for block in group.blocks)
        self._products = np.empty(largest, np.float32)

    def candidates(self, pyramid: Pyramid) -> list[tuple[int, np.ndarray]]:
        """The landmarks that may be in the frame, the likeliest first: number and placement."""
        settings, levels = self._settings, self._levels
        levels.read(pyramid)
        score, level, column = self._best(levels)
        likely = np.flatnonzero(score >= settings.resemblance)
        if len(likely) > settings.windows:
            likely = likely[np.argpartition(-score[likely], settings.windows)[: settings.windows]]
        level, column = level[likely], column[likely]
        top = levels.horizons[level] + self._rows[likely]
        agreement, off = np.empty(len(likely), np.float32), np.zeros((len(likely), 2), np.int64)
        compare_slopes(levels.cells, levels.table, level, top, column, self._slopes, likely, agreement, off)
        order = np.argsort(-agreement)[: np.count_nonzero(agreement >= settings.agreement)]
        _, first = np.unique(self._owners[likely[order]], return_index=True)
        chosen = order[np.sort(first)[: settings.candidates]]
        window = likely[chosen]
        placements = self._placements(window, level[chosen], *(np.stack([column, top]) + off.T)[:, chosen])
        return list(zip(self._owners[window].tolist(), placements, strict=True))

    def _best(self, levels: Levels) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each landmark's window the cosine to the window of the frame that it resembles most; level and column."""
        count = len(self._owners)
        score = np.empty(count, np.float32)
        level, column = np.empty((2, count), np.int64)
        start = np.empty(len(levels.table) + 1, np.int64)
        gather_bands(levels.cells, levels.table, self._begins, self._taps)
        np.matmul(WINDOWS, self._taps, out=self._read)
        power_of(self._read, self._power)
        for group in self._groups:
            seen = self._descriptors[: DESCRIPTOR_SIZE * group.count].reshape(DESCRIPTOR_SIZE, group.count)
            put_together(self._read, self._power, levels.table, self._begins, group.rows, SIDE, start, seen)
            for block in group.blocks:
                first, here = int(start[block.low[0]]), block.windows
                shape = len(block.low), group.count - first
                products = self._products[: shape[0] * shape[1]].reshape(shape)
                np.matmul(block.descriptors, seen[:, first:], out=products)
                best_windows(products, first, start, block.low, block.high, score[here], level[here], column[here])
        return score, level, column

    def _group(self, descriptors: np.ndarray) -> np.ndarray:
        """Sort the windows, so that those of a group, and of a block in it, lie side by side."""
        levels, settings, slack = self._levels, self._settings, math.sqrt(LEVEL_STEP)
        zooms = np.where(self._is_place[:, None], settings.place_zooms, settings.zooms)[self._owners]
        low = np.searchsorted(levels.cell_x_px, self._sides * zooms[:, 0] / SIDE / slack)
        high = np.maximum(np.searchsorted(levels.cell_x_px, self._sides * zooms[:, 1] / SIDE * slack), low)
        order = np.lexsort([low, self._rows])
        self._owners, self._sides, self._rows = self._owners[order], self._sides[order], self._rows[order]
        low, high, descriptors = low[order], high[order], descriptors[order]
        self._groups: list[_Group] = []
        for begin, end in _runs(self._rows):
            cuts = _runs(low[begin:end] // BLOCK_LEVELS)
            parts = [slice(begin + first, begin + last) for first, last in cuts]
            blocks = [_Block(part, descriptors[part], low[part], high[part]) for part in parts]
            rows = levels.horizons // DEPTH + self._rows[begin] // DEPTH
            rows[(rows < 0) | (rows >= levels.rows)] = -1
            rows[: low[begin:end].min()] = rows[high[begin:end].max() :] = -1
            self._groups.append(_Group(blocks, rows, int(levels.windows[rows >= 0].sum())))
        return order

    def _places_of_bands(self) -> tuple[np.ndarray, int]:
        """Where each band that is asked for begins, see `gather_bands`; and how many places all of them have."""
        levels = self._levels
        asked = np.zeros((2, len(levels.table), max(levels.rows) + BANDS - 1), bool)
        for group in self._groups:
            there = np.flatnonzero(group.rows >= 0)
            asked[1, there, group.rows[there]] = True
            for band in range(BANDS):
                asked[0, there, group.rows[there] + band] = True
        sizes = np.where(asked, levels.spots[:, None], 0)
        ends = sizes.cumsum().reshape(sizes.shape)
        return np.where(asked, ends - sizes, -1), int(ends.flat[-1])

    def _windows_of(self, camera: PinholeCamera) -> tuple[np.ndarray, np.ndarray]:
        """The squares that are described: the middle of each landmark in the flat picture, in two sizes.

        Returns their sides in px, and their uppermost rows in cells from the horizon. The rows are rounded, so that
        what is described is what the look-up will read.
        """
        targets, places = self.placements[:, [WIDTH, HEIGHT]].min(1), self._settings.place_window * camera.height
        sides = np.outer(np.where(self._is_place, places, targets), SIZES).ravel()
        rows = SIDE * ((self.placements[self._owners, Y] - camera.cy) / sides - 0.5)
        return sides, (np.round(rows / DEPTH) * DEPTH).astype(np.int64)

    def _cells_of(self, landmark: Landmark, window: int) -> np.ndarray:
        """The landmark's small picture in this window, float32 (12, 12)."""
        side, camera = self._sides[window], self._camera
        steps = ((np.arange(SIDE * FINER) + 0.5) / (SIDE * FINER) - 0.5) * side
        middle_y = camera.cy + (self._rows[window] / SIDE + 0.5) * side
        x, y = np.meshgrid(self.placements[self._owners[window], X] + steps, middle_y + steps)
        fine = landmark.picture_at(x, y, camera)
        return np.asarray(cv2.resize(fine, (SIDE, SIDE), interpolation=cv2.INTER_AREA), np.float32)

    def _placements(self, windows: np.ndarray, level: np.ndarray, column: np.ndarray, top: np.ndarray) -> np.ndarray:
        """The placements that follow from where landmarks' windows were found."""
        cell_x_px, cell_y_px = self._levels.cell_x_px[level], self._levels.cell_y_px[level]
        owners, sides, camera = self._owners[windows], self._sides[windows], self._camera
        placements, zoom = self.placements[owners], SIDE * cell_x_px / sides
        aside_px = (self._rows[windows] / SIDE + 0.5) * sides - (placements[:, Y] - camera.cy)
        x = (column + SIDE / 2) * cell_x_px - 0.5
        azimuth = np.arctan((x - camera.cx) / camera.fx)
        placements[:, X] = np.where(self._is_place[owners], camera.cx + camera.fx * azimuth, x)
        placements[:, Y] = (top + SIDE / 2) * cell_y_px - 0.5 - zoom * aside_px
        placements[:, [WIDTH, HEIGHT]] *= zoom[:, None]
        return placements


def _runs(values: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end of every run of equal values."""
    cuts = (np.flatnonzero(np.diff(values)) + 1).tolist()
    return list(itertools.pairwise([0, *cuts, len(values)]))
