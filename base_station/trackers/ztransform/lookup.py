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
    cells=24,
    bands=2,
    anchors=3,
    spread=0.6,
    poles=PoleSettings(count=4, longest_cells=6.0, shortest_cells=1.2),
    is_compact=False,  # landmark files hold maps of these numbers
)
SMALL_SIZE = SignatureReader(SMALL).size
SMALL_REGRESSION = RegressionSettings(
    levels=(Disturbance(shift=0.12, log_zoom=0.12, log_aspect=0.06, keystone=0.06),), samples=250
)
SIZES = (0.93 * 2 ** (-1 / 20), 0.93 * 2 ** (1 / 20))
"""Of the windows that describe a landmark: between them they halve the step of the levels."""
BLOCK_LEVELS = 3
ROW_STEP = 4
"""In cells: how far apart the rows of windows are."""
_BOX = slice((CELLS - BOX_CELLS) // 2, (CELLS + BOX_CELLS) // 2)
_FREE, _FREE_PLACE = np.array([1.0, 1.0, 1.0, 1.0, 1.0]), np.array([1.0, 1.0, -1.0, 1.0, 0.0])
_ONE_STEP, _TWO_STEPS, _MORE_STEPS = (np.zeros(steps, np.int64) for steps in (1, 2, 2))


@dataclass(frozen=True, kw_only=True)
class LookupSettings:
    """What to look for, and when to believe it."""

    zooms: tuple[float, float] = (0.42, 2.4)
    """Of targets, against the learned size."""
    place_zooms: tuple[float, float] = (0.8, 1.25)
    place_window: float = 0.45
    """A place is first looked for by its middle; this share of the frame's height."""
    candidates: int = 16
    """How many landmarks the full comparison is made for."""
    resemblance: float = 0.5
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
class _Block:
    """Landmarks' windows that are compared in one product: they need about the same levels."""

    windows: slice
    """Which, of all windows in the plan."""
    descriptors: np.ndarray
    low: np.ndarray
    """Of each the first level in its range of zooms."""
    high: np.ndarray
    """One after the last."""


@dataclass(frozen=True)
class _Group:
    """Landmarks' windows that share a row of windows in the frame."""

    blocks: list[_Block]
    tops: np.ndarray
    """The uppermost row in each level; -1 where it would not lie in the frame, or nobody asks for it."""
    positions: int
    """How many windows of the frame that makes."""


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
    group_of: np.ndarray
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
        order = np.lexsort([low, rows])  # windows of one group, and of one block in it, lie side by side
        owners, sides, rows, low, high, descriptors = (
            part[order] for part in (owners, sides, rows, low, high, descriptors)
        )
        groups: list[_Group] = []
        group_of = np.empty(len(order), np.int64)
        for begin, end in _runs(rows):
            cuts = _runs(low[begin:end] // BLOCK_LEVELS)
            parts = [slice(begin + first, begin + last) for first, last in cuts]
            blocks = [_Block(part, descriptors[part], low[part], high[part]) for part in parts]
            tops = np.round((camera.cy + 0.5) / levels.cell_y_px + rows[begin]).astype(np.int64)
            tops[(tops < 0) | (tops > levels.heights - SIDE)] = -1
            tops[: low[begin:end].min()] = tops[high[begin:end].max() :] = -1
            positions = int(np.maximum((levels.widths - SIDE) // COLUMN_STEP + 1, 0)[tops >= 0].sum())
            group_of[begin:end] = len(groups)
            groups.append(_Group(blocks, tops, positions))
        self._plan = _Plan(camera, only, landmarks, placements, owners, sides, rows, group_of, groups)
        self._levels = levels
        room = int(np.maximum((levels.widths - SIDE) // COLUMN_STEP + 1, 0).sum())
        self._profiles = np.empty(SIDE * 2 * BANDS * room, np.float32)
        return self._plan

    def _candidates(self, pyramid: Pyramid, plan: _Plan) -> list[tuple[int, np.ndarray]]:
        """The landmarks that resemble a window most, by number, and the placements that follow from the window."""
        levels = self._levels
        assert levels is not None
        levels.read(pyramid)
        score, best = np.empty(len(plan.owners), np.float32), np.empty(len(plan.owners), np.int64)
        starts = np.empty((len(plan.groups), len(levels.widths) + 1), np.int64)
        for group, start in zip(plan.groups, starts, strict=True):
            profiles = self._profiles[: SIDE * 2 * BANDS * group.positions].reshape(SIDE, 2 * BANDS, group.positions)
            gather_profiles(levels.cells, levels.offsets, levels.widths, group.tops, SIDE, BANDS, profiles, start)
            read = (WINDOWS @ profiles.reshape(SIDE, -1)).reshape(DESCRIPTOR_SIZE, group.positions)
            inverse = np.empty(group.positions, np.float32)
            inverse_lengths(read, inverse)
            for block in group.blocks:
                first = int(start[block.low[0]])
                best_positions(
                    block.descriptors @ read[:, first:], inverse, first, start, block.low, block.high,
                    best[block.windows], score[block.windows],
                )  # fmt: skip
        candidates: dict[int, np.ndarray] = {}
        for window in np.argsort(-score):
            if score[window] < self._settings.resemblance or len(candidates) == self._settings.candidates:
                break
            owner, number = int(plan.owners[window]), int(plan.group_of[window])
            if owner not in candidates:
                level = int(np.searchsorted(starts[number], best[window], side="right")) - 1
                column = COLUMN_STEP * int(best[window] - starts[number, level])
                candidates[owner] = self._start(plan, window, level, column, int(plan.groups[number].tops[level]))
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
        inside = landmark.picture[_BOX, _BOX]
        patch = cv2.resize(inside, (SMALL.cells, SMALL.cells), interpolation=cv2.INTER_AREA).astype(np.float32)
        signature, placement = self._small.signature(patch)[0], start.copy()
        step_map = landmark.step_map.astype(np.float32)[None]
        confidence, share, source = 0.0, 0.0, self._small.source(pyramid, placement, lens, whole=True)
        for least, turns in (
            (settings.worth_a_step, _ONE_STEP),
            (settings.worth_a_look, _TWO_STEPS),
            (settings.worth_a_look, _MORE_STEPS),
        ):
            confidence, share = refine(
                *source, lens, placement, patch, signature, step_map, turns,
                _FREE_PLACE if is_place else _FREE, 0.002, *self._small.plan,
            )  # fmt: skip
            if confidence < least or share < settings.least_share:
                return None
        learned = inside.astype(np.float32)
        now = self._full.read(pyramid, placement, lens, learned)
        confidence = float(inner(now, self._full.signature(learned)[0]))
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


def _runs(values: np.ndarray) -> list[tuple[int, int]]:
    """Begin and end of every run of equal values."""
    cuts = (np.flatnonzero(np.diff(values)) + 1).tolist()
    return list(itertools.pairwise([0, *cuts, len(values)]))


def _same_spot(one: Sighting, other: Sighting) -> bool:
    (x, y), (ox, oy) = one.box.center_px, other.box.center_px
    return abs(x - ox) < 0.25 * other.box.width and abs(y - oy) < 0.25 * other.box.height
