"""The turn between two pictures is told by their corners alone, wrong matches and a way aside notwithstanding."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.matching import Grid
from base_station.trackers.slam.se3 import exponential, rotation_angle_rad
from base_station.trackers.slam.turning import fit_turn, turn_between
from tests.base_station.trackers.slam.scene import box_of_points, features_of, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
COUNT = 300


def pair(motion: np.ndarray, outliers: int, seed: int = 0) -> tuple[Features, Features, Grid]:
    rng = np.random.default_rng(seed)
    points, looks = box_of_points(rng, COUNT), random_looks(rng, COUNT)
    one, two = (project(pose, points) + rng.normal(0, 0.5, (COUNT, 2)) for pose in (np.eye(4), motion))
    two[:outliers] += rng.uniform(-40, 40, (outliers, 2))
    features = features_of(two, looks)
    return features_of(one, looks), features, Grid.of(features.xy_px, CAMERA.bounds_px)


@pytest.mark.parametrize(
    ("aside_m", "outliers", "most_rad"),
    [(0.0, 0, 0.0005), (0.0, 90, 0.001), (0.04, 60, 0.01)],
    ids=["only turned", "with outliers", "and aside"],
)
def test_the_turn_is_found(aside_m, outliers, most_rad):
    motion = exponential(np.array([aside_m, 0.0, 0.01, 0.03, 0.14, 0.02]))
    one, two, grid = pair(motion, outliers)
    expected = exponential(np.array([0, 0, 0, 0.0, 0.1, 0.0]))[:3, :3]
    found = turn_between(one, two, grid, expected, CAMERA)
    assert found is not None
    assert rotation_angle_rad(found @ motion[:3, :3].T) < most_rad
    assert rotation_angle_rad(expected @ motion[:3, :3].T) > 0.04  # it was not there before


def test_other_pictures_tell_none():
    one, _, _ = pair(np.eye(4), 0)
    _, two, grid = pair(np.eye(4), 0, seed=1)
    assert turn_between(one, two, grid, np.eye(3), CAMERA) is None


def test_the_fit_says_what_it_misses():
    rays = np.random.default_rng(2).normal(0, 0.2, (50, 3)) + np.array([0, 0, 1])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rotation = exponential(np.array([0, 0, 0, 0.1, -0.2, 0.05]))[:3, :3]
    turned = rays @ rotation.T
    turned[0] = turned[0] @ exponential(np.array([0, 0, 0, 0.0, 0.1, 0.0]))[:3, :3].T
    found, residual_px = fit_turn(rays, turned, 500.0)
    assert rotation_angle_rad(found @ rotation.T) < 1e-3
    assert residual_px[1:].max() < 1.0 < 30 < residual_px[0]
