"""The map: a copy that is fed the changes is the same map; what is culled or replaced leaves the rest true."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.covisibility import count_shared, count_shared_reference
from base_station.trackers.slam.map import KEYFRAME_COLUMNS, NONE, POINT_COLUMNS, Map, refresh_points
from base_station.trackers.slam.se3 import exponential, inverse
from base_station.trackers.slam.target import MapTarget
from tests.base_station.trackers.slam.scene import SCALES, box_of_points, features_of, project, random_looks

FEATURES = 120


def a_map(keyframes: int = 5, points: int = 100) -> Map:
    """Keyframes in a row that see the same points; keyframe k shows point i as its feature i."""
    rng = np.random.default_rng(13)
    world = Map(FEATURES, SCALES)
    xyz, looks = box_of_points(rng, points), random_looks(rng, points)
    for row in range(keyframes):
        pose = exponential(np.array([0.1 * row, 0, 0, 0, 0.01 * row, 0]))
        world.add_keyframe(row, 0.1 * row, pose, features_of(project(pose, xyz), looks), np.empty(0, np.int32), 0)
    rows = world.add_points(xyz, looks, 0)
    for row in range(keyframes):
        world.point_of[row, :points] = rows
    world.recount(np.arange(keyframes))
    world.count_observed(rows)
    refresh_points(world, rows, np.arange(keyframes))
    return world


def shared(world: Map) -> np.ndarray:
    alive = world.keyframes_alive()
    return world.shared.of(alive, alive)


def same(one: Map, two: Map) -> bool:
    k, p = one.keyframe_count, one.point_count
    return (
        (k, p) == (two.keyframe_count, two.point_count)
        and all(np.array_equal(getattr(one, name)[:k], getattr(two, name)[:k]) for name in KEYFRAME_COLUMNS)
        and all(np.array_equal(getattr(one, name)[:p], getattr(two, name)[:p]) for name in POINT_COLUMNS)
        and np.array_equal(shared(one), shared(two))
    )


def test_a_copy_follows_through_growth_culling_and_replacement():
    world, copy = a_map(), Map(FEATURES, SCALES)
    copy.apply(world.take_changes())
    assert same(world, copy)
    rng = np.random.default_rng(14)
    for row in range(5, 150):  # beyond the first capacities of both tables
        features = world.features[4]
        world.add_keyframe(row, 1.0, world.poses[4], features, world.point_of[4].copy(), 0)
        world.add_points(rng.normal(size=(40, 3)), random_looks(rng, 40), row)
    world.recount(np.arange(150))
    world.remove_keyframe(7, 8)
    world.replace_points(np.array([3, 4]), np.array([5, NONE], np.int32))
    assert not same(world, copy)
    copy.apply(world.take_changes())
    assert same(world, copy)
    assert 7 not in copy.features
    nothing = world.take_changes()
    assert len(nothing.keyframes) == len(nothing.points) == 0


def test_neighbours_are_by_shared_points_and_follow_what_is_no_longer_seen():
    world = a_map()
    assert world.neighbours(0, 10).tolist() == [1, 2, 3, 4]
    world.point_of[1, :60] = NONE
    world.recount(np.array([1]))
    assert world.neighbours(0, 10).tolist() == [2, 3, 4, 1]
    assert world.shared[0, 1] == world.shared[1, 0] == 40
    assert world.neighbours(0, 10, least_shared=50).tolist() == [2, 3, 4]


def test_replaced_points_are_seen_once_and_their_fate_is_known():
    world = a_map()
    world.replace_points(np.array([1]), np.array([2], np.int32))
    assert (world.point_of[:5] == 1).sum() == 0
    assert ((world.point_of[:5] == 2).sum(axis=1) == 1).all()  # each keyframe saw both: it shows the one once
    assert world.current(np.array([1, 3, NONE], np.int32)).tolist() == [2, 3, NONE]
    world.remove_points(np.array([2]))
    assert world.current(np.array([1], np.int32)).tolist() == [NONE]


def test_a_pose_given_by_a_culled_keyframe_moves_and_grows_with_its_anchor():
    world = a_map()
    relative = exponential(np.array([0.2, 0.0, 0.1, 0.0, 0.3, 0.0]))
    before = world.pose_by(2, relative, 1.0)
    assert np.allclose(before, relative @ world.poses[2])
    world.remove_keyframe(2, 3)
    assert np.allclose(world.pose_by(2, relative, 1.0), before)
    assert world.living(2) == 3
    moved = exponential(np.array([1.0, 0, 0, 0, 0.5, 0]))
    world.poses[3] = world.poses[3] @ inverse(moved)
    assert np.allclose(world.pose_by(2, relative, 1.0), before @ inverse(moved))
    world.poses[3][:3, 3] *= 2.0  # the world about it has doubled
    world.sizes[3] = 2.0
    doubled = (before @ inverse(moved))[:3, 3] * 2.0
    assert np.allclose(world.pose_by(2, relative, 1.0)[:3, 3], doubled)


def test_lengths_about_a_culled_keyframe_are_those_of_before():
    """A keyframe that grew in a loop is replaced by a younger one, whose size says nothing about it."""
    world = a_map()
    world.sizes[1] = 1.1
    target = MapTarget(1, np.eye(4), 1.1, np.array([0.0, 0.0, 2.0]))
    cam_from_world = exponential(np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0]))
    before = target.seen_from(world, cam_from_world)
    world.remove_keyframe(1, 2)
    world.remove_keyframe(2, 3)
    for one, two in zip(before, target.seen_from(world, cam_from_world), strict=True):
        assert np.allclose(one, two)
    world.sizes[3] *= 1.2
    assert world.growth(1, 1.1) == pytest.approx(1.2)
    assert world.growth(1, 1.0) == pytest.approx(1.2 * 1.1)


def test_the_table_is_as_large_as_the_keyframes_alive():
    """An hour of keyframes, of which few stay: the table, and what a recount takes, do not grow with the others."""
    world, copy = a_map(), Map(FEATURES, SCALES)
    seen, features = world.point_of[4].copy(), world.features[4]
    for row in range(5, 400):
        world.add_keyframe(row, 1.0, world.poses[0], features, seen, 0)
        world.recount(np.array([row]))
        world.remove_keyframe(row - 1, row)
        if row % 7 == 0:
            copy.apply(world.take_changes())
    copy.apply(world.take_changes())
    assert same(world, copy)
    assert world.shared.table.shape == copy.shared.table.shape == (64, 64)
    assert world.shared[399, 0] == copy.shared[0, 399] == 100
    assert world.shared[398, 0] == 0
    assert list(copy.features) == [] and list(world.features) == [0, 1, 2, 3, 399]


def test_shared_points_are_counted_as_plain_numpy_counts_them():
    rng = np.random.default_rng(5)
    point_of = np.full((9, 40), NONE, np.int32)
    for row in range(9):
        point_of[row, :30] = rng.choice(60, 30, replace=False)
    rows, others = np.array([8, 2]), np.array([0, 2, 3, 8])
    found = count_shared(point_of, rows, others, 60)
    assert np.array_equal(found, count_shared_reference(point_of, rows, others, 60))
    assert found[0, 3] == found[1, 1] == 0 < found[0, 0]


def test_a_number_that_the_mapper_refuses_is_forgotten_by_the_copy():
    world, copy = a_map(), Map(FEATURES, SCALES)
    copy.features[5] = world.features[4]  # as the tracker keeps them until the mapper has the keyframe
    world.skip_keyframe(5)
    copy.apply(world.take_changes())
    assert same(world, copy) and 5 not in copy.features and not copy.alive[5]


def test_points_know_from_where_and_how_far_they_are_seen():
    world = a_map()
    centers = inverse(world.poses[:5])[:, :3, 3]
    away = world.xyz[10] - centers
    distance = np.linalg.norm(away, axis=1)
    normal = (away / distance[:, None]).sum(axis=0)
    assert np.allclose(world.normals[10], normal / np.linalg.norm(normal), atol=1e-6)
    assert np.isclose(world.farthest[10], distance.mean())
    assert np.isclose(world.nearest[10], distance.mean() / SCALES[-1])
