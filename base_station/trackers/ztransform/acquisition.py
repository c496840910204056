"""Finding the target without knowing where it was: all columns, all zooms from under a half to over two.

Enlarging the picture by g about its centre stretches a row and moves bands of rows away from the horizon. So band
heights, the pitch of the cells, and with it poles and anchors are all scaled together by the zoom under test; what
remains is a normalised correlation of signatures at every cell. A robot's camera keeps its height above the floor,
hence a target's row follows from its zoom: y_h + g (y0 - y_h), y_h the horizon. Where columns and zoom fit, the same
is done once upright, to find the row. What is found is then to be refined.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y
from base_station.trackers.ztransform.poles import PoleSettings, scale_weights, spiral_poles
from base_station.trackers.ztransform.search_kernels import (
    band_profile,
    read_field,
    score_positions,
    sum_rows,
    upright_profile,
)


@dataclass(frozen=True, kw_only=True)
class AcquisitionSettings:
    """How far and how finely to search."""

    smallest_zoom: float = 0.42
    """Against the learned size."""
    largest_zoom: float = 2.4
    """Against the learned size."""
    log_zoom_step: float = 0.09
    """Natural logarithm; the regression's middle map reaches +-0.12."""
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


class Acquisition:
    """Remembers one target's signature and looks for it in whole frames."""

    def __init__(self, settings: AcquisitionSettings) -> None:
        self._settings = settings
        poles = spiral_poles(settings.poles)
        self._poles = (
            poles.real.astype(np.float32),
            poles.imag.astype(np.float32),
            scale_weights(settings.poles).astype(np.float32),
        )
        self._sums = np.empty((0, 0), np.int32)

    def learn(self, image: np.ndarray, placement: np.ndarray, lens: np.ndarray) -> None:
        """Remember the signature at this placement."""
        settings = self._settings
        self._learned_at = placement.copy()
        self._cells = int(np.clip(placement[WIDTH] / 1.5, 12, settings.cells))
        self._anchors = np.round(np.linspace(-0.5, 0.5, settings.anchors) * settings.spread * self._cells).astype(int)
        self._sum(image)
        pitch = placement[WIDTH] / self._cells
        before = math.ceil((placement[X] + 0.5) / pitch)
        start = placement[X] - (before + 0.5) * pitch
        after = math.ceil((image.shape[1] - 0.5 - placement[X]) / pitch)
        fields = self._fields(start, pitch, before + 1 + after, placement[Y], placement[HEIGHT], lens)
        columns = before + self._anchors
        inside = (columns >= 0) & (columns < fields.shape[1])
        learned = np.where(inside[:, None, None], fields[:, columns.clip(0, fields.shape[1] - 1)].transpose(1, 0, 2), 0)
        self._learned = np.ascontiguousarray(learned / max(float(np.sqrt((learned**2).sum())), 1e-6), np.float32)
        self._energy = np.square(self._learned).sum((1, 2))
        self._learn_upright(placement)

    def find(
        self,
        image: np.ndarray,
        lens: np.ndarray,
        *,
        zooms: tuple[float, float] | None = None,
        row: float | None = None,
        row_shift: float = 0.0,
    ) -> list[Candidate]:
        """The best few places in this frame, best first; best in the search, that is: refine them to be sure.

        `zooms`: search this range only. Besides the row that the horizon rule says, look about `row` (px), and about
        `row_shift` target heights below the rule's.
        """
        settings, learned = self._settings, self._learned_at
        low, high = zooms or (settings.smallest_zoom, settings.largest_zoom)
        self._sum(image)
        found = []
        for zoom in np.exp(np.arange(math.log(low), math.log(high) + 1e-9, settings.log_zoom_step)):
            width, height = learned[WIDTH] * zoom, learned[HEIGHT] * zoom
            rows = [lens[3] + zoom * (learned[Y] - lens[3])]
            if row is not None and abs(row - rows[0]) > 0.15 * height:
                rows.append(row)
            if row_shift:
                rows.append(rows[0] + row_shift * height)
            for y in rows:
                score, x = self._best_column(image.shape[1], width, height, y, lens)
                found.append(Candidate(score=score, placement=np.array([x, y, width, height, 0.0])))
        best = self._distinct(found)
        return best if lens[0] > 0 else [self._with_row(candidate) for candidate in best]

    def _learn_upright(self, placement: np.ndarray) -> None:
        self._upright_cells = int(np.clip(placement[HEIGHT] / 1.5, 12, self._settings.cells))
        spread = np.linspace(-0.5, 0.5, self._settings.anchors) * self._settings.spread
        self._upright_anchors = np.round(spread * self._upright_cells).astype(int)
        pitch, reach = placement[HEIGHT] / self._upright_cells, self._upright_cells
        start = placement[Y] - (reach + 0.5) * pitch
        fields = self._upright_fields(start, pitch, 2 * reach + 1, placement[X], placement[WIDTH])
        learned = fields[:, reach + self._upright_anchors].transpose(1, 0, 2)
        self._upright = np.ascontiguousarray(learned / max(float(np.sqrt((learned**2).sum())), 1e-6), np.float32)
        self._upright_energy = np.square(self._upright).sum((1, 2))

    def _with_row(self, candidate: Candidate) -> Candidate:
        """The candidate moved up or down to where its columns fit best, if they fit anywhere."""
        placement, settings = candidate.placement.copy(), self._settings
        pitch = placement[HEIGHT] / self._upright_cells
        reach = self._upright_cells
        start = placement[Y] - (reach + 0.5) * pitch
        fields = self._upright_fields(start, pitch, 2 * reach + 1, placement[X], placement[WIDTH])
        scores = np.empty(2 * reach + 1, np.float32)
        score_positions(
            fields, self._upright, self._upright_energy, self._upright_anchors, settings.least_share, scores
        )
        away = math.ceil(settings.row_reach * self._upright_cells)
        best = reach - away + int(scores[reach - away : reach + away + 1].argmax())
        if scores[best] > 0.5:
            placement[Y] = start + (best + 0.5 + _vertex(scores, best)) * pitch
        return Candidate(score=candidate.score, placement=placement)

    def _upright_fields(self, start: float, pitch: float, count: int, x: float, width: float) -> np.ndarray:
        """As `_fields`, of upright bands: cells from row `start` on."""
        settings = self._settings
        edges = start + 0.5 + pitch * np.arange(count + 1)
        fields = np.empty((settings.bands, count, settings.poles.count, 2, 2), np.float32)
        profile, depth = np.empty(count, np.float32), 0.9 * width / settings.bands
        for band in range(settings.bands):
            middle = x + 0.5 + (band - (settings.bands - 1) / 2) * depth
            upright_profile(self._sums, middle - depth / 2, middle + depth / 2, edges, profile)
            read_field(profile, *self._poles, fields[band])
        return fields.reshape(settings.bands, count, -1)

    def _sum(self, image: np.ndarray) -> None:
        if self._sums.shape != (image.shape[0] + 1, image.shape[1]):
            self._sums = np.empty((image.shape[0] + 1, image.shape[1]), np.int32)
        sum_rows(image, self._sums)

    def _best_column(
        self, columns: int, width: float, height: float, y: float, lens: np.ndarray
    ) -> tuple[float, float]:
        pitch = width / self._cells
        left, right = -0.5, columns - 0.5
        if lens[0] > 0:
            left, right = (lens[2] + lens[1] * math.atan((x - lens[2]) / lens[1]) for x in (left, right))
        count = int((right - left) / pitch)
        if count < 3:
            return -1.0, 0.0
        fields = self._fields(left, pitch, count, y, height, lens)
        scores = np.empty(count, np.float32)
        score_positions(fields, self._learned, self._energy, self._anchors, self._settings.least_share, scores)
        best = int(scores.argmax())
        return float(scores[best]), left + (best + 0.5 + _vertex(scores, best)) * pitch

    def _fields(self, start: float, pitch: float, count: int, y: float, height: float, lens: np.ndarray) -> np.ndarray:
        """Fields of all bands, float32 (bands, count, numbers), of cells from `start` (px, left edge) on."""
        settings = self._settings
        edges = start + pitch * np.arange(count + 1)
        if lens[0] > 0:
            edges = lens[2] + lens[1] * np.tan(np.clip((edges - lens[2]) / lens[1], -1.2, 1.2))
        edges += 0.5
        fields = np.empty((settings.bands, count, settings.poles.count, 2, 2), np.float32)
        profile, running = np.empty(count, np.float32), np.empty(self._sums.shape[1] + 1)
        depth = 0.9 * height / settings.bands
        for band in range(settings.bands):
            middle = y + 0.5 + (band - (settings.bands - 1) / 2) * depth
            band_profile(self._sums, middle - depth / 2, middle + depth / 2, edges, running, profile)
            read_field(profile, *self._poles, fields[band])
        return fields.reshape(settings.bands, count, -1)

    def _distinct(self, found: list[Candidate]) -> list[Candidate]:
        """The best, leaving out neighbours of better ones."""
        kept: list[Candidate] = []
        for candidate in sorted(found, key=lambda c: -c.score):
            p = candidate.placement
            near = any(
                abs(p[X] - q.placement[X]) < 0.1 * q.placement[WIDTH]
                and abs(p[Y] - q.placement[Y]) < 0.15 * q.placement[HEIGHT]
                and abs(math.log(p[WIDTH] / q.placement[WIDTH])) < 0.1
                for q in kept
            )
            if not near and candidate.score > 0:
                kept.append(candidate)
            if len(kept) == self._settings.candidates:
                break
        return kept


def _vertex(values: np.ndarray, n: int) -> float:
    """Where the parabola through three neighbouring values peaks, against the middle one; within +-0.5."""
    if not 0 < n < len(values) - 1:
        return 0.0
    left, middle, right = (float(values[i]) for i in (n - 1, n, n + 1))
    bend = left - 2 * middle + right
    return min(max(0.5 * (left - right) / bend, -0.5), 0.5) if bend < 0 else 0.0
