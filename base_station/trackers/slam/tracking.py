"""Following the camera from frame to frame: predict, find the last picture's points again, then the local map's.

Four ways to a first pose, the cheap one first: the last motion goes on (constant velocity); the pictures themselves
tell the turn (`turning.py`), and all points around are looked for; the last picture's points are looked for everywhere,
which forgives any jerk or turn; the reference keyframe's points are. Each gives matches, and the matches a pose. The
local map then adds all other points that should be in view, and the pose is fitted to all.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.certainty import CertaintySettings, is_certain
from base_station.trackers.slam.chance import ChanceSettings, log10_false_alarms
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.local_map import LocalMap, local_map
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.matching import NEAR, Grid, match_everywhere, match_projections
from base_station.trackers.slam.pose_optimization import PoseFit, optimize_pose
from base_station.trackers.slam.se3 import apart, camera_centers, median_depth, pose_of, relative, transform
from base_station.trackers.slam.three_points import pose_from_three
from base_station.trackers.slam.turning import turn_between
from base_station.trackers.slam.visibility import Expected, expect


@dataclass(frozen=True, kw_only=True)
class TrackingSettings:
    """When a pose is believed."""

    search_radius_px: float = 15.0
    """Around a prediction, on the finest level; coarser keypoints move more."""
    least_first_matches: int = 20
    """For the first pose of a picture; with fewer, the next way is tried."""
    least_first_inliers: int = 12
    """Of them that fit the pose."""
    least_inliers: int = 30
    """Points that fit a pose that is said."""
    least_sure_inliers: int = 15
    """The same when they leave the pose no freedom (`certainty.py`): in a quick turn there are not more."""
    least_in_quick_turn: int = 50
    """Points that make a pose in a quick turn one to be told. With fewer it is followed: each picture takes it off by
    another 2 to 3 cm (measured; a fifth of that with more), and so does what the map grows by meanwhile."""
    quick_rad_s: float = math.radians(60.0)
    """A turn as quick as this brings into view what leaves it again within some pictures."""
    least_inliers_found_again: int = 50
    """The same for a pose without a pose before."""
    least_share_found_again: float = 0.25
    """Of the points that should be seen from it. With fewer, a pose without a pose before is told only when the next
    picture is followed from there: it sees more, and what it sees is nearer to where it is expected."""
    least_inlier_share: float = 0.4
    """Of the points found, that must fit."""
    farthest_jump: float = 0.35
    """Of the median depth: a camera that moved further from where it was expected needs more points..."""
    widest_jump_rad: float = math.radians(12.0)
    """...and so does one that turned further."""
    pnp_error_px: float = 4.0
    """Of a match that supports a pose from three points."""
    certainty: CertaintySettings = field(default_factory=CertaintySettings)
    """Of a pose without a pose before, and of one far from the expected one."""
    chance: ChanceSettings = field(default_factory=ChanceSettings)
    """Of any pose."""


@dataclass
class Picture:
    """A picture while it is worked on. `point_of` (n,): which point of the map each feature shows."""

    time_s: float
    features: Features
    grid: Grid
    point_of: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.point_of = np.full(len(self.features), NONE, np.int32)


@dataclass(frozen=True)
class Located:
    """Where a picture was taken, by which points of the map. `tried`: matches that the first pose was chosen from;
    `unconfirmed`: a pose without a pose before that the next picture is to confirm."""

    cam_from_world: np.ndarray
    point_of: np.ndarray
    reference: int
    matches: int
    surroundings: LocalMap
    tried: int
    unconfirmed: bool = False


@dataclass
class _Last:
    """The last picture that was located; its pose is given against its keyframe, which the mapper may move."""

    picture: Picture
    reference: int
    cam_from_reference: np.ndarray
    size: float
    """The keyframe's when that was true, see `Map.sizes`."""


