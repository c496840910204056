"""Finding the target without knowing where it was: all columns, all zooms from under a half to over two.

Enlarging the picture by g about its centre stretches a row and moves bands of rows away from the horizon. So band
heights, the pitch of the cells, and with it poles and anchors are all scaled together by the zoom under test; what
remains is a normalised correlation of signatures at every cell. A robot's camera keeps its height above the floor,
hence a target's row follows from its zoom: y_h + g (y0 - y_h), y_h the horizon. Where columns and zoom fit, the same
is done once upright, to find the row. What is found is then to be refined.

Cells are read from running sums (`boxes`) of pixels that suit them, as in tracking.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y
from base_station.trackers.ztransform.poles import PoleSettings, scale_weights, spiral_poles
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.search_kernels import (
    LANES,
    column_field,
    distinct,
    row_field,
    search_column,
    search_rows,
)


@dataclass(frozen=True, kw_only=True)
class AcquisitionSettings:
    """How far and how finely to search."""

    smallest_zoom: float = 0.42
    """Against the learned size."""
    largest_zoom: float = 2.4
    """Against the learned size."""
    log_zoom_step: float = 0.12
    """Natural logarithm; the regression's middle map reaches +-0.12, twice as far as the farthest zoom is then off."""
    cells: int = 32
    """Across the target; fewer where that would be under 1.5 px each."""
    bands: int = 3
    """Row bands across the target's height."""
    anchors: int = 7
    """Across the target."""
    spread: float = 0.72
    """The share of the width that the anchors span."""
    poles: PoleSettings = field(default_factory=lambda: PoleSettings(count=4, longest_cells=6.0, shortest_cells=1.8))
    """The scales."""
    candidates: int = 4
    """How many places to hand on."""
    least_share: float = 0.5
    """Of the learned energy that must lie in the frame."""
    row_reach: float = 0.6
    """In target heights: how far from where it should be the row is looked for."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A place where the target may be."""

    score: float
    """Normalised correlation of signatures, up to 1."""
    placement: np.ndarray
    """See `kernels`."""


@dataclass(frozen=True)
class _Template:
    """What is compared with every position: the target's signature along its rows, or down its columns."""

    cells: int
    """Across the target, or down."""
    anchors: np.ndarray
    """Offsets in cells."""
    learned: np.ndarray
    """float32 (anchors, numbers), of length 1."""
    energy: np.ndarray
    """Of each anchor."""


