"""The motion between two pictures, from matched keypoints only: by a homography or by an essential matrix.

A plane (or a camera that only turns) is explained by a homography, and an essential matrix computed from it is a guess;
a room is explained by an essential matrix only. Both are fitted, and a score of our own says which one holds (Mur-Artal
et al. 2015, section IV): every match counts by how far below the chi-square bound its transfer error lies, both ways.
What the better model decomposes to is triangulated, and is believed only when one motion is clearly the best, and
enough of its points are seen under an angle from which depth can be told. A camera that only turned never passes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.slam.bundle_kernels import adjust_small
from base_station.trackers.slam.bundle_problem import BundleProblem
from base_station.trackers.slam.pose_optimization import CHI2_TWO
from base_station.trackers.slam.se3 import inverse, pose_of, rotation_angle_rad
from base_station.trackers.slam.triangulation import believable, fundamental_matrix, parallax_cosines, triangulate

CHI2_ONE = 3.841
"""95 % for one number: the distance to an epipolar line."""
FINEST_PX, EXACT_SIGMAS = 0.15, 2.5
TURN_ROUNDS = 8
SERIOUS_SHARE = 0.7
"""Of the points of the motion with most: one with fewer is no rival."""
REFINING = 10


@dataclass(frozen=True, kw_only=True)
class TwoViewSettings:
    """When a pair of pictures is believed to show a motion."""

    sigma_px: float = 1.0
    """Standard deviation of a keypoint on the finest level."""
    homography_share: float = 0.45
    """The homography is taken when its score is more than this share of both scores."""
    least_points: int = 60
    """That are triangulated well."""
    least_share: float = 0.5
    """Of the model's inliers that must be triangulated well."""
    lead_share: float = 0.1
    """Of its score, by which the best motion must lead before any other one. A plane has two motions that explain it
    alike; what lies off the plane decides."""
    same_rotation_rad: float = math.radians(2.0)
    """Motions that differ by less than this, and..."""
    same_direction_rad: float = math.radians(15.0)
    """...whose translations do by less than this, are the same motion, found twice."""
    least_parallax_rad: float = math.radians(1.0)
    """Under which points must be seen: `least_points` of them..."""
    parallax_share: float = 0.2
    """...and this share..."""
    planar_parallax_share: float = 0.6
    """...and this one where a homography explains the pair as well: then the motions are harder to tell apart."""
    moved_px: float = 1.0
    """By which, on its level, a point must lie off where the best pure turn would put it..."""
    moved_sigmas: float = 4.0
    """...and by so many standard deviations of what the best motion leaves..."""
    moved_share: float = 0.25
    """...for this share of the points, and for `least_points` of them."""
    kept_parallax_rad: float = math.radians(0.3)
    """Under which a point must be seen to be kept."""


@dataclass(frozen=True)
class TwoView:
    """`two_from_one` 4x4 (translation of length 1), `points` (m, 3) in camera one, `rows` (m,): of which matches."""

    two_from_one: np.ndarray
    points: np.ndarray
    rows: np.ndarray
    planar: bool


def solve_two_view(
    uv_one_px: np.ndarray,
    uv_two_px: np.ndarray,
    camera_matrix: np.ndarray,
    octave_scales: tuple[np.ndarray, np.ndarray],
    settings: TwoViewSettings | None = None,
) -> TwoView | str:
    """The motion between matched keypoints (n, 2), or in words why there is none to be believed.

    `octave_scales` (both (n,)): the scale at which each keypoint was found; its standard deviation grows with it.
    """
    settings = settings or TwoViewSettings()
    if len(uv_one_px) < settings.least_points:
        return "too few matches"
    one, two = np.asarray(uv_one_px, np.float64), np.asarray(uv_two_px, np.float64)
    essential, _ = cv2.findEssentialMat(one, two, camera_matrix, cv2.USAC_MAGSAC, 0.999, settings.sigma_px * 1.5)
    homography, _ = cv2.findHomography(one, two, cv2.USAC_MAGSAC, settings.sigma_px * 2.0, maxIters=500)
    if essential is None or essential.shape != (3, 3):
        return "no motion fits"
    sigma = (settings.sigma_px * octave_scales[0], settings.sigma_px * octave_scales[1])
    score_e, inliers_e = epipolar_score(essential, one, two, camera_matrix, sigma)
    score_h, inliers_h = homography_score(homography, one, two, sigma)
    planar = score_h > settings.homography_share * (score_h + score_e)
    motions, fitting = _motions_of_essential(essential), inliers_e
    if planar:
        motions, fitting = [*_motions_of_homography(homography, camera_matrix), *motions], inliers_e | inliers_h
    inliers = np.flatnonzero(fitting)
    return _best_motion(motions, inliers, one, two, camera_matrix, sigma, planar, settings)


