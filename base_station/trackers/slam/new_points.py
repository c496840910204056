"""New points of a keyframe: what it and its neighbours both see, and no point explains yet.

Whether a pair of views can tell a point's depth is judged by where it should be, not by where it came out: by the
parallax that it would have at the keyframe's usual depth. A bound on the measured parallax chooses by the error: the
poses' own error is common to all points of a pair, and when it makes them come out near they pass, when it makes them
come out far they do not. So the map shrinks with every turn in which few old points are left.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.matching import NEAR, match_epipolar
from base_station.trackers.slam.se3 import camera_centers, inverse, transform
from base_station.trackers.slam.triangulation import believable, fundamental_matrix, triangulate


@dataclass(frozen=True, kw_only=True)
class NewPointSettings:
    """Which pairs of keyframes make points, and which of them are kept."""

    neighbours: int = 12
    """That a keyframe is matched with."""
    least_baseline: float = 0.01
    """Between two keyframes, as a share of the median depth; below, depth is a guess."""
    least_sigmas: float = 6.0
    """The parallax that a point should have, in standard deviations of a keypoint: a sixth of the depth is uncertain
    then, which is made up for by the keyframes to come..."""
    least_measured_share: float = 0.5
    """...and the share of it that it must have: below, it may be any distance off."""


def make_points(world: Map, keyframe: int, camera: SlamCamera, settings: NewPointSettings) -> np.ndarray:
    """Triangulate what this keyframe's free features show together with neighbours'; the new rows."""
    usual_depth = median_depth(world, keyframe)
    made = [
        _between(world, keyframe, int(other), usual_depth, camera, settings)
        for other in world.neighbours(keyframe, settings.neighbours)
    ]
    return np.concatenate(made) if made else np.empty(0, np.int32)


def median_depth(world: Map, keyframe: int) -> float:
    """Of the points that a keyframe sees; infinite without any."""
    rows = world.point_of[keyframe]
    rows = rows[rows >= 0]
    if not len(rows):
        return math.inf
    return float(np.median(transform(world.poses[keyframe], world.xyz[rows])[:, 2]))


def _between(
    world: Map, one: int, two: int, usual_depth: float, camera: SlamCamera, settings: NewPointSettings
) -> np.ndarray:
    nothing = np.empty(0, np.int32)
    pose_one, pose_two = world.poses[one], world.poses[two]
    baseline = float(np.linalg.norm(camera_centers(pose_one) - camera_centers(pose_two)))
    if baseline < settings.least_baseline * median_depth(world, two):
        return nothing
    of_one, of_two = world.features[one], world.features[two]
    free_one, free_two = (
        world.point_of[row, : len(features)] == NONE for row, features in ((one, of_one), (two, of_two))
    )
    two_from_one = pose_two @ inverse(pose_one)
    matches = match_epipolar(
        of_one, of_two, free_one, free_two,
        fundamental_matrix(two_from_one, camera.matrix), _epipole(two_from_one, camera), world.scales, most=NEAR,
    )  # fmt: skip
    rows = np.flatnonzero(matches >= 0)
    if not len(rows):
        return nothing
    uv = of_one.xy_px[rows].astype(np.float64), of_two.xy_px[matches[rows]].astype(np.float64)
    scales = world.scales[of_one.octave[rows]], world.scales[of_two.octave[matches[rows]]]
    least_rad = settings.least_sigmas * np.maximum(*scales) / camera.fx
    points = triangulate(pose_one, pose_two, *uv, camera.intrinsics)
    good = believable(
        points, (pose_one, pose_two), uv, scales, camera.intrinsics,
        least_parallax_rad=least_rad * settings.least_measured_share, octave_scales=(1.0 / scales[0], 1.0 / scales[1]),
    )  # fmt: skip
    due_rad = expected_parallaxes(uv[0], inverse(two_from_one)[:3, 3], usual_depth, camera)
    good &= due_rad > least_rad
    made = world.add_points(points[good], of_one.descriptors[rows[good]], one)
    world.point_of[one, rows[good]] = made
    world.point_of[two, matches[rows[good]]] = made
    world.mark(keyframes=np.array([one, two]))
    return made


def expected_parallaxes(uv_px: np.ndarray, baseline: np.ndarray, depth: float, camera: SlamCamera) -> np.ndarray:
    """The angle (n,) between the two views of points of this depth, seen at (n, 2); `baseline` (3,): the other camera,
    in this one's coordinates."""
    rays = camera.rays(uv_px)
    lengths = np.linalg.norm(rays, axis=1)
    aside = np.linalg.norm(np.cross(rays, baseline), axis=1) / lengths
    return np.asarray(np.arctan(aside / (depth * lengths)))


def _epipole(two_from_one: np.ndarray, camera: SlamCamera) -> np.ndarray:
    x, y, z = two_from_one[:3, 3]
    if abs(z) < 1e-9:
        return np.full(2, np.nan)
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])