class Acquisition:
    """Remembers one target's signature and looks for it in whole frames."""

    def __init__(self, settings: AcquisitionSettings) -> None:
        self._settings = settings
        lanes, used = np.zeros((3, LANES), np.float32), settings.bands * settings.poles.count
        if used > LANES:
            raise ValueError(f"{settings.bands} bands of {settings.poles.count} poles do not fit in {LANES} lanes")
        poles = spiral_poles(settings.poles)
        for lane, values in zip(lanes, (poles.real, poles.imag, scale_weights(settings.poles)), strict=True):
            lane[:used] = np.tile(values, settings.bands)
        self._plan = settings.bands, settings.poles.count, lanes.ravel()
        """bands, poles in each, their parts, as the kernels take them."""

    def learn(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> None:
        """Remember the signature at this placement."""
        self._learned_at = placement.copy()
        cells, anchors = self._anchors(placement[WIDTH])
        pitch = placement[WIDTH] / cells
        before = math.ceil((placement[X] + 0.5) / pitch)
        after = math.ceil((pyramid.image.shape[1] - 0.5 - placement[X]) / pitch)
        start, y, height = placement[X] - (before + 0.5) * pitch, placement[Y], placement[HEIGHT]
        field = row_field(*pyramid.sums(pitch), lens, start, pitch, before + 1 + after, y, height, *self._plan)
        self._row = _template(field, cells, before, anchors)
        cells, anchors = self._anchors(placement[HEIGHT])
        pitch = placement[HEIGHT] / cells
        start, x, width = placement[Y] - (cells + 0.5) * pitch, placement[X], placement[WIDTH]
        field = column_field(*pyramid.sums(pitch), start, pitch, 2 * cells + 1, x, width, *self._plan)
        self._column = _template(field, cells, cells, anchors)

    def find(
        self,
        pyramid: Pyramid,
        lens: np.ndarray,
        *,
        zooms: tuple[float, float] | None = None,
        row: float | None = None,
        row_shift: float = 0.0,
    ) -> Iterator[Candidate]:
        """The best few places in this frame, best first; best in the search, that is: refine them to be sure.

        `zooms`: search this range only. Besides the row that the horizon rule says, look about `row` (px), and about
        `row_shift` target heights below the rule's.
        """
        settings, learned = self._settings, self._learned_at
        low, high = zooms or (settings.smallest_zoom, settings.largest_zoom)
        zoom = np.exp(np.arange(math.log(low), math.log(high) + 1e-9, settings.log_zoom_step))
        sizes = np.empty((len(zoom), 1 + (row is not None) + (row_shift != 0), 3))
        sizes[..., 1:] = zoom[:, None, None] * learned[[WIDTH, HEIGHT]]
        sizes[..., 0] = (lens[3] + zoom * (learned[Y] - lens[3]))[:, None]
        if row is not None:
            near = np.abs(row - sizes[:, 1, 0]) <= 0.15 * sizes[:, 1, 2]
            sizes[:, 1, 0] = np.where(near, np.nan, row)
        if row_shift:
            sizes[:, -1, 0] += row_shift * sizes[:, -1, 2]
        found, tried = self._search(pyramid, lens, sizes).reshape(-1, 2), sizes.reshape(-1, 3)
        for n in distinct(tried, found, settings.candidates):
            placement = np.array([found[n, 1], *tried[n], 0.0])
            if lens[0] <= 0:
                self._to_best_row(pyramid, placement)
            yield Candidate(score=float(found[n, 0]), placement=placement)

    def _search(self, pyramid: Pyramid, lens: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        """Best score and its x for each of `sizes`, (zooms, rows, 3): y, width, height, from small to large; NaN: none.
        All that suit the same sums in one call."""
        template, pitches = self._row, sizes[:, 0, 1] / self._row.cells
        found, first = np.empty((*sizes.shape[:2], 2)), 0
        while first < len(sizes):
            table, where = pyramid.sums(float(pitches[first]))
            beyond = max(int(np.searchsorted(pitches, pyramid.coarser(where))), first + 1)
            search_rows(
                table, where, lens, sizes[first:beyond].reshape(-1, 3), template.cells, template.learned,
                template.energy, template.anchors, self._settings.least_share, *self._plan,
                found[first:beyond].reshape(-1, 2),
            )  # fmt: skip
            first = beyond
        return found

    def _to_best_row(self, pyramid: Pyramid, placement: np.ndarray) -> None:
        """Move the placement up or down to where its columns fit best, if they fit anywhere."""
        settings, template = self._settings, self._column
        score, y = search_column(
            *pyramid.sums(float(placement[HEIGHT]) / template.cells), placement, settings.row_reach, template.cells,
            template.learned, template.energy, template.anchors, settings.least_share, *self._plan,
        )  # fmt: skip
        if score > 0.5:
            placement[Y] = y

    def _anchors(self, side_px: float) -> tuple[int, np.ndarray]:
        """Cells along a side of the target, and the anchors' offsets in them."""
        settings = self._settings
        cells = int(np.clip(side_px / 1.5, 12, settings.cells))
        return cells, np.round(np.linspace(-0.5, 0.5, settings.anchors) * settings.spread * cells).astype(np.int64)


def _template(field: np.ndarray, cells: int, middle: int, anchors: np.ndarray) -> _Template:
    """From the field about a target whose middle is in this cell. Anchors outside of the field count nothing."""
    at = middle + anchors
    inside = (at >= 0) & (at < len(field))
    learned = np.where(inside[:, None], field[at.clip(0, len(field) - 1)], 0)
    learned = np.ascontiguousarray(learned / max(float(np.sqrt((learned**2).sum())), 1e-6), np.float32)
    return _Template(cells, anchors, learned, np.square(learned).sum(1))
