"""Where a learned picture was taken, when it shows a plane: two poses explain a view of it alike, and the map decides.

A plane seen by two cameras leaves two motions between them (Longuet-Higgins 1986; Collins and Bartoli, "Infinitesimal
plane-based pose estimation", 2014), and a robot that drives straight at a poster has made its map from such views: the
map's own idea of how the poster is tilted may be the wrong one of the two, or lie between. So a pose that fits the map
best is no answer. Each motion goes with a tilt of its own. For each the points are put on its plane, the keyframes are
placed by them, and all of it is adjusted, the learned picture among them: of three views and more only one tilt
explains all. How much worse the next one does, in units of the noise that is left, says how sure the answer is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from base_station.trackers.slam.bundle_kernels import adjust_with_cost
from base_station.trackers.slam.bundle_problem import BundleProblem
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.local_bundle import part_of
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.pose_optimization import CHI2_TWO, optimize_pose
from base_station.trackers.slam.se3 import inverse, pose_of, rotation_angle_rad, transform
from base_station.trackers.slam.three_points import pose_from_three
from base_station.trackers.slam.tracking import Picture


@dataclass(frozen=True, kw_only=True)
class TwinSettings:
    """How the twins are told apart."""

    plane_px: float = 3.0
    """Of a plane's homography, between both pictures..."""
    plane_points: int = 15
    """...with which so many pairs must agree."""
    map_px: float = 8.0
    """Of a pose by the map as it is: a tilted one is to be set right, not to be left..."""
    map_points: int = 12
    """...and so many points must agree with it."""
    keyframes: int = 6
    """That are adjusted, from the first to the last..."""
    least_seen: int = 10
    """...that see so many of the points."""
    iterations: int = 15
    apart_rad: float = math.radians(3.0)
    """Poses that differ by more are two."""
    least_fitting: int = 20
    """Points that the answer must explain..."""
    fitting_share: float = 0.6
    """...and this share of those that were matched..."""
    least_lead: float = 50.0
    """...and by how much the next one's chi-square must be higher, when noise makes it 1 for each number..."""
    alone_fitting: int = 45
    """...or, where there is no other, how many points it must explain."""


@dataclass(frozen=True)
class Pairs:
    """Features of the learned picture (`learned`, rows) that a picture of now shows, too (`seen`, rows), and the points
    of the map that those show (`points`, rows, -1 for none). All (n,)."""

    learned: np.ndarray
    seen: np.ndarray
    points: np.ndarray


@dataclass(frozen=True)
class Judged:
    """`cam_from_world` of the learned picture, `sure` whether no other pose explains as much, `fits` (n,) bool which of
    the pairs it explains."""

    cam_from_world: np.ndarray
    fits: np.ndarray
    sure: bool


@dataclass(frozen=True)
class _Guess:
    """Where the learned picture may have been taken, where the pairs' points (n, 3) then are, and which pairs (n,) led
    to it."""

    cam_from_world: np.ndarray
    xyz: np.ndarray
    agree: np.ndarray


def judge(
    world: Map, learned: Features, in_box: np.ndarray, picture: Picture, cam_from_world: np.ndarray, pairs: Pairs,
    camera: SlamCamera, settings: TwinSettings, without: int = NONE,
) -> Judged | None:  # fmt: skip
    """The pose of the learned picture that explains most. None when nothing explains it.

    `in_box` (features,) bool: those that may lie on a plane. `cam_from_world`: of the `picture`. `without`: a keyframe
    that must not be asked, as it is the learned picture itself.
    """
    guesses = _by_plane(world, learned, in_box, picture, cam_from_world, pairs, camera, settings)
    guesses += _by_map(world, learned, pairs, camera, settings)
    if not guesses:
        return None
    told = np.logical_or.reduce([guess.agree for guess in guesses]) & (pairs.points >= 0)
    scene = _Scene.of(world, learned, picture, cam_from_world, pairs, np.flatnonzero(told), settings, without)
    if scene is None:
        return None
    adjusted = [scene.adjusted(guess, camera, settings) for guess in guesses]
    tried = [one for one in adjusted if one is not None]
    if not tried:
        return None
    best = min(tried, key=lambda one: one.cost)
    apart = [one.cost - best.cost for one in tried if differ(one.cam_from_world, best.cam_from_world, settings)]
    fitting = int(best.fits.sum())
    least = settings.least_fitting if apart else settings.alone_fitting
    clearly = min(apart, default=math.inf) > settings.least_lead * best.cost / scene.freedom
    enough = fitting >= max(least, settings.fitting_share * told.sum())
    return Judged(best.cam_from_world, best.fits, bool(clearly and enough))


