"""Whether a pair of keyframes makes a point is decided by where it should be, not by how its depth came out."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.new_points import NewPointSettings, expected_parallaxes, make_points
from base_station.trackers.slam.se3 import camera_centers, exponential
from base_station.trackers.slam.triangulation import parallax_cosines
from tests.base_station.trackers.slam.scene import SCALES, box_of_points, features_of, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
COUNT, KNOWN = 400, 60


def made(aside_m: float, misturned_rad: float = 0.0) -> np.ndarray:
    """By how much (ratio) the points of two keyframes, so far apart, come out too far. The map has the second one
    turned by a little too much."""
    rng = np.random.default_rng(3)
    world = Map(COUNT, SCALES)
    points, looks = box_of_points(rng, COUNT), random_looks(rng, COUNT)
    true = exponential(np.array([aside_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
    wrong = exponential(np.array([0.0, 0.0, 0.0, 0.0, misturned_rad, 0.0])) @ true
    for row, (pose, believed) in enumerate(((np.eye(4), np.eye(4)), (true, wrong))):
        uv = project(pose, points) + rng.normal(0, 0.1, (COUNT, 2))
        world.add_keyframe(row, 0.05 * row, believed, features_of(uv, looks), np.empty(0, np.int32), 0)
    world.point_of[:2, :KNOWN] = world.add_points(points[:KNOWN], looks[:KNOWN], 0)
    world.recount(np.arange(2))
    rows = make_points(world, 1, CAMERA, NewPointSettings())
    feature = np.array([np.flatnonzero(world.point_of[1] == row)[0] for row in rows], np.int64)
    return world.xyz[rows, 2] / points[feature, 2]


def test_a_long_way_aside_makes_points_and_a_short_one_none():
    assert len(made(0.3)) > 0.8 * (COUNT - KNOWN)
    assert made(0.3) == pytest.approx(np.ones(len(made(0.3))), rel=0.05)
    assert len(made(0.03)) == 0


def test_an_error_of_the_poses_does_not_choose_the_points():
    """By their measured parallax those that come out near would be taken, and those that come out far would not: in
    every quick turn the map shrank."""
    far, near = made(0.12, 0.004), made(0.12, -0.004)
    assert min(len(far), len(near)) > 0.4 * (COUNT - KNOWN)
    assert len(far) == pytest.approx(len(near), rel=0.15)
    assert abs(np.median(np.log(far)) + np.median(np.log(near))) < 0.06
    assert abs(np.median(np.log(far))) > 0.1  # the error is there


def test_expected_parallax_is_that_of_points_which_lie_there():
    rng = np.random.default_rng(0)
    uv, baseline = rng.uniform((0, 0), (640, 480), (50, 2)), np.array([0.2, 0.05, 0.1])
    rays = np.column_stack([(uv - CAMERA.intrinsics[2:]) / CAMERA.intrinsics[:2], np.ones(50)])
    there = np.eye(4)
    there[:3, 3] = -baseline
    cosines = parallax_cosines(8.0 * rays, np.zeros(3), camera_centers(there))
    expected = expected_parallaxes(uv, baseline, 8.0, CAMERA)
    assert expected == pytest.approx(np.arccos(cosines), rel=0.04)
