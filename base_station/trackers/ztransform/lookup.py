"""Which of many landmarks are in a frame, where and how large: some milliseconds for hundreds of them.

A window of 12 x 12 cells is described by 48 numbers: three row bands and three column bands, each read by two-sided
second-order complex poles about its middle (projected to eight numbers), all of length 1. The frame is reduced to some
twenty levels of cells, each 15 % coarser, so that a window is 36 px wide in the finest and the whole height in the
coarsest; all windows of a row of windows are described at once.

Which rows? A robot's camera keeps its height, so a landmark's row follows from its size: y_h + g (y0 - y_h). In units
of the window that is the same row at every level, for all landmarks that stand at the same height against their size.
They share one row of windows per level, and comparing them with all windows of all levels is one matrix product.

The best landmarks by that product are refined by the tracker's own regression on a small signature (24 cells), and
believed if the full one (48 cells) agrees.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y, inner
from base_station.trackers.ztransform.landmark import (
    BOX_CELLS,
    CELLS,
    Landmark,
    azimuth_px,
    box_placement,
    check_name,
    small_picture,
)
from base_station.trackers.ztransform.lookup_kernels import best_positions, gather_profiles, inverse_lengths
from base_station.trackers.ztransform.outline import lens_of, outline, place_placement, to_pixel
from base_station.trackers.ztransform.poles import PoleSettings
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.refinement import refine
from base_station.trackers.ztransform.regression import Disturbance, RegressionSettings, learn_maps
from base_station.trackers.ztransform.signature import SignatureReader, SignatureSettings
from base_station.trackers.ztransform.texture import texture_of
from base_station.trackers.ztransform.windows import (
    BANDS,
    COLUMN_STEP,
    DESCRIPTOR_SIZE,
    LEVEL_STEP,
    SIDE,
    WINDOWS,
    Levels,
    descriptor_at,
)
from base_station.types import Box, Frame

SMALL = SignatureSettings(
    cells=24, bands=2, anchors=3, spread=0.6, poles=PoleSettings(count=4, longest_cells=6.0, shortest_cells=1.2)
)
SMALL_SIZE = SignatureReader(SMALL).size
SMALL_REGRESSION = RegressionSettings(
    levels=(Disturbance(shift=0.12, log_zoom=0.12, log_aspect=0.06, keystone=0.06),), samples=250
)
SIZES = (2 ** (-1 / 20), 2 ** (1 / 20))
"""Of the windows that describe a landmark: between them they halve the step of the levels."""
BLOCK_LEVELS = 3
ROW_STEP = 3
"""In cells: how far apart the rows of windows are."""
_BOX = slice((CELLS - BOX_CELLS) // 2, (CELLS + BOX_CELLS) // 2)
_FREE, _FREE_PLACE = np.array([1.0, 1.0, 1.0, 1.0, 1.0]), np.array([1.0, 1.0, -1.0, 1.0, 0.0])
_ONE_STEP, _TWO_STEPS, _MORE_STEPS = (np.zeros(steps, np.int64) for steps in (1, 2, 4))


@dataclass(frozen=True, kw_only=True)
class LookupSettings:
    """What to look for, and when to believe it."""

    zooms: tuple[float, float] = (0.42, 2.4)
    """Of targets, against the learned size."""
    place_zooms: tuple[float, float] = (0.8, 1.25)
    place_window: float = 0.6
    """A place is first looked for by its middle; this share of the frame's height."""
    candidates: int = 16
    """How many landmarks the full comparison is made for."""
    resemblance: float = 0.69
    """Of the descriptors (normalised correlation); with less no comparison is made."""
    worth_a_step: float = 0.3
    """Confidence on the small signature after one step of refinement, from which on another is made."""
    worth_a_look: float = 0.6
    """Confidence on the small signature from which the full one is read."""
    confidence: float = 0.8
    """Believed from here on."""
    least_share: float = 0.6
    """Of a landmark that must lie in the frame."""
    least_texture: float = 1.5
    """Grey levels; with less there is nothing to remember."""
    smallest_side_px: float = 24.0
    """Of a target, to be learned as a landmark."""


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """A landmark that is seen. Angles and zoom as in `TrackerResult`."""

    landmark: Landmark
    confidence: float
    placement: np.ndarray
    """See `kernels`."""
    bearing_rad: float
    elevation_rad: float
    zoom: float
    box: Box