def _best_motion(
    motions: list[np.ndarray],
    inliers: np.ndarray,
    one: np.ndarray,
    two: np.ndarray,
    camera_matrix: np.ndarray,
    sigma: tuple[np.ndarray, np.ndarray],
    planar: bool,
    settings: TwoViewSettings,
) -> TwoView | str:
    intrinsics = np.array([camera_matrix[0, 0], camera_matrix[1, 1], camera_matrix[0, 2], camera_matrix[1, 2]])
    if len(inliers) < settings.least_points:
        return "too few matches agree"
    seen_one, seen_two, fine = one[inliers], two[inliers], (sigma[0][inliers], sigma[1][inliers])
    tried = [_try(motion, seen_one, seen_two, intrinsics, fine) for motion in motions]
    count = max(int(one_try.good.sum()) for one_try in tried)
    if count < max(settings.least_points, settings.least_share * len(inliers)):
        return "too few points lie before both cameras"
    serious = [one_try for one_try in tried if one_try.good.sum() > SERIOUS_SHARE * count]
    share = settings.planar_parallax_share if planar else settings.parallax_share
    if not any(_is_wide(one_try, share, settings) for one_try in serious):
        return "the camera has not moved enough"
    tried = [_refined(one_try, seen_one, seen_two, intrinsics, fine) for one_try in serious]
    scores = _scores(tried)
    best = tried[int(np.argmax(scores))]
    if not _is_wide(best, share, settings):
        return "the camera has not moved enough"
    seen = inliers[best.good]
    moved = _turn_residual(one[seen], two[seen], camera_matrix) / sigma[1][seen]
    clearly = max(settings.moved_px, settings.moved_sigmas * 1.4826 * float(np.median(best.residual[best.good])))
    if (moved > clearly).sum() < max(settings.moved_share * len(moved), settings.least_points):
        return "the camera has only turned"
    others = [
        score for score, other in zip(scores, tried, strict=True) if not _same(other.motion, best.motion, settings)
    ]
    if max(others, default=0.0) > (1.0 - settings.lead_share) * max(scores):
        return "two motions explain it"
    good = best.good.copy()
    good[good] = _cosines(best) < math.cos(settings.kept_parallax_rad)
    return TwoView(best.motion, best.points[good], inliers[good], planar)


@dataclass(frozen=True)
class _Try:
    """A motion, the matches triangulated by it, which of them are believable, and how far off its epipolar lines."""

    motion: np.ndarray
    points: np.ndarray
    good: np.ndarray
    residual: np.ndarray


def _try(
    motion: np.ndarray,
    one: np.ndarray,
    two: np.ndarray,
    intrinsics: np.ndarray,
    sigma: tuple[np.ndarray, np.ndarray],
) -> _Try:
    points = triangulate(np.eye(4), motion, one, two, intrinsics)
    good = believable(points, (np.eye(4), motion), (one, two), sigma, intrinsics, least_parallax_rad=1e-4)
    fx, fy, cx, cy = intrinsics
    fundamental = fundamental_matrix(motion, np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]))
    there = _line_distance2(fundamental, one, two) / sigma[1] ** 2
    back = _line_distance2(fundamental.T, two, one) / sigma[0] ** 2
    return _Try(motion, points, good, np.sqrt((there + back) / 2))


def _cosines(one: _Try) -> np.ndarray:
    return parallax_cosines(one.points[one.good], np.zeros(3), inverse(one.motion)[:3, 3])


def _is_wide(one: _Try, share: float, settings: TwoViewSettings) -> bool:
    """Whether enough of its points are seen under an angle that tells depth."""
    wide = int((_cosines(one) < math.cos(settings.least_parallax_rad)).sum())
    return wide >= max(share * one.good.sum(), settings.least_points)


def _refined(
    first: _Try, one: np.ndarray, two: np.ndarray, intrinsics: np.ndarray, sigma: tuple[np.ndarray, np.ndarray]
) -> _Try:
    """The motion that fits best near this one. What two models decompose to is rough: the right motion, unrefined, may
    fit less well than a wrong one."""
    rows = np.flatnonzero(first.good)
    count = len(rows)
    problem = BundleProblem(
        np.array([np.eye(4), first.motion]), np.array([True, False]), first.points[rows],
        np.repeat([0, 1], count), np.tile(np.arange(count), 2), np.concatenate([one[rows], two[rows]]),
        np.arange(2 * count),
    )  # fmt: skip
    sigmas = np.concatenate([sigma[0][rows], sigma[1][rows]])
    poses, _ = adjust_small(problem, intrinsics, sigmas, iterations=REFINING)
    length = float(np.linalg.norm(poses[1, :3, 3]))
    if not length > 1e-6 or not np.isfinite(poses).all():
        return first
    return _try(pose_of(poses[1, :3, :3], poses[1, :3, 3] / length), one, two, intrinsics, sigma)