class FrameTracker:
    """Follows the camera in a map that somebody else changes between two calls."""

    def __init__(self, camera: SlamCamera, world: Map, settings: TrackingSettings | None = None) -> None:
        self._camera, self._map = camera, world
        self.settings = settings or TrackingSettings()
        self._last: _Last | None = None
        self._velocity: np.ndarray | None = None
        self.expected = np.zeros(0, np.int32)
        self.found = np.zeros(0, np.int32)

    # --- state ------------------------------------------------------------------------------------------------------

    def forget(self) -> None:
        """There is no last picture any more."""
        self._last = self._velocity = None

    def stopped(self) -> None:
        """The last picture stays, its motion is not known to go on."""
        self._velocity = None

    @property
    def last_pose(self) -> np.ndarray | None:
        """cam_from_world of the last picture that was located, in the map as it is now."""
        last = self._last
        return None if last is None else self._map.pose_by(last.reference, last.cam_from_reference, last.size)

    def remember(self, picture: Picture, found: Located, *, moving: bool) -> None:
        """This picture is the last one now. `moving`: it followed the one before at once, so the motion is known."""
        before = self.last_pose
        if moving and before is not None:
            self._velocity = relative(found.cam_from_world, before)
        else:
            self._velocity = None
        picture.point_of = found.point_of
        from_reference = relative(found.cam_from_world, self._map.poses[found.reference])
        self._last = _Last(picture, found.reference, from_reference, float(self._map.sizes[found.reference]))

    # --- a picture's way --------------------------------------------------------------------------------------------

    def doubt(self, picture: Picture, found: Located) -> str:
        """Why a pose that is followed may not be told yet, in words; empty: it may. Before `remember`."""
        if found.unconfirmed:
            return f"only {found.matches} points of the map are found again: to be confirmed by the next picture"
        last, before = self._last, self.last_pose
        if found.matches >= self.settings.least_in_quick_turn or last is None or before is None:
            return ""
        _, turned_rad = apart(found.cam_from_world, before)
        if turned_rad <= self.settings.quick_rad_s * (picture.time_s - last.picture.time_s):
            return ""
        return f"only {found.matches} points of the map are seen in a quick turn: followed, but not surely"

    def follow(self, picture: Picture) -> Located | str:
        """Where this picture was taken, from the one before; or in words why that is not known."""
        last, before = self._last, self.last_pose
        if last is None or before is None:
            return "no place of the map is recognised yet"
        guess = before if self._velocity is None else self._velocity @ before
        reference = self._map.living(last.reference)
        points = self._map.current(last.picture.point_of)
        for way in (self._by_motion, self._by_turn, self._by_likeness, self._by_keyframe):
            fit = way(picture, guess, last.picture, points, reference)
            if fit is not None:
                found = self.by_local_map(picture, fit, reference, self.settings.least_sure_inliers)
                if not isinstance(found, str) and self._is_enough(picture, found, guess):
                    return found
        return "the last picture's points are not found again"

    def locate_by(self, picture: Picture, keyframe: int) -> Located | str:
        """Where this picture was taken, from what a keyframe sees; nothing else is known."""
        fit = self._by_keyframe(picture, None, picture, picture.point_of, keyframe)
        if fit is None:
            return "the keyframe's points are not found"
        found = self.by_local_map(picture, fit, keyframe, self.settings.least_inliers_found_again, wide=True)
        if isinstance(found, str):
            return found
        if not self._is_certain(picture, found):
            return f"{found.matches} points are seen, but leave the pose unsure"
        if not self._is_more_than_chance(picture, found):
            return f"{found.matches} points are seen, as many as by chance"
        expected = self._expected(found).rows
        seen_share = np.isin(expected, found.point_of).sum() / max(len(expected), 1)
        return replace(found, unconfirmed=bool(seen_share < self.settings.least_share_found_again))

    def by_local_map(
        self, picture: Picture, first: PoseFit, reference: int, least: int, *, wide: bool = False
    ) -> Located | str:
        """The picture's pose from all points around, the first pose and its matches being there already."""
        world, features = self._map, picture.features
        seen = picture.point_of[picture.point_of >= 0]
        around = local_map(world, seen, reference)
        expected = expect(world, around.open_points, first.cam_from_world, self._camera)
        matches = match_projections(
            expected.uv_px, expected.radius_px * (3.0 if wide else 1.2), expected.octave_range,
            world.descriptors[expected.rows], features, picture.grid, ratio=0.8, taken=picture.point_of >= 0,
        )  # fmt: skip
        index = np.flatnonzero(matches >= 0)
        picture.point_of[matches[index]] = expected.rows[index]
        fit = self._fit(picture, first.cam_from_world)
        rows = np.flatnonzero(picture.point_of >= 0)
        tried = len(rows)
        if fit is None:
            return "no pose fits"
        picture.point_of[rows[~fit.inliers]] = NONE
        count = int(fit.inliers.sum())
        if count < least:
            return f"only {count} points of the map are seen"
        if count < self.settings.least_inlier_share * tried:
            return f"only {count} of {tried} points fit a pose"
        seen = picture.point_of[picture.point_of >= 0]
        self._count(np.concatenate([expected.rows, seen]), seen)
        return Located(
            fit.cam_from_world, picture.point_of.copy(), around.reference, count, around, len(first.inliers)
        )  # fmt: skip

    # --- ways to a first pose ---------------------------------------------------------------------------------------

    def _by_motion(
        self, picture: Picture, guess: np.ndarray, last: Picture, points: np.ndarray, reference: int
    ) -> PoseFit | None:
        world = self._map
        rows = np.flatnonzero(points >= 0)
        uv = self._camera.project(transform(guess, world.xyz[points[rows]]))
        octave = last.features.octave[rows].astype(np.int64)
        for widening in (1.0, 2.5):
            matches = match_projections(
                uv, widening * self.settings.search_radius_px * self._map.scales[octave],
                np.stack([octave - 1, octave + 1], axis=1), last.features.descriptors[rows],
                picture.features, picture.grid,
            )  # fmt: skip
            fit = self._first(picture, matches, points[rows], guess)
            if fit is not None:
                return fit
        return None

    def _by_turn(
        self, picture: Picture, guess: np.ndarray, last: Picture, points: np.ndarray, reference: int
    ) -> PoseFit | None:
        """With the turn that the picture itself tells, all points around are looked for, not only the last ones."""
        before = self.last_pose
        assert before is not None
        expected_turn = guess[:3, :3] @ before[:3, :3].T
        turn = turn_between(last.features, picture.features, picture.grid, expected_turn, self._camera)
        if turn is not None:
            rotation = turn @ before[:3, :3]
            guess = pose_of(rotation, -rotation @ camera_centers(guess))
        seen = points[points >= 0]
        around = np.concatenate([seen, local_map(self._map, seen, reference).open_points])
        expected = expect(self._map, around, guess, self._camera)
        matches = match_projections(
            expected.uv_px, 3.0 * expected.radius_px, expected.octave_range, self._map.descriptors[expected.rows],
            picture.features, picture.grid, ratio=0.8,
        )  # fmt: skip
        return self._first(picture, matches, expected.rows, guess)

    def _by_likeness(
        self, picture: Picture, guess: np.ndarray, last: Picture, points: np.ndarray, reference: int
    ) -> PoseFit | None:
        rows = np.flatnonzero(points >= 0)
        return self._by_look(picture, last.features, rows, points[rows])

    def _by_keyframe(
        self, picture: Picture, guess: np.ndarray | None, last: Picture, points: np.ndarray, reference: int
    ) -> PoseFit | None:
        features = self._map.features.get(reference)
        if features is None:
            return None
        points = self._map.current(self._map.point_of[reference, : len(features)])
        rows = np.flatnonzero(points >= 0)
        return self._by_look(picture, features, rows, points[rows])

    def _by_look(self, picture: Picture, features: Features, rows: np.ndarray, points: np.ndarray) -> PoseFit | None:
        matches = match_everywhere(
            features.descriptors[rows], features.angle_deg[rows], picture.features, most=NEAR + 14, ratio=0.85
        )
        pose = self._from_three(picture, matches, points)
        return None if pose is None else self._first(picture, matches, points, pose)

    def _from_three(self, picture: Picture, matches: np.ndarray, points: np.ndarray) -> np.ndarray | None:
        """A pose by RANSAC over three points each."""
        index = np.flatnonzero(matches >= 0)
        if len(index) < self.settings.least_first_inliers:
            return None
        found = pose_from_three(
            self._map.xyz[points[index]], picture.features.xy_px[matches[index]], self._camera,
            error_px=self.settings.pnp_error_px, tries=150, confidence=0.995,
        )  # fmt: skip
        if found is None or len(found[1]) < self.settings.least_first_inliers:
            return None
        return found[0]

    def _first(self, picture: Picture, matches: np.ndarray, points: np.ndarray, guess: np.ndarray) -> PoseFit | None:
        index = np.flatnonzero(matches >= 0)
        if len(index) < self.settings.least_first_matches:
            return None
        picture.point_of[:] = NONE
        picture.point_of[matches[index]] = points[index]
        fit = self._fit(picture, guess)
        if fit is None or fit.inliers.sum() < self.settings.least_first_inliers:
            return None
        rows = np.flatnonzero(picture.point_of >= 0)
        picture.point_of[rows[~fit.inliers]] = NONE
        return fit

    def _fit(self, picture: Picture, guess: np.ndarray) -> PoseFit | None:
        rows = np.flatnonzero(picture.point_of >= 0)
        if len(rows) < self.settings.least_first_inliers:
            return None
        return optimize_pose(
            guess, self._map.xyz[picture.point_of[rows]], picture.features.xy_px[rows],
            self._map.scales[picture.features.octave[rows]], self._camera.intrinsics,
        )  # fmt: skip

    # --- small things -----------------------------------------------------------------------------------------------

    def _is_certain(self, picture: Picture, found: Located) -> bool:
        rows = np.flatnonzero(found.point_of >= 0)
        return is_certain(
            found.cam_from_world, self._map.xyz[found.point_of[rows]], picture.features.xy_px[rows],
            self._map.scales[picture.features.octave[rows]], self._camera.intrinsics, self.settings.certainty,
        )  # fmt: skip

    def _is_enough(self, picture: Picture, found: Located, guess: np.ndarray) -> bool:
        if found.matches < self.settings.least_inliers and not self._is_certain(picture, found):
            return False
        return self._plausible(picture, found, guess) and self._is_more_than_chance(picture, found)

    def _is_more_than_chance(self, picture: Picture, found: Located) -> bool:
        if found.matches >= self.settings.chance.beyond:
            return True
        alarms = log10_false_alarms(
            self._map, self._expected(found), picture.features, picture.grid, found.point_of, found.tried
        )  # fmt: skip
        return alarms <= self.settings.chance.most_log10

    def _expected(self, found: Located) -> Expected:
        """The points around that should be seen from a pose."""
        seen = found.point_of[found.point_of >= 0]
        around = np.unique(np.concatenate([seen, found.surroundings.open_points]))
        return expect(self._map, around, found.cam_from_world, self._camera)

    def _plausible(self, picture: Picture, found: Located, guess: np.ndarray) -> bool:
        """A pose far from the expected one is believed only if one from nowhere would be."""
        settings = self.settings
        depth = median_depth(found.cam_from_world, self._map.xyz, found.point_of)
        step, turn = apart(found.cam_from_world, guess)
        if step <= settings.farthest_jump * depth and turn <= settings.widest_jump_rad:
            return True
        return found.matches >= settings.least_inliers_found_again and self._is_certain(picture, found)

    def _count(self, expected: np.ndarray, found: np.ndarray) -> None:
        size = len(self._map.xyz)
        if len(self.expected) < size:
            self.expected = np.concatenate([self.expected, np.zeros(size - len(self.expected), np.int32)])
            self.found = np.concatenate([self.found, np.zeros(size - len(self.found), np.int32)])
        self.expected[expected] += 1
        self.found[found] += 1

    def take_counts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points, and in how many frames since the last call they were expected, and found."""
        rows = np.flatnonzero(self.expected)
        counts = rows, self.expected[rows].copy(), self.found[rows].copy()
        self.expected[rows] = self.found[rows] = 0
        return counts
