"""A closed loop's place is confirmed once each time the camera comes back to it, with what the map was off by: by two
poses that have no point in common."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.loop_correction import tie
from base_station.trackers.slam.map import NONE, Map, refresh_points
from base_station.trackers.slam.returning import Returns, ReturnSettings
from base_station.trackers.slam.se3 import exponential, inverse, transform
from tests.base_station.trackers.slam.scene import INTRINSICS, SCALES, box_of_points, features_of, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
COUNT = 150
STEP = exponential(np.array([0.2, 0.0, 0.1, 0.0, 0.05, 0.0]))


def world_with(off: np.ndarray, others: int = 60) -> Map:
    """Keyframes 0 (the place), 1 (elsewhere, sees other points), 2 (back; it sees the place's points, and `others` that
    the place does not: those, and its own pose, are `off` in the map)."""
    rng = np.random.default_rng(0)
    world = Map(COUNT + others, SCALES)
    here, there = box_of_points(rng, COUNT), box_of_points(rng, COUNT) + np.array([50.0, 0.0, 0.0])
    beside = transform(inverse(STEP), box_of_points(rng, others))
    looks, other_looks, beside_looks = (random_looks(rng, n) for n in (COUNT, COUNT, others))
    away = np.eye(4)
    away[0, 3] = -50.0
    views = (
        (np.eye(4), here, looks),
        (away, there, other_looks),
        (STEP, np.concatenate([here, beside]), np.concatenate([looks, beside_looks])),
    )
    for row, (pose, points, look) in enumerate(views):
        uv = project(pose, points) + rng.normal(0, 0.4, (len(points), 2))
        mapped = pose @ inverse(off) if row == 2 else pose
        world.add_keyframe(row, float(row), mapped, features_of(uv, look), np.empty(0, np.int32), 0)
    mine, elsewhere = world.add_points(here, looks, 0), world.add_points(there, other_looks, 1)
    found = world.add_points(transform(off, beside), beside_looks, 2)
    world.point_of[0, :COUNT], world.point_of[1, :COUNT] = mine, elsewhere
    world.point_of[2] = np.concatenate([mine, found])
    world.recount(np.arange(3))
    return world


def test_a_return_is_confirmed_once_and_measured():
    off = exponential(np.array([0.03, 0.0, 0.0, 0.0, 0.0, 0.0]))
    world, returns = world_with(off), Returns(CAMERA, ReturnSettings())
    assert returns.look(world, 2) is None  # no loop was ever closed
    returns.closed(0)
    assert returns.look(world, 2) is None  # not away since
    assert returns.look(world, 1) is None  # away
    found = returns.look(world, 2)
    assert found is not None and (found.kind, found.time_s) == ("confirmed", 2.0)
    assert found.moved_of_depth == pytest.approx(0.03 / np.median(box_depth(world)), rel=0.3)
    assert found.turned_rad < 0.003
    assert returns.look(world, 2) is None  # once a visit


def test_a_confirmed_return_ties_both_ends_together():
    world = world_with(np.eye(4))
    forgotten = np.arange(0, 30)
    world.point_of[2, forgotten] = NONE
    world.recount(np.arange(3))
    refresh_points(world, world.points_alive(), np.arange(3))
    before, closed = int(world.shared[2, 0]), []
    tie(world, 2, 0, closed, CAMERA)
    assert closed == [(2, 0)]
    assert before == COUNT - 30 < before + 15 < world.shared[2, 0] <= COUNT
    found = world.point_of[2, forgotten]
    assert np.array_equal(found[found != NONE], world.point_of[0, forgotten][found != NONE])


def box_depth(world: Map) -> np.ndarray:
    points = world.xyz[world.point_of[0, :COUNT]]
    return (points @ STEP[:3, :3].T + STEP[:3, 3])[:, 2]


@pytest.mark.parametrize("twist", [[0.4, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0.06, 0]])
def test_a_map_that_is_off_is_not_confirmed(twist):
    world, returns = world_with(exponential(np.array(twist, float))), Returns(CAMERA, ReturnSettings())
    returns.closed(0)
    returns.look(world, 1)
    world.poses[2] = STEP  # where the place's own points put it: that they agree with themselves is no evidence
    assert returns.look(world, 2) is None
    assert INTRINSICS[0] == CAMERA.fx


def test_without_other_points_there_is_no_evidence():
    world, returns = world_with(np.eye(4), others=20), Returns(CAMERA, ReturnSettings())
    returns.closed(0)
    returns.look(world, 1)
    assert returns.look(world, 2) is None
