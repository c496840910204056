"""The motion between two pictures: found when there is one, refused when depth cannot be told."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.se3 import exponential, rotation_angle_rad, transform
from base_station.trackers.slam.triangulation import triangulate
from base_station.trackers.slam.two_view import TwoView, solve_two_view
from tests.base_station.trackers.slam.scene import INTRINSICS, MATRIX, box_of_points, motion, project

ONES = (np.ones(300), np.ones(300))


def solve(points: np.ndarray, two_from_one: np.ndarray, noise_px: float, outliers: int, seed: int = 0) -> TwoView | str:
    rng = np.random.default_rng(seed)
    one = project(np.eye(4), points) + rng.normal(0, noise_px, (len(points), 2))
    two = project(two_from_one, points) + rng.normal(0, noise_px, (len(points), 2))
    two[:outliers] = rng.uniform([0, 0], [639, 479], (outliers, 2))
    return solve_two_view(one, two, MATRIX, ONES)


def direction_error_rad(found: np.ndarray, truth: np.ndarray) -> float:
    cosine = found[:3, 3] @ truth[:3, 3] / np.linalg.norm(truth[:3, 3]) / np.linalg.norm(found[:3, 3])
    return float(np.arccos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize(
    ("noise_px", "outliers", "rotation_rad", "direction_rad", "least", "most"),
    [(0.0, 0, 1e-4, 1e-3, 295, 300), (0.5, 0, 0.005, 0.03, 280, 300), (0.5, 90, 0.006, 0.04, 190, 215)],
    ids=["exact", "noisy", "outliers"],
)
def test_a_room(noise_px, outliers, rotation_rad, direction_rad, least, most):
    rng = np.random.default_rng(9)
    truth = motion(rng, 0.5, 0.1)
    points = box_of_points(rng, 300)
    found = solve(points, truth, noise_px, outliers)
    assert isinstance(found, TwoView), found
    assert rotation_angle_rad(found.two_from_one[:3, :3] @ truth[:3, :3].T) < rotation_rad
    assert direction_error_rad(found.two_from_one, truth) < direction_rad
    assert not found.planar
    assert least <= len(found.rows) <= most
    scale = np.linalg.norm(truth[:3, 3])
    error = np.linalg.norm(found.points * scale - points[found.rows], axis=1)
    assert np.median(error) < 0.02 + 0.2 * noise_px


def test_a_wall_is_found_by_the_homography():
    rng = np.random.default_rng(10)
    wall = np.column_stack([rng.uniform(-2, 2, 300), rng.uniform(-1.5, 1.5, 300), np.full(300, 4.0)])
    wall = transform(exponential(np.array([0, 0, 0.5, 0.2, 0.5, 0.0])), wall)
    truth = exponential(np.array([0.8, 0.1, 0.2, 0.02, -0.1, 0.02]))
    found = solve(wall, truth, 0.3, 30)
    if isinstance(found, str):
        assert found == "two motions explain it"  # a plane may have two; never a wrong one
    else:
        assert found.planar
        assert direction_error_rad(found.two_from_one, truth) < 0.1


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("turn_rad", [0.03, 0.2])
def test_a_camera_that_only_turns_is_never_believed(turn_rad, seed):
    rng = np.random.default_rng(seed)
    truth = motion(rng, 1e-9, turn_rad)
    assert isinstance(solve(box_of_points(rng, 300), truth, 0.7, 30, seed), str)


@pytest.mark.parametrize("seed", range(4))
def test_wrong_matches_are_never_believed(seed):
    rng = np.random.default_rng(seed)
    one, two = (rng.uniform([0, 0], [639, 479], (300, 2)) for _ in range(2))
    assert isinstance(solve_two_view(one, two, MATRIX, ONES), str)


def test_triangulation_is_exact_and_says_nan_where_there_is_no_point():
    rng = np.random.default_rng(11)
    points, truth = box_of_points(rng, 100), motion(rng, 0.5, 0.2)
    one, two = project(np.eye(4), points), project(truth, points)
    assert np.abs(triangulate(np.eye(4), truth, one, two, INTRINSICS) - points).max() < 1e-8
    assert np.isnan(triangulate(np.eye(4), np.eye(4), one[:1], one[:1], INTRINSICS)).all()
