"""New points of a keyframe: what it and its neighbours both see, and no point explains yet."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.matching import NEAR, match_epipolar
from base_station.trackers.slam.se3 import camera_centers, inverse, rotation_angle_rad, transform
from base_station.trackers.slam.triangulation import believable, fundamental_matrix, parallax_cosines, triangulate


@dataclass(frozen=True, kw_only=True)
class NewPointSettings:
    """Which pairs of keyframes make points, and which of them are kept."""

    neighbours: int = 12
    """That a keyframe is matched with."""
    least_baseline: float = 0.01
    """Between two keyframes, as a share of the median depth; below, depth is a guess."""
    least_parallax_rad: float = math.radians(1.0)
    """Under which a point must be seen, and..."""
    least_sigmas: float = 10.0
    """...so many times the angle that a keypoint may be off: a tenth of the depth is uncertain then. Points
    less sure are not wrong at random, they are too near: with them a turning camera loses its scale."""
    starving: int = 120
    """A keyframe that sees fewer points..."""
    quick_rad_s: float = math.radians(60.0)
    """...in a turn as quick as this is about to lose the map: what comes into view leaves it within some pictures..."""
    starving_sigmas: float = 4.0
    """...so for it less sure points are better than none. Only then: with them all the way, the map shrinks."""


def make_points(world: Map, keyframe: int, camera: SlamCamera, settings: NewPointSettings) -> np.ndarray:
    """Triangulate what this keyframe's free features show together with neighbours'; the new rows."""
    made = []
    if _is_starving(world, keyframe, settings):
        least = settings.starving_sigmas / settings.least_sigmas
        settings = replace(
            settings, least_sigmas=settings.starving_sigmas, least_parallax_rad=least * settings.least_parallax_rad
        )
    for other in world.neighbours(keyframe, settings.neighbours):
        made.append(_between(world, keyframe, int(other), camera, settings))
    return np.concatenate(made) if made else np.empty(0, np.int32)


def _is_starving(world: Map, keyframe: int, settings: NewPointSettings) -> bool:
    if np.count_nonzero(world.point_of[keyframe] >= 0) >= settings.starving:
        return False
    before = world.keyframes_alive(int(world.component[keyframe]))
    before = before[before < keyframe][-1:]
    turned_rad = [rotation_angle_rad(world.poses[keyframe, :3, :3] @ world.poses[row, :3, :3].T) for row in before]
    return any(turned_rad >= settings.quick_rad_s * np.abs(world.time_s[keyframe] - world.time_s[before]))


def median_depth(world: Map, keyframe: int) -> float:
    """Of the points that a keyframe sees; infinite without any."""
    rows = world.point_of[keyframe]
    rows = rows[rows >= 0]
    if not len(rows):
        return math.inf
    return float(np.median(transform(world.poses[keyframe], world.xyz[rows])[:, 2]))


def _between(world: Map, one: int, two: int, camera: SlamCamera, settings: NewPointSettings) -> np.ndarray:
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
    points = triangulate(pose_one, pose_two, *uv, camera.intrinsics)
    good = believable(
        points, (pose_one, pose_two), uv, scales, camera.intrinsics,
        least_parallax_rad=settings.least_parallax_rad, octave_scales=(1.0 / scales[0], 1.0 / scales[1]),
    )  # fmt: skip
    surely = np.cos(np.minimum(settings.least_sigmas * np.maximum(*scales) / camera.fx, 1.0))
    with np.errstate(invalid="ignore"):
        good &= parallax_cosines(points, camera_centers(pose_one), camera_centers(pose_two)) < surely
    made = world.add_points(points[good], of_one.descriptors[rows[good]], one)
    world.point_of[one, rows[good]] = made
    world.point_of[two, matches[rows[good]]] = made
    world.mark(keyframes=np.array([one, two]))
    return made


def _epipole(two_from_one: np.ndarray, camera: SlamCamera) -> np.ndarray:
    x, y, z = two_from_one[:3, 3]
    if abs(z) < 1e-9:
        return np.full(2, np.nan)
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])