def _scores(tried: list[_Try]) -> list[float]:
    """Of each motion. Wrong ones may explain all matches within the usual bound, but not as exactly as the right one:
    what counts as exact is taken from the most exact motion (its median, as a standard deviation)."""
    count = max(one.good.sum() for one in tried)
    exact = [float(np.median(one.residual[one.good])) for one in tried if one.good.sum() > SERIOUS_SHARE * count]
    sigma = max(1.4826 * min(exact), FINEST_PX)
    return [
        float(np.sum(np.maximum(0.0, 1.0 - (one.residual[one.good] / (EXACT_SIGMAS * sigma)) ** 2))) for one in tried
    ]


def _same(one: np.ndarray, two: np.ndarray, settings: TwoViewSettings) -> bool:
    direction = math.acos(float(np.clip(one[:3, 3] @ two[:3, 3], -1.0, 1.0)))
    turn = rotation_angle_rad(one[:3, :3] @ two[:3, :3].T)
    return turn < settings.same_rotation_rad and direction < settings.same_direction_rad


def _turn_residual(one: np.ndarray, two: np.ndarray, camera_matrix: np.ndarray) -> np.ndarray:
    """Px (n,) by which each match differs from what the rotation that fits best makes of it.

    A turn and a step aside look much alike: what is taken for parallax may be the rest of a turn not quite known.
    """
    fx, fy, cx, cy = camera_matrix[0, 0], camera_matrix[1, 1], camera_matrix[0, 2], camera_matrix[1, 2]
    rays = []
    for uv in (one, two):
        ray = np.column_stack([(uv - (cx, cy)) / (fx, fy), np.ones(len(uv))])
        rays.append(ray / np.linalg.norm(ray, axis=1, keepdims=True))
    weights, residual = np.ones(len(one)), np.zeros(len(one))
    for _ in range(TURN_ROUNDS):
        u, _, vt = np.linalg.svd((rays[1] * weights[:, None]).T @ rays[0])
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        residual = np.linalg.norm(rays[1] - rays[0] @ rotation.T, axis=1) * fx
        weights = 1.0 / np.maximum(residual, 1.0)
    return residual


def epipolar_score(
    essential: np.ndarray,
    one: np.ndarray,
    two: np.ndarray,
    camera_matrix: np.ndarray,
    sigma: tuple[np.ndarray, np.ndarray],
) -> tuple[float, np.ndarray]:
    """Score of an essential matrix and which matches fit it, (n,) bool."""
    inverse_matrix = np.linalg.inv(camera_matrix)
    fundamental = inverse_matrix.T @ essential @ inverse_matrix
    return _score(
        _line_distance2(fundamental, one, two) / sigma[1] ** 2,
        _line_distance2(fundamental.T, two, one) / sigma[0] ** 2,
        CHI2_ONE,
    )


def homography_score(
    homography: np.ndarray | None, one: np.ndarray, two: np.ndarray, sigma: tuple[np.ndarray, np.ndarray]
) -> tuple[float, np.ndarray]:
    """Score of a homography and which matches fit it, (n,) bool."""
    if homography is None or abs(np.linalg.det(homography)) < 1e-12:
        return 0.0, np.zeros(len(one), bool)
    there = np.sum((_mapped(homography, one) - two) ** 2, axis=1)
    back = np.sum((_mapped(np.linalg.inv(homography), two) - one) ** 2, axis=1)
    return _score(there / sigma[1] ** 2, back / sigma[0] ** 2, CHI2_TWO)


def _score(there: np.ndarray, back: np.ndarray, bound: float) -> tuple[float, np.ndarray]:
    good_there, good_back = there < bound, back < bound
    score = np.sum((CHI2_TWO - there)[good_there]) + np.sum((CHI2_TWO - back)[good_back])
    return float(score), good_there & good_back


def _line_distance2(fundamental: np.ndarray, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    lines = np.column_stack([one, np.ones(len(one))]) @ fundamental.T
    value = lines[:, 0] * two[:, 0] + lines[:, 1] * two[:, 1] + lines[:, 2]
    return value**2 / np.maximum(lines[:, 0] ** 2 + lines[:, 1] ** 2, 1e-18)


def _mapped(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    mapped = np.column_stack([points, np.ones(len(points))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return mapped[:, :2] / mapped[:, 2:]


def _motions_of_essential(essential: np.ndarray) -> list[np.ndarray]:
    one, two, along = cv2.decomposeEssentialMat(essential)
    return [pose_of(rotation, sign * along) for rotation in (one, two) for sign in (1.0, -1.0)]


def _motions_of_homography(homography: np.ndarray, camera_matrix: np.ndarray) -> list[np.ndarray]:
    _, rotations, translations, _ = cv2.decomposeHomographyMat(homography, camera_matrix)
    motions = []
    for rotation, translation in zip(rotations, translations, strict=True):
        length = float(np.linalg.norm(translation))
        if length > 1e-6:
            motions.append(pose_of(rotation, translation / length))
    return motions
