"""A pose that is followed is not always one to be told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.local_map import LocalMap
from base_station.trackers.slam.map import Map, refresh_points
from base_station.trackers.slam.matching import Grid
from base_station.trackers.slam.se3 import exponential
from base_station.trackers.slam.tracking import FrameTracker, Located, Picture
from tests.base_station.trackers.slam.scene import SCALES, box_of_points, features_of, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
COUNT = 80


@pytest.mark.parametrize(
    ("points", "deg_s", "trustworthy"),
    [(40, 30.0, True), (40, 90.0, False), (60, 90.0, True)],
    ids=["few in a slow turn", "few in a quick turn", "many in a quick turn"],
)
def test_few_points_in_a_quick_turn_are_no_pose_to_tell(points, deg_s, trustworthy):
    rng = np.random.default_rng(0)
    world, looks = Map(COUNT, SCALES), random_looks(rng, COUNT)
    features = features_of(project(np.eye(4), box_of_points(rng, COUNT)), looks)
    world.add_keyframe(0, 0.0, np.eye(4), features, np.empty(0, np.int32), 0)
    tracker, grid = FrameTracker(CAMERA, world), Grid.of(features.xy_px, CAMERA.bounds_px)
    nothing = np.full(COUNT, -1, np.int32)
    around = LocalMap(0, np.array([0]), np.empty(0, np.int64))

    first = Located(np.eye(4), nothing, 0, points, around, points)
    assert not tracker.doubt(Picture(0.0, features, grid), first)  # there is no turn yet
    assert "confirmed" in tracker.doubt(Picture(0.0, features, grid), replace(first, unconfirmed=True))
    tracker.remember(Picture(0.0, features, grid), first, moving=False)
    turned = exponential(np.array([0.0, 0.0, 0.0, 0.0, math.radians(deg_s) / 20, 0.0]))
    there = Located(turned, nothing, 0, points, around, points)
    assert (tracker.doubt(Picture(0.05, features, grid), there) == "") is trustworthy


@pytest.mark.parametrize(("unseen", "unconfirmed"), [(0, False), (4 * COUNT, True)])
def test_found_again_by_few_of_what_should_be_seen_is_to_be_confirmed(unseen, unconfirmed):
    rng = np.random.default_rng(1)
    points, looks = box_of_points(rng, COUNT + unseen), random_looks(rng, COUNT + unseen)
    world = Map(COUNT + unseen, SCALES)
    both = features_of(project(np.eye(4), points), looks)
    world.add_keyframe(0, 0.0, np.eye(4), both, np.empty(0, np.int32), 0)
    rows = world.add_points(points, looks, 0)
    world.point_of[0, rows] = rows
    refresh_points(world, rows, np.array([0]))
    shown = both.part(np.arange(COUNT))
    found = FrameTracker(CAMERA, world).locate_by(Picture(1.0, shown, Grid.of(shown.xy_px, CAMERA.bounds_px)), 0)
    assert isinstance(found, Located)
    assert found.unconfirmed is unconfirmed
