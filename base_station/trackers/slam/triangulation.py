"""Points from two views of them, and the tests that a point must pass to be believed."""

from __future__ import annotations

import numpy as np
from numba import njit

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
    return _triangulate(
        np.ascontiguousarray(one_from_world), np.ascontiguousarray(two_from_world),
        np.asarray(uv_one_px, np.float64), np.asarray(uv_two_px, np.float64), intrinsics,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _triangulate(one, two, uv_one, uv_two, intrinsics):
    points = np.empty((len(uv_one), 3))
    rows = np.empty((4, 4))
    for i in range(len(uv_one)):
        for view in range(2):
            pose = one if view == 0 else two
            uv = uv_one[i] if view == 0 else uv_two[i]
            x = (uv[0] - intrinsics[2]) / intrinsics[0]
            y = (uv[1] - intrinsics[3]) / intrinsics[1]
            for c in range(4):
                rows[2 * view, c] = x * pose[2, c] - pose[0, c]
                rows[2 * view + 1, c] = y * pose[2, c] - pose[1, c]
        m = np.zeros((3, 3))
        right = np.zeros(3)
        for r in range(4):
            for a in range(3):
                right[a] -= rows[r, a] * rows[r, 3]
                for b in range(3):
                    m[a, b] += rows[r, a] * rows[r, b]
        d = (
            m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
            - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
            + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
        )
        if not abs(d) > 1e-18:
            points[i] = np.nan
            continue
        for c in range(3):
            e = m.copy()
            e[:, c] = right
            points[i, c] = (
                e[0, 0] * (e[1, 1] * e[2, 2] - e[1, 2] * e[2, 1])
                - e[0, 1] * (e[1, 0] * e[2, 2] - e[1, 2] * e[2, 0])
                + e[0, 2] * (e[1, 0] * e[2, 1] - e[1, 1] * e[2, 0])
            ) / d
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
    least_parallax_rad: float,
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
