"""Points from two views of them, and the tests that a point must pass to be believed."""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam.pose_optimization import CHI2_TWO
from base_station.trackers.slam.se3 import inverse


def fundamental_matrix(two_from_one: np.ndarray, camera_matrix: np.ndarray) -> np.ndarray:
    """3x3, takes a point of picture one to its epipolar line in picture two (pixels; one camera)."""
    tx, ty, tz = two_from_one[:3, 3]
    cross = np.array([[0.0, -tz, ty], [tz, 0.0, -tx], [-ty, tx, 0.0]])
    inverse_matrix = np.linalg.inv(camera_matrix)
    return inverse_matrix.T @ cross @ two_from_one[:3, :3] @ inverse_matrix


def triangulate(
    one_from_world: np.ndarray,
    two_from_world: np.ndarray,
    uv_one_px: np.ndarray,
    uv_two_px: np.ndarray,
    intrinsics: np.ndarray,
) -> np.ndarray:
    """Points (n, 3) in the world, linear least squares over the four equations of the two views; NaN where none is."""
    rows = []
    for pose, uv in ((one_from_world, uv_one_px), (two_from_world, uv_two_px)):
        xy = (np.asarray(uv, np.float64) - intrinsics[2:]) / intrinsics[:2]
        rows += [xy[:, :1] * pose[2] - pose[0], xy[:, 1:] * pose[2] - pose[1]]
    equations = np.stack(rows, axis=1)
    normal = np.swapaxes(equations[..., :3], 1, 2) @ equations
    solvable = np.abs(np.linalg.det(normal[..., :3])) > 1e-18
    points = np.full((len(equations), 3), np.nan)
    points[solvable] = -np.linalg.solve(normal[solvable, :, :3], normal[solvable, :, 3:])[..., 0]
    return points


def parallax_cosines(points: np.ndarray, center_one: np.ndarray, center_two: np.ndarray) -> np.ndarray:
    """Cosine of the angle (n,) under which each point sees the two cameras. Below 1 by more: the depth is surer."""
    one, two = points - center_one, points - center_two
    lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
    return np.sum(one * two, axis=1) / np.maximum(lengths, 1e-12)


def chi_squares(
    cam_from_world: np.ndarray, points: np.ndarray, uv_px: np.ndarray, sigma_px: np.ndarray, intrinsics: np.ndarray
) -> np.ndarray:
    """Squared reprojection errors over their variances, (n,); infinite behind the camera and for NaN points."""
    x, y, z = (points @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]).T
    fx, fy, cx, cy = intrinsics
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = (uv_px[:, 0] - fx * x / z - cx) ** 2 + (uv_px[:, 1] - fy * y / z - cy) ** 2
        return np.where(z > 0, errors / np.square(sigma_px), np.inf)


def believable(
    points: np.ndarray,
    poses: tuple[np.ndarray, np.ndarray],
    uv_px: tuple[np.ndarray, np.ndarray],
    sigma_px: tuple[np.ndarray, np.ndarray],
    intrinsics: np.ndarray,
    *,
    least_parallax_rad: float | np.ndarray,
    octave_scales: tuple[np.ndarray, np.ndarray] | None = None,
) -> np.ndarray:
    """Which points (n,) lie before both cameras, project where they are seen, and are seen under enough of an angle.

    `octave_scales` (both (n,)): the scale each keypoint was found at; it must fit the ratio of distances.
    """
    good = np.isfinite(points).all(axis=1)
    with np.errstate(invalid="ignore"):
        for pose, uv, sigma in zip(poses, uv_px, sigma_px, strict=True):
            good &= chi_squares(pose, points, uv, sigma, intrinsics) < CHI2_TWO
        centers = [inverse(pose)[:3, 3] for pose in poses]
        good &= parallax_cosines(points, *centers) < np.cos(least_parallax_rad)
        if octave_scales is not None:
            one, two = (np.linalg.norm(points - center, axis=1) for center in centers)
            ratio = (two / np.maximum(one, 1e-12)) / (octave_scales[1] / octave_scales[0])
            good &= (ratio < 1.8) & (ratio > 1 / 1.8)
    return good
