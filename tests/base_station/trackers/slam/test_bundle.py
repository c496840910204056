"""Bundle adjustment: the compiled one finds the truth, resists outliers, and agrees with pycolmap's."""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam.bundle_adjustment import bundle_adjust
from base_station.trackers.slam.bundle_kernels import adjust_small
from base_station.trackers.slam.bundle_problem import BundleProblem
from tests.base_station.trackers.slam.scene import INTRINSICS, SCALES, box_of_points, motion, project


def problem(noise: float, outliers: int = 0) -> tuple[BundleProblem, np.ndarray, np.ndarray]:
    """Six keyframes, the first two held, 150 points, all displaced; and the truth of both."""
    rng = np.random.default_rng(12)
    points = box_of_points(rng, 150)
    poses = np.array([motion(rng, 0.4, 0.1) for _ in range(6)])
    keyframe, point = (index.ravel() for index in np.meshgrid(np.arange(6), np.arange(150), indexing="ij"))
    octave = rng.integers(0, 8, len(point))
    uv = np.concatenate([project(pose, points) for pose in poses])
    uv = uv + rng.normal(0, 1, uv.shape) * noise * SCALES[octave][:, None]
    uv[rng.choice(len(uv), outliers, replace=False)] += 60.0
    start = poses.copy()
    for row in range(2, 6):
        start[row] = motion(rng, 0.05, 0.02) @ poses[row]
    fixed = np.arange(6) < 2
    moved = points + rng.normal(0, 0.05, points.shape)
    return BundleProblem(start, fixed, moved, keyframe, point, uv, octave), poses, points


def test_exact():
    given, poses, points = problem(0.0)
    found_poses, found_points = adjust_small(given, INTRINSICS, SCALES, iterations=20)
    assert np.abs(found_poses - poses).max() < 1e-5
    assert np.abs(found_points - points).max() < 1e-4
    assert np.array_equal(found_poses[:2], given.poses[:2])


def test_it_agrees_with_pycolmap():
    given, poses, points = problem(0.4, outliers=20)
    ours, our_points = adjust_small(given, INTRINSICS, SCALES, iterations=30)
    theirs, their_points = bundle_adjust(given, INTRINSICS, SCALES, iterations=60)
    assert np.abs(ours - theirs).max() < 2e-3
    assert np.median(np.abs(our_points - their_points)) < 2e-3
    before = np.abs(given.poses - poses).max()
    assert 1e-4 < np.abs(ours - poses).max() < 0.25 * before
    assert np.median(np.abs(our_points - points)) < 0.02


def test_nothing_to_adjust_changes_nothing():
    given, _, _ = problem(0.0)
    none = np.empty(0, np.int64)
    empty = BundleProblem(given.poses, given.fixed, given.points, none, none, np.empty((0, 2)), none)
    poses, points = adjust_small(empty, INTRINSICS, SCALES)
    assert np.allclose(poses, given.poses)
    assert np.array_equal(points, given.points)
