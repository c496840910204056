"""Points seen under a small angle are made only by a keyframe that is about to lose the map in a quick turn."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.new_points import NewPointSettings, make_points
from base_station.trackers.slam.se3 import exponential
from tests.base_station.trackers.slam.scene import SCALES, box_of_points, features_of, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
COUNT = 200


def made(known: int, turned_rad: float) -> int:
    """How many points a keyframe 0.05 s and 5 cm after another makes, half a degree of parallax in some 5 m; both see
    `known` points of the map."""
    rng = np.random.default_rng(3)
    world = Map(COUNT, SCALES)
    points, looks = box_of_points(rng, COUNT), random_looks(rng, COUNT)
    step = exponential(np.array([0.05, 0.0, 0.0, 0.0, turned_rad, 0.0]))
    for row, pose in enumerate((np.eye(4), step)):
        uv = project(pose, points) + rng.normal(0, 0.1, (COUNT, 2))
        world.add_keyframe(row, 0.05 * row, pose, features_of(uv, looks), np.empty(0, np.int32), 0)
    rows = world.add_points(points[:known], looks[:known], 0)
    world.point_of[:2, :known] = rows
    world.recount(np.arange(2))
    return len(make_points(world, 1, CAMERA, NewPointSettings()))


@pytest.mark.parametrize(("known", "turned_rad"), [(40, 0.01), (130, 0.09)], ids=["slow", "sees enough"])
def test_unsure_points_are_not_made(known, turned_rad):
    assert made(known, turned_rad) < 0.1 * (COUNT - known)


def test_a_quick_turn_that_sees_little_makes_them():
    assert made(40, 0.09) > 0.5 * (COUNT - 40)
