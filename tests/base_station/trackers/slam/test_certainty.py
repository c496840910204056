"""How sure a pose is: the reckoned deviations are those that noise makes; few or crowded points are not believed."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.certainty import CertaintySettings, is_certain, pose_sigmas
from base_station.trackers.slam.pose_optimization import optimize_pose
from base_station.trackers.slam.se3 import camera_centers, rotation_angle_rad
from tests.base_station.trackers.slam.scene import INTRINSICS, box_of_points, project

SETTINGS = CertaintySettings()
HERE = np.eye(4)


def seen(points: np.ndarray, sigma_px: float, seed: int = 0) -> np.ndarray:
    return project(HERE, points) + np.random.default_rng(seed).normal(0.0, sigma_px, (len(points), 2))


@pytest.mark.parametrize("count", [30, 200])
def test_the_deviations_are_those_that_noise_makes(count):
    points, scales = box_of_points(np.random.default_rng(1), count), np.ones(count)
    poses = [
        optimize_pose(HERE, points, seen(points, 0.7, seed), scales, INTRINSICS).cam_from_world for seed in range(120)
    ]
    position, rotation = pose_sigmas(points, 0.7 * scales, INTRINSICS)
    moved = np.sqrt(np.mean([np.sum(camera_centers(pose) ** 2) for pose in poses]))
    turned = np.sqrt(np.mean([rotation_angle_rad(pose[:3, :3]) ** 2 for pose in poses]))
    assert moved == pytest.approx(position, rel=0.25)
    assert turned == pytest.approx(rotation, rel=0.25)


def certain(points: np.ndarray, uv_px: np.ndarray) -> bool:
    pose = optimize_pose(HERE, points, uv_px, np.ones(len(points)), INTRINSICS).cam_from_world
    return is_certain(pose, points, uv_px, np.ones(len(points)), INTRINSICS, SETTINGS)


def test_points_all_over_the_view_are_sure_and_a_crowd_in_a_corner_is_not():
    spread = box_of_points(np.random.default_rng(2), 150)
    assert certain(spread, seen(spread, 0.8))
    crowd = np.array([0.8, 0.6, 4.0]) + 0.15 * np.random.default_rng(3).uniform(-1, 1, (50, 3))
    assert not certain(crowd, seen(crowd, 0.8))


def test_points_that_are_not_where_the_map_has_them_are_told_by_what_is_left():
    points = box_of_points(np.random.default_rng(4), 150)
    assert not certain(points, seen(points, 1.6))


def test_points_that_fix_nothing_or_lie_behind_are_never_sure():
    one = np.tile([0.0, 0.0, 4.0], (20, 1))
    assert pose_sigmas(one, np.ones(20), INTRINSICS) == (np.inf, np.inf)
    behind = box_of_points(np.random.default_rng(5), 50) * np.array([1.0, 1.0, -1.0])
    assert not is_certain(HERE, behind, np.zeros((50, 2)), np.ones(50), INTRINSICS, SETTINGS)
