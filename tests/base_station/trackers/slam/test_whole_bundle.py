"""A whole map adjusted at once: errors that were made along its way go; a map too small for it is left alone."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam import whole_bundle
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.local_bundle import BundleSettings
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.se3 import exponential
from base_station.trackers.slam.sim3 import align, transform
from tests.base_station.trackers.slam.scene import SCALES, box_of_points, features_of, motion, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
POINTS = 150


def bent_map(keyframes: int) -> tuple[Map, np.ndarray]:
    """Keyframes in a row, each turned and moved a little more off its place; and where the points truly are."""
    rng = np.random.default_rng(21)
    world = Map(POINTS, SCALES)
    xyz, looks = box_of_points(rng, POINTS), random_looks(rng, POINTS)
    bend = motion(rng, 0.01, 0.002)
    off = np.eye(4)
    for row in range(keyframes):
        pose = exponential(np.array([0.15 * row, 0, 0, 0, 0.01 * row, 0]))
        uv = project(pose, xyz) + rng.normal(0, 0.05, (POINTS, 2))
        world.add_keyframe(row, float(row), off @ pose, features_of(uv, looks), np.empty(0, np.int32), 0)
        off = bend @ off
    rows = world.add_points(xyz + rng.normal(0, 0.01, xyz.shape), looks, 0)
    world.point_of[:keyframes] = rows
    world.recount(np.arange(keyframes))
    return world, xyz


def points_off(world: Map, xyz: np.ndarray) -> float:
    """Median distance from the truth, when aligned with it."""
    rows = world.points_alive(0)
    found = world.xyz[rows]
    return float(np.median(np.linalg.norm(transform(align(found, xyz[rows]), found) - xyz[rows], axis=1)))


@pytest.mark.parametrize("largest_dense", [300, 5])
def test_errors_along_the_way_go(monkeypatch, largest_dense):
    monkeypatch.setattr(whole_bundle, "LARGEST_DENSE", largest_dense)  # 5: by pycolmap, as large maps are
    world, xyz = bent_map(8)
    first = world.poses[0].copy()
    before = points_off(world, xyz)
    assert whole_bundle.adjust_whole(world, 0, CAMERA, BundleSettings())
    assert points_off(world, xyz) < 0.35 * before
    assert np.array_equal(world.poses[0], first)
    assert len(world.points_alive(0)) > 0.9 * POINTS
    changed = world.take_changes()
    assert len(changed.keyframes) == 8
    assert len(changed.points) == POINTS


def test_a_small_or_unknown_map_is_left_alone():
    world, _ = bent_map(2)
    poses = world.poses.copy()
    assert not whole_bundle.adjust_whole(world, 0, CAMERA, BundleSettings())
    assert not whole_bundle.adjust_whole(world, 7, CAMERA, BundleSettings())
    assert np.array_equal(world.poses, poses)