def differ(one: np.ndarray, two: np.ndarray, settings: TwinSettings) -> bool:
    """Whether two poses are turned too differently to be the same one."""
    return rotation_angle_rad(one[:3, :3] @ two[:3, :3].T) > settings.apart_rad


def _by_map(
    world: Map, learned: Features, pairs: Pairs, camera: SlamCamera, settings: TwinSettings
) -> list[_Guess]:  # fmt: skip
    """The learned picture's pose by the map as it is, if it says one."""
    mapped = np.flatnonzero(pairs.points >= 0)
    if len(mapped) < settings.map_points:
        return []
    xyz, seen_px = _points(world, pairs), learned.xy_px[pairs.learned[mapped]]
    found = pose_from_three(xyz[mapped], seen_px, camera, error_px=settings.map_px, tries=200, confidence=0.99)
    if found is None or len(found[1]) < settings.map_points:
        return []
    agree = np.zeros(len(xyz), np.bool_)
    agree[mapped[found[1]]] = True
    return [_Guess(found[0], xyz, agree)]


def _by_plane(
    world: Map, learned: Features, in_box: np.ndarray, picture: Picture, cam_from_world: np.ndarray, pairs: Pairs,
    camera: SlamCamera, settings: TwinSettings,
) -> list[_Guess]:  # fmt: skip
    """Both motions of the plane that most pairs in the box lie on, as far as it lies before both cameras. Its distance
    is the map's."""
    there, here = learned.xy_px[pairs.learned], picture.features.xy_px[pairs.seen]
    boxed = np.flatnonzero(in_box[pairs.learned])
    if len(boxed) < settings.plane_points:
        return []
    homography, inliers = cv2.findHomography(
        there[boxed], here[boxed], cv2.USAC_MAGSAC, settings.plane_px, maxIters=500, confidence=0.999
    )
    if homography is None or not np.isfinite(homography).all():
        return []
    agree = np.zeros(len(there), np.bool_)
    agree[boxed[inliers[:, 0] > 0]] = True
    mapped = agree & (pairs.points >= 0)
    if agree.sum() < settings.plane_points or not mapped.any():
        return []
    depth = transform(cam_from_world, world.xyz[pairs.points[mapped]])[:, 2]
    rays, found = camera.rays(there[agree]), []
    _, rotations, translations, normals = cv2.decomposeHomographyMat(homography, camera.matrix)
    for rotation, translation, normal in zip(rotations, translations, normals, strict=True):
        toward = (rays @ normal)[:, 0]
        if not (toward > 0).all():
            continue
        on_plane = (rays / toward[:, None]) @ rotation.T + translation[:, 0]
        if not (on_plane[:, 2] > 0).all():
            continue
        size = float(np.median(depth / on_plane[mapped[agree], 2]))
        xyz = _points(world, pairs)
        xyz[agree] = transform(inverse(cam_from_world), on_plane * size)
        found.append(_Guess(inverse(pose_of(rotation, translation[:, 0] * size)) @ cam_from_world, xyz, agree))
    return found


def _points(world: Map, pairs: Pairs) -> np.ndarray:
    """(n, 3), as the map has them; of pairs without a point nothing that means anything."""
    return world.xyz[np.maximum(pairs.points, 0)]


@dataclass(frozen=True)
class _Adjusted:
    cam_from_world: np.ndarray
    cost: float
    fits: np.ndarray


