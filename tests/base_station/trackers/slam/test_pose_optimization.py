"""The pose from known points: exact, with noise, with outliers; and compiled against plain numpy."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.pose_optimization import (  # private: one is what the other gives back
    _cost,
    _linearize,
    optimize_pose,
    optimize_pose_reference,
)
from base_station.trackers.slam.se3 import (
    apart,
    camera_centers,
    compose,
    exponential,
    inverse,
    median_depth,
    relative,
    rotation_angle_rad,
    transform,
)
from tests.base_station.trackers.slam.scene import INTRINSICS, box_of_points, motion, project

RNG = np.random.default_rng(5)
POINTS = box_of_points(RNG, 200)
TRUTH = motion(RNG, 0.4, 0.3)
SEEN = project(TRUTH, POINTS)


def errors(pose: np.ndarray) -> tuple[float, float]:
    off = pose @ inverse(TRUTH)
    return float(np.linalg.norm(off[:3, 3])), rotation_angle_rad(off)


def test_exact():
    fit = optimize_pose(np.eye(4), POINTS, SEEN, np.ones(200), INTRINSICS)
    assert max(errors(fit.cam_from_world)) < 1e-6
    assert fit.inliers.all()


def test_noise_gives_the_error_that_it_says_it_has():
    rng = np.random.default_rng(6)
    runs = [
        optimize_pose(np.eye(4), POINTS, SEEN + rng.normal(0, 1, SEEN.shape), np.ones(200), INTRINSICS)
        for _ in range(40)
    ]
    off = np.array([run.cam_from_world @ inverse(TRUTH) for run in runs])[:, :3, 3]
    said = np.mean([run.spread[:3] for run in runs], axis=0)
    assert np.all(off.std(axis=0) < 1.5 * said)
    assert np.all(off.std(axis=0) > 0.6 * said)
    assert 1.4 < np.mean([run.error_px2 for run in runs]) < 2.0  # two numbers of variance one, the tail cut at 5.99


def test_a_third_of_outliers_is_found_and_left_out():
    rng = np.random.default_rng(7)
    seen = SEEN + rng.normal(0, 0.5, SEEN.shape)
    wrong = rng.choice(200, 66, replace=False)
    seen[wrong] += rng.uniform(15, 80, (66, 2)) * rng.choice([-1, 1], (66, 2))
    fit = optimize_pose(TRUTH @ exponential(np.full(6, 0.03)), POINTS, seen, np.ones(200), INTRINSICS)
    assert not fit.inliers[wrong].any()
    assert 125 <= fit.inliers.sum() <= 134
    assert errors(fit.cam_from_world)[0] < 0.01
    assert errors(fit.cam_from_world)[1] < 0.003


def test_compiled_is_what_plain_numpy_finds():
    rng = np.random.default_rng(8)
    sigma = 1.2 ** rng.integers(0, 8, 200)
    seen = SEEN + rng.normal(0, 0.2, SEEN.shape) * sigma[:, None]
    fit = optimize_pose(np.eye(4), POINTS, seen, sigma, INTRINSICS)
    plain = optimize_pose_reference(np.eye(4), POINTS, seen, sigma, INTRINSICS)
    assert fit.inliers.all()
    assert np.abs(fit.cam_from_world - plain).max() < 1e-4


@pytest.mark.parametrize("count", [0, 3])
def test_too_few_points_give_the_guess_back_without_inliers(count):
    fit = optimize_pose(np.eye(4), POINTS[:count], SEEN[:count], np.ones(count), INTRINSICS)
    assert np.array_equal(fit.cam_from_world, np.eye(4))
    assert fit.inliers.sum() == 0


def test_exponential_and_compose_are_numpys():
    one, two = motion(RNG, 1.0, 1.0), motion(RNG, 2.0, 0.5)
    assert np.allclose(compose(one, two), one @ two, atol=1e-12)
    assert np.allclose(exponential(np.zeros(6)), np.eye(4))
    assert rotation_angle_rad(exponential(np.array([0, 0, 0, 0.3, 0.4, 0.0]))) == pytest.approx(0.5)


def test_relative_is_numpys_product_with_a_true_rotation():
    one, two = motion(RNG, 1.0, 1.0), motion(RNG, 2.0, 0.5)
    assert np.allclose(relative(one, two), one @ inverse(two), atol=1e-12)
    bent = one.copy()
    bent[:3, :3] += RNG.normal(0, 0.03, (3, 3))
    found = relative(bent, np.eye(4))
    u, _, vt = np.linalg.svd(bent[:3, :3])
    assert np.allclose(found[:3, :3], u @ vt, atol=1e-9)
    assert np.array_equal(found[:, 3], one[:, 3])


def test_how_far_two_cameras_are_apart_is_plain_numpys():
    one, two = motion(RNG, 1.0, 1.0), motion(RNG, 2.0, 0.5)
    step, turn_rad = apart(one, two)
    assert step == pytest.approx(np.linalg.norm(camera_centers(one) - camera_centers(two)))
    assert turn_rad == pytest.approx(rotation_angle_rad(one[:3, :3] @ two[:3, :3].T))
    assert apart(one, one) == pytest.approx((0.0, 0.0), abs=1e-7)


def test_the_median_depth_is_plain_numpys():
    rows = np.array([3, -1, 17, 40, -1, 5], np.int32)
    assert median_depth(TRUTH, POINTS, rows) == pytest.approx(
        np.median(transform(TRUTH, POINTS[rows[rows >= 0]])[:, 2])
    )
    assert np.isnan(median_depth(TRUTH, POINTS, rows[1:2]))


@pytest.mark.parametrize("robust", [True, False])
def test_a_step_is_judged_by_the_cost_that_it_is_planned_by(robust):
    pose, used = motion(RNG, 0.5, 0.4), RNG.random(len(POINTS)) < 0.8
    arguments = pose, POINTS, SEEN, RNG.uniform(0.3, 1.0, len(POINTS)), used, INTRINSICS, robust
    assert _cost(*arguments) == _linearize(*arguments, np.zeros((6, 6)), np.zeros(6)) > 0
