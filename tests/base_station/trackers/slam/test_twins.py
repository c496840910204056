"""A plane was learned head-on; the map is made driving straight at it from aside, and believes the wrong tilt. Which of
the two poses that explain the learned picture alike is right?"""

from __future__ import annotations

import math

import numpy as np
import pytest

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.matching import Grid
from base_station.trackers.slam.pose_optimization import optimize_pose
from base_station.trackers.slam.se3 import exponential, inverse, rotation_angle_rad, transform
from base_station.trackers.slam.tracking import Picture
from base_station.trackers.slam.twins import Pairs, TwinSettings, judge
from tests.base_station.trackers.slam.scene import INTRINSICS, SCALES, features_of, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
COUNT, TILT_RAD = 120, math.radians(22.0)
SETTINGS = TwinSettings()
ALL = np.ones(COUNT, np.bool_)


def turned(angle_rad: float) -> np.ndarray:
    return exponential(np.array([0.0, 0.0, 0.0, 0.0, angle_rad, 0.0]))


def wall(rng: np.random.Generator, depth: float = 0.0) -> np.ndarray:
    """(n, 3) of a poster of 0.5 x 0.4 whose middle is the origin, some of them before it by up to `depth`."""
    return np.column_stack([
        rng.uniform(-0.25, 0.25, COUNT), rng.uniform(-0.2, 0.2, COUNT), -rng.uniform(0.0, depth, COUNT),
    ])  # fmt: skip


def before_it(distance: float) -> np.ndarray:
    """cam_from_world of a camera that looks at the middle, aside of the poster's normal by `TILT_RAD`."""
    away = turned(TILT_RAD)
    away[2, 3] = distance
    return away


def learned_pose() -> np.ndarray:
    """Head-on."""
    pose = np.eye(4)
    pose[2, 3] = 0.6
    return pose


def scene(distances: list[float], *, depth: float = 0.0, noise_px: float = 0.3, seed: int = 0):
    """The map of keyframes at these distances but the last, which is the picture of now; what was learned; the pairs.
    In the map the wall stands across the last picture's axis, and the keyframes where that fits best."""
    rng = np.random.default_rng(seed)
    points, looks = wall(rng, depth), random_looks(rng, COUNT)
    poses = [before_it(distance) for distance in distances]
    seen = [project(pose, points) + rng.normal(0, noise_px, (COUNT, 2)) for pose in (*poses, learned_pose())]
    now = poses[-1]
    flat = transform(now, points)
    flat *= (distances[-1] / flat[:, 2])[:, None]
    mapped = transform(inverse(now), flat)
    world = Map(COUNT, SCALES)
    for row, (pose, uv) in enumerate(zip(poses[:-1], seen, strict=False)):
        fit = optimize_pose(pose, mapped, uv, np.ones(COUNT), INTRINSICS)
        world.add_keyframe(row, float(row), fit.cam_from_world, features_of(uv, looks), np.empty(0, np.int32), 0)
    of_map = world.add_points(mapped, looks, 0)
    for row in range(len(poses) - 1):
        world.point_of[row, :COUNT] = of_map
    world.recount(np.arange(len(poses) - 1))
    features = features_of(seen[-2], looks)
    picture = Picture(9.0, features, Grid.of(features.xy_px, CAMERA.bounds_px))
    picture.point_of[:] = of_map
    every = np.arange(COUNT)
    return world, features_of(seen[-1], looks), picture, now, Pairs(every, every, of_map.astype(np.int64))


def learned_from_now(now: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return pose @ inverse(now)


def off_rad(now: np.ndarray, pose: np.ndarray) -> float:
    there, truth = learned_from_now(now, pose), learned_from_now(now, learned_pose())
    return rotation_angle_rad(there[:3, :3] @ truth[:3, :3].T)


@pytest.mark.parametrize("seed", range(5))
def test_the_map_was_wrong_and_more_views_tell(seed):
    world, learned, picture, now, pairs = scene([1.2, 1.1, 1.0, 0.9, 0.8], seed=seed)
    by_map = optimize_pose(
        learned_pose(), world.xyz[pairs.points], learned.xy_px, np.ones(COUNT), INTRINSICS
    ).cam_from_world
    assert off_rad(now, by_map) > math.radians(5.0)  # the map as it is leads astray
    judged = judge(world, learned, ALL, picture, now, pairs, CAMERA, SETTINGS)
    assert judged is not None and judged.sure
    assert off_rad(now, judged.cam_from_world) < math.radians(1.5)
    length, true_length = (
        float(np.linalg.norm(learned_from_now(now, pose)[:3, 3])) for pose in (judged.cam_from_world, learned_pose())
    )
    assert length == pytest.approx(true_length, rel=0.05)
    assert judged.fits.mean() > 0.9


def test_two_views_that_hardly_differ_leave_it_open():
    world, learned, picture, now, pairs = scene([1.204, 1.202, 1.2])
    judged = judge(world, learned, ALL, picture, now, pairs, CAMERA, SETTINGS)
    assert judged is not None and not judged.sure


@pytest.mark.parametrize("seed", range(3))
def test_what_stands_out_of_the_plane_tells_as_well(seed):
    world, learned, picture, now, pairs = scene([1.2, 1.1, 1.0, 0.9, 0.8], depth=0.1, seed=seed)
    judged = judge(world, learned, ALL, picture, now, pairs, CAMERA, SETTINGS)
    assert judged is not None and judged.sure
    assert off_rad(now, judged.cam_from_world) < math.radians(1.5)


def test_wrong_pairs_among_them_have_no_say():
    world, learned, picture, now, pairs = scene([1.2, 1.1, 1.0, 0.9, 0.8])
    rng = np.random.default_rng(2)
    points, seen = pairs.points.copy(), pairs.seen.copy()
    points[:30], seen[:30] = rng.permutation(points[:30]), rng.permutation(seen[:30])
    judged = judge(world, learned, ALL, picture, now, Pairs(pairs.learned, seen, points), CAMERA, SETTINGS)
    assert judged is not None and judged.sure
    assert off_rad(now, judged.cam_from_world) < math.radians(2.5)
    assert judged.fits[30:].mean() > 0.9 and judged.fits[:30].mean() < 0.2


def test_another_picture_fits_nowhere():
    world, learned, picture, now, pairs = scene([1.2, 1.1, 1.0, 0.9, 0.8])
    rng = np.random.default_rng(1)
    wrong = Pairs(pairs.learned, pairs.seen, rng.permutation(pairs.points))
    judged = judge(world, learned, ALL, picture, now, wrong, CAMERA, SETTINGS)
    assert judged is None or not judged.sure


def test_the_learned_pictures_own_keyframe_is_not_asked():
    """A wrong keyframe of it would bear itself out."""
    world, learned, picture, now, pairs = scene([1.2, 1.1, 1.0, 0.9, 0.8])
    wrong = turned(math.radians(40.0)) @ learned_pose()
    world.add_keyframe(4, 4.0, wrong, learned, pairs.points.astype(np.int32), 0)
    world.recount(np.array([4]))
    judged = judge(world, learned, ALL, picture, now, pairs, CAMERA, SETTINGS, without=4)
    assert judged is not None and judged.sure
    assert off_rad(now, judged.cam_from_world) < math.radians(1.5)


def test_one_keyframe_is_not_enough():
    world, learned, picture, now, pairs = scene([1.2, 1.0])
    assert judge(world, learned, ALL, picture, now, pairs, CAMERA, SETTINGS) is None