@dataclass(frozen=True)
class _Scene:
    """What is adjusted for every guess. `problem`: keyframes, then the picture of now, then the learned one. `points`:
    rows of the problem's points that belong to the pairs `rows`; their observations are the problem's last. `pairs`:
    how many there are in all."""

    problem: BundleProblem
    scales: np.ndarray
    points: np.ndarray
    rows: np.ndarray
    pairs: int

    @classmethod
    def of(
        cls, world: Map, learned: Features, picture: Picture, cam_from_world: np.ndarray, pairs: Pairs,
        told: np.ndarray, settings: TwinSettings, without: int,
    ) -> _Scene | None:  # fmt: skip
        """Of the pairs `told` (rows). None when no two keyframes see them."""
        seers = _seers(world, pairs.points[told], settings, without)
        part = part_of(world, seers[1:], seers[:1], world.points_of(seers)) if len(seers) > 1 else None
        if part is None:
            return None
        problem, used, *_ = part
        row_of = np.full(world.point_count, NONE, np.int64)
        row_of[used] = np.arange(len(used))
        shown = np.flatnonzero(picture.point_of >= 0)
        shown = shown[row_of[picture.point_of[shown]] >= 0]
        rows = told[row_of[pairs.points[told]] >= 0]
        if not len(rows):
            return None
        points, features = row_of[pairs.points[rows]], pairs.learned[rows]
        now = len(problem.poses)
        whole = BundleProblem(
            np.concatenate([problem.poses, [cam_from_world, cam_from_world]]),
            np.append(problem.fixed, [False, False]),
            problem.points,
            np.concatenate([problem.keyframe, np.full(len(shown), now), np.full(len(rows), now + 1)]),
            np.concatenate([problem.point, row_of[picture.point_of[shown]], points]),
            np.concatenate([problem.uv_px, picture.features.xy_px[shown], learned.xy_px[features]]),
            np.concatenate([problem.octave, picture.features.octave[shown], learned.octave[features]]),
        )
        return cls(whole, world.scales, points, rows, len(pairs.points))

    @property
    def freedom(self) -> int:
        """Numbers that were measured, less those that explain them."""
        problem = self.problem
        return max(1, 2 * len(problem.point) - 3 * len(problem.points) - 6 * len(problem.poses) + 7)

    def adjusted(self, guess: _Guess, camera: SlamCamera, settings: TwinSettings) -> _Adjusted | None:
        """All of it, begun from this guess. The pose is the map's: seen from the picture of now, and in its size. None
        when the target ends up behind the camera."""
        problem = self._begun(guess, camera)
        poses, xyz, cost = adjust_with_cost(
            problem, camera.intrinsics, self.scales, iterations=settings.iterations, enough=1e-4
        )
        seen = slice(len(problem.point) - len(self.points), None)
        off_px = camera.project(transform(poses[-1], xyz[self.points])) - problem.uv_px[seen]
        chi2 = np.sum(off_px**2, axis=1) / self.scales[problem.octave[seen]] ** 2
        fits = np.zeros(self.pairs, np.bool_)
        fits[self.rows] = chi2 <= CHI2_TWO
        now = self.problem.poses[-2]
        before, after = (
            float(np.median(transform(pose, points[self.points])[:, 2]))
            for pose, points in ((now, self.problem.points), (poses[-2], xyz))
        )
        learned_from_now = poses[-1] @ inverse(poses[-2])
        if not (before > 0 and after > 0 and np.isfinite(learned_from_now).all()):
            return None
        moved = learned_from_now[:3, 3] * (before / after)
        return _Adjusted(pose_of(learned_from_now[:3, :3], moved) @ now, cost, fits)

    def _begun(self, guess: _Guess, camera: SlamCamera) -> BundleProblem:
        """The pairs' points where the guess has them, and each keyframe where it sees them so."""
        problem, poses, xyz = self.problem, self.problem.poses.copy(), self.problem.points.copy()
        xyz[self.points] = guess.xyz[self.rows]
        poses[-1] = guess.cam_from_world
        of_target = np.zeros(len(xyz), np.bool_)
        of_target[self.points] = True
        for k in np.flatnonzero(~problem.fixed)[:-2]:
            at = np.flatnonzero((problem.keyframe == k) & of_target[problem.point])
            sigma_px = self.scales[problem.octave[at]]
            poses[k] = optimize_pose(
                poses[k], xyz[problem.point[at]], problem.uv_px[at], sigma_px, camera.intrinsics
            ).cam_from_world
        return replace(problem, poses=poses, points=xyz)


def _seers(world: Map, points: np.ndarray, settings: TwinSettings, without: int) -> np.ndarray:
    """Keyframes that see these points, evenly from the first to the last."""
    wanted = np.zeros(world.point_count + 1, np.bool_)  # the last is NONE's
    wanted[points] = True
    keyframes = world.keyframes_alive()
    seen = wanted[world.point_of[keyframes]].sum(axis=1)
    keyframes = keyframes[(keyframes != without) & (seen >= settings.least_seen)]
    chosen = np.linspace(0, len(keyframes) - 1, min(settings.keyframes, len(keyframes))).round().astype(np.int64)
    return keyframes[chosen]