@dataclass(frozen=True)
class _Group:
    """Landmarks that share their rows of windows."""

    members: np.ndarray
    descriptors: np.ndarray
    tops: np.ndarray
    """The windows' uppermost row in each level; -1 where they would not lie in the frame, or nobody asks for them."""
    positions: int
    """How many windows that makes."""
    low: np.ndarray
    """Of each member the first level in its range of zooms."""
    high: np.ndarray
    """One after the last."""
    blocks: tuple[tuple[int, int], ...]
    """Members, by their first level, that are compared in one product: who is large needs not the fine levels."""


@dataclass(frozen=True)
class _Plan:
    """What a look-up needs of all landmarks, for one camera."""

    camera: PinholeCamera
    only: str | None
    landmarks: list[Landmark]
    placements: np.ndarray
    owners: np.ndarray
    """Of each window that is described, the landmark's number."""
    sides: np.ndarray
    """Of each window, px."""
    rows: np.ndarray
    """Of each window, see `_windows_of`."""
    groups: list[_Group]


class LandmarkMemory:
    """Landmarks by name. All of them are looked for together."""

    def __init__(self, settings: LookupSettings | None = None) -> None:
        self._settings = settings or LookupSettings()
        self._small, self._full = SignatureReader(SMALL), SignatureReader(SignatureSettings())
        self._landmarks: dict[str, Landmark] = {}
        self._plan: _Plan | None = None
        self._levels: Levels | None = None
        self._profiles = np.empty(0, np.float32)

    def __len__(self) -> int:
        return len(self._landmarks)

    @property
    def landmarks(self) -> list[Landmark]:
        """In the order in which they were learned."""
        return list(self._landmarks.values())

    def __getitem__(self, name: str) -> Landmark:
        """Raises KeyError for a name that is not known."""
        return self._landmarks[name]

    def add(self, landmark: Landmark) -> None:
        """Replaces one of the same name."""
        check_name(landmark.name)
        self._landmarks[landmark.name] = landmark
        self._plan = None

    def forget(self, name: str) -> None:
        """Raises KeyError for a name that is not known."""
        del self._landmarks[name]
        self._plan = None

    def learn(self, name: str, frame: Frame, box: Box | None, *, learned_depth_m: float | None = None) -> Landmark:
        """Remember what is in the box, or with None the whole view. Replaces a landmark of the same name.

        Raises ValueError, with the reason in words, when there is nothing there to remember, or the name is none.
        """
        check_name(name)
        curved, camera, pyramid = box is None, frame.camera, Pyramid(frame.image)
        self._check(box, frame)
        placement = place_placement(camera) if box is None else box_placement(box)
        lens = lens_of(camera, curved=curved)
        picture = small_picture(pyramid, placement, camera, curved=curved)
        inside = picture[_BOX, _BOX].astype(np.float32)
        if texture_of(inside, 1) < self._settings.least_texture:
            raise ValueError(f"featureless: its texture is {texture_of(inside, 1):.1f} grey levels")
        landmark = Landmark(
            name=name,
            camera=camera,
            box=box,
            picture=picture,
            descriptors=self._describe(pyramid, placement, camera, is_place=curved),
            step_map=learn_maps(pyramid, placement, lens, self._small, SMALL_REGRESSION)[0].astype(np.float16),
            learned_depth_m=learned_depth_m,
        )
        self.add(landmark)
        return landmark

    def find(self, frame: Frame, *, only: str | None = None) -> list[Sighting]:
        """The landmarks that this frame shows, the surest first. Where two lie on the same spot, the surer one.

        `only`: look for this one alone, which takes a fraction of the time.
        """
        landmarks = self.landmarks if only is None else [self._landmarks[only]]
        if not landmarks:
            return []
        pyramid, plan = Pyramid(frame.image), self._planned(frame.camera, landmarks, only)
        sightings = [self._verify(pyramid, plan, number, start) for number, start in self._candidates(pyramid, plan)]
        seen = [sighting for sighting in sightings if sighting is not None]
        kept: list[Sighting] = []
        for sighting in sorted(seen, key=lambda s: -s.confidence):
            if not any(_same_spot(sighting, other) for other in kept):
                kept.append(sighting)
        return kept

    def _check(self, box: Box | None, frame: Frame) -> None:
        if box is None:
            return
        rows, columns = frame.image.shape
        inside = box.clipped(columns, rows)
        if inside is None:
            raise ValueError("the box is outside of the frame")
        if inside.width * inside.height < 0.8 * box.width * box.height:
            raise ValueError("a fifth or more of the box is outside of the frame")
        if min(box.width, box.height) < self._settings.smallest_side_px:
            raise ValueError(f"too small: {box.width:.0f}x{box.height:.0f} px")

    def _windows_of(
        self, placement: np.ndarray, camera: PinholeCamera, *, is_place: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        """The squares that are described: the middle of the placement in the flat picture, in two sizes.

        Returns their sides in px, and their uppermost rows in cells from the horizon. The rows are rounded, so that
        what is described is what the look-up will read.
        """
        side = min(placement[WIDTH], placement[HEIGHT])
        if is_place:
            side = self._settings.place_window * camera.height
        sides = side * np.array(SIZES)
        rows = SIDE * ((placement[Y] - camera.cy) / sides - 0.5)
        return sides, (np.round(rows / ROW_STEP) * ROW_STEP).astype(int)

    def _planned(self, camera: PinholeCamera, landmarks: list[Landmark], only: str | None) -> _Plan:
        """Group the landmarks by their row, for this camera; done again only when one of them changed."""
        if self._plan is not None and self._plan.camera == camera and self._plan.only == only:
            return self._plan
        settings, levels = self._settings, Levels(camera.height, camera.width)
        placements = np.stack([landmark.placement(camera) for landmark in landmarks])
        is_place = np.array([landmark.box is None for landmark in landmarks])
        windows = [
            self._windows_of(p, camera, is_place=bool(place)) for p, place in zip(placements, is_place, strict=True)
        ]
        sides, rows = (np.concatenate([window[part] for window in windows]) for part in (0, 1))
        owners = np.repeat(np.arange(len(landmarks)), len(SIZES))
        descriptors = np.concatenate([landmark.descriptors for landmark in landmarks])
        zooms = np.where(is_place[:, None], settings.place_zooms, settings.zooms)[owners]
        slack = math.sqrt(LEVEL_STEP)
        low = np.searchsorted(levels.cell_x_px, sides * zooms[:, 0] / SIDE / slack)
        high = np.maximum(np.searchsorted(levels.cell_x_px, sides * zooms[:, 1] / SIDE * slack), low)
        groups = []
        for row in np.unique(rows):
            members = np.flatnonzero(rows == row)
            members = members[np.argsort(low[members], kind="stable")]
            tops = np.round((camera.cy + 0.5) / levels.cell_y_px + row).astype(np.int64)
            tops[(tops < 0) | (tops > levels.heights - SIDE)] = -1
            tops[: low[members].min()] = tops[high[members].max() :] = -1
            positions = int(np.maximum((levels.widths - SIDE) // COLUMN_STEP + 1, 0)[tops >= 0].sum())
            cuts = np.flatnonzero(np.diff(low[members] // BLOCK_LEVELS)) + 1
            blocks = tuple(itertools.pairwise([0, *(int(cut) for cut in cuts), len(members)]))
            groups.append(_Group(members, descriptors[members], tops, positions, low[members], high[members], blocks))
        self._plan, self._levels = _Plan(camera, only, landmarks, placements, owners, sides, rows, groups), levels
        room = int(np.maximum((levels.widths - SIDE) // COLUMN_STEP + 1, 0).sum())
        self._profiles = np.empty(SIDE * 2 * BANDS * room, np.float32)
        return self._plan

    def _candidates(self, pyramid: Pyramid, plan: _Plan) -> list[tuple[int, np.ndarray]]:
        """The landmarks that resemble a window most, by number, and the placements that follow from the window."""
        levels = self._levels
        assert levels is not None
        levels.read(pyramid)
        count = len(plan.owners)
        score = np.empty(count, np.float32)
        level, column, top = (np.empty(count, np.int64) for _ in range(3))
        starts = np.empty(len(levels.widths) + 1, np.int64)
        for group in plan.groups:
            members, room = len(group.members), group.positions
            profiles = self._profiles[: SIDE * 2 * BANDS * room].reshape(SIDE, 2 * BANDS, room)
            gather_profiles(levels.cells, levels.offsets, levels.widths, group.tops, SIDE, BANDS, profiles, starts)
            read = (WINDOWS @ profiles.reshape(SIDE, -1)).reshape(DESCRIPTOR_SIZE, room)
            inverse = np.empty(room, np.float32)
            inverse_lengths(read, inverse)
            best, best_score = np.empty(members, np.int64), np.empty(members, np.float32)
            for begin, end in group.blocks:
                first = int(starts[group.low[begin]])
                part = slice(begin, end)
                best_positions(
                    group.descriptors[part] @ read[:, first:], inverse, first, starts, group.low[part],
                    group.high[part], best[part], best_score[part],
                )  # fmt: skip
            at = np.searchsorted(starts, best, side="right") - 1
            score[group.members], level[group.members] = best_score, at
            column[group.members], top[group.members] = (best - starts[at]) * COLUMN_STEP, group.tops[at]
        candidates: dict[int, np.ndarray] = {}
        for i in np.argsort(-score):
            if score[i] < self._settings.resemblance or len(candidates) == self._settings.candidates:
                break
            if plan.owners[i] not in candidates:
                candidates[int(plan.owners[i])] = self._start(plan, i, level[i], column[i], top[i])
        return list(candidates.items())

    def _start(self, plan: _Plan, window: int, level: int, column: int, top: int) -> np.ndarray:
        """The placement that follows from where a landmark's window was found."""
        assert self._levels is not None
        cell_x_px, cell_y_px = self._levels.cell_x_px[level], self._levels.cell_y_px[level]
        number, camera = plan.owners[window], plan.camera
        placement, zoom = plan.placements[number].copy(), SIDE * cell_x_px / plan.sides[window]
        aside_px = (plan.rows[window] / SIDE + 0.5) * plan.sides[window] - (placement[Y] - camera.cy)
        x = (column + SIDE / 2) * cell_x_px - 0.5
        placement[X] = azimuth_px(x, camera) if plan.landmarks[number].box is None else x
        placement[Y] = (top + SIDE / 2) * cell_y_px - 0.5 - zoom * aside_px
        placement[[WIDTH, HEIGHT]] *= zoom
        return placement

    def _describe(
        self, pyramid: Pyramid, placement: np.ndarray, camera: PinholeCamera, *, is_place: bool
    ) -> np.ndarray:
        """float32 (2, 48), one for each size."""
        sides, rows = self._windows_of(placement, camera, is_place=is_place)
        out = [
            descriptor_at(pyramid, np.array([placement[X], camera.cy + (row / SIDE + 0.5) * side, side, side, 0.0]))
            for side, row in zip(sides, rows, strict=True)
        ]
        return np.stack(out)

    def _verify(self, pyramid: Pyramid, plan: _Plan, number: int, start: np.ndarray) -> Sighting | None:
        """Refine the placement; None unless both signatures agree there."""
        settings, landmark, camera = self._settings, plan.landmarks[number], plan.camera
        is_place = landmark.box is None
        lens = lens_of(camera, curved=is_place)
        inside = landmark.picture[_BOX, _BOX].astype(np.float32)
        patch = cv2.resize(inside, (SMALL.cells, SMALL.cells), interpolation=cv2.INTER_AREA)
        signature, placement = self._small.signature(patch)[0], start.copy()
        cells, step_map = self._small.cells, landmark.step_map.astype(np.float32)[None]
        scratch = np.empty((cells, cells), np.float32), np.empty((cells, cells), np.uint8), np.empty_like(signature)
        confidence, share, source = 0.0, 0.0, self._small.source(pyramid, placement)
        for least, turns in (
            (settings.worth_a_step, _ONE_STEP),
            (settings.worth_a_look, _TWO_STEPS),
            (settings.worth_a_look, _MORE_STEPS),
        ):
            confidence, share, _ = refine(
                *source, lens, placement, patch, signature, step_map, turns,
                _FREE_PLACE if is_place else _FREE, 0.002, *scratch, *self._small.plan,
            )  # fmt: skip
            if confidence < least or share < settings.least_share:
                return None
        now = self._full.read(pyramid, placement, lens, inside)
        confidence = float(inner(now, self._full.signature(inside)[0]))
        if confidence < settings.confidence:
            return None
        x, y = to_pixel(placement[X], placement[Y], lens)
        return Sighting(
            landmark=landmark,
            confidence=min(confidence, 1.0),
            placement=placement,
            bearing_rad=camera.bearing_rad(x),
            elevation_rad=camera.elevation_rad(y),
            zoom=float(placement[HEIGHT] / plan.placements[number][HEIGHT]),
            box=outline(placement, lens),
        )


def _same_spot(one: Sighting, other: Sighting) -> bool:
    (x, y), (ox, oy) = one.box.center_px, other.box.center_px
    return abs(x - ox) < 0.25 * other.box.width and abs(y - oy) < 0.25 * other.box.height
