"""Where the camera is, when the points are known: least squares over one pose, with outliers found and left out.

Four rounds, each from the pose before: damped Gauss-Newton on the reprojection errors, then every observation is
judged anew by its chi-square (5.991: 95 % for two numbers). Two rounds are robust (Huber), two count inliers only, as
ORB-SLAM does (Mur-Artal et al. 2015, section V; Mur-Artal and Tardos 2017, motion-only bundle adjustment).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from base_station.trackers.slam.se3 import compose, exponential

CHI2_TWO = 5.991
ROUNDS = 4
ITERATIONS = 8
LEAST_DEPTH = 1e-6
FEWEST = 4
"""Observations that a pose needs: with three there are up to four poses."""


@dataclass(frozen=True)
class PoseFit:
    """`cam_from_world` 4x4, `inliers` (n,) bool, `error_px2`: their mean chi-square, 2 for honest sigmas.

    `spread` (6,): the standard deviation of the twist (translation, rotation) that the inliers leave.
    """

    cam_from_world: np.ndarray
    inliers: np.ndarray
    error_px2: float
    spread: np.ndarray


def optimize_pose(
    cam_from_world: np.ndarray,
    points: np.ndarray,
    uv_px: np.ndarray,
    sigma_px: np.ndarray,
    intrinsics: np.ndarray,
) -> PoseFit:
    """The pose that explains where the points (n, 3) are seen, `uv_px` (n, 2), from a first guess.

    `sigma_px` (n,): standard deviations. With fewer than four inliers the guess comes back, without inliers.
    """
    pose, inliers, error, information = _optimize_pose(
        np.ascontiguousarray(cam_from_world, np.float64),
        np.ascontiguousarray(points, np.float64),
        np.ascontiguousarray(uv_px, np.float64),
        1.0 / np.square(np.asarray(sigma_px, np.float64)),
        intrinsics,
    )
    try:
        spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(information)), 0.0))
    except np.linalg.LinAlgError:
        spread = np.full(6, np.inf)
    return PoseFit(pose, inliers, float(error), spread)


@njit(cache=True, nogil=True)
def chi2_of(pose, point, u, v, weight, intrinsics):
    """Squared reprojection error over its variance; infinite behind the camera."""
    z = pose[2, 0] * point[0] + pose[2, 1] * point[1] + pose[2, 2] * point[2] + pose[2, 3]
    if z <= LEAST_DEPTH:
        return np.inf
    x = pose[0, 0] * point[0] + pose[0, 1] * point[1] + pose[0, 2] * point[2] + pose[0, 3]
    y = pose[1, 0] * point[0] + pose[1, 1] * point[1] + pose[1, 2] * point[2] + pose[1, 3]
    du = u - intrinsics[0] * x / z - intrinsics[2]
    dv = v - intrinsics[1] * y / z - intrinsics[3]
    return weight * (du * du + dv * dv)


@njit(cache=True, nogil=True)
def _linearize(pose, points, uv, weights, used, intrinsics, robust, information, gradient):
    """Fill the normal equations (6, 6) and (6,); the cost comes back."""
    for a in range(6):
        gradient[a] = 0.0
        for b in range(6):
            information[a, b] = 0.0
    cost = 0.0
    fx, fy = intrinsics[0], intrinsics[1]
    ju, jv = np.empty(6), np.empty(6)
    for i in range(len(points)):
        if not used[i]:
            continue
        p = points[i]
        x = pose[0, 0] * p[0] + pose[0, 1] * p[1] + pose[0, 2] * p[2] + pose[0, 3]
        y = pose[1, 0] * p[0] + pose[1, 1] * p[1] + pose[1, 2] * p[2] + pose[1, 3]
        z = pose[2, 0] * p[0] + pose[2, 1] * p[1] + pose[2, 2] * p[2] + pose[2, 3]
        if z <= LEAST_DEPTH:
            cost += 2.0 * CHI2_TWO
            continue
        over = 1.0 / z
        du = uv[i, 0] - fx * x * over - intrinsics[2]
        dv = uv[i, 1] - fy * y * over - intrinsics[3]
        chi2 = weights[i] * (du * du + dv * dv)
        weight = weights[i]
        if robust and chi2 > CHI2_TWO:
            root = np.sqrt(CHI2_TWO / chi2)
            weight *= root
            cost += 2.0 * np.sqrt(CHI2_TWO * chi2) - CHI2_TWO
        else:
            cost += chi2
        ju[0], ju[1], ju[2] = fx * over, 0.0, -fx * x * over * over
        jv[0], jv[1], jv[2] = 0.0, fy * over, -fy * y * over * over
        ju[3], ju[4], ju[5] = y * ju[2], ju[0] * z - x * ju[2], -ju[0] * y
        jv[3], jv[4], jv[5] = y * jv[2] - z * jv[1], -x * jv[2], jv[1] * x
        for a in range(6):
            gradient[a] += weight * (ju[a] * du + jv[a] * dv)
            for b in range(a, 6):
                information[a, b] += weight * (ju[a] * ju[b] + jv[a] * jv[b])
    for a in range(6):
        for b in range(a):
            information[a, b] = information[b, a]
    return cost


@njit(cache=True, nogil=True)
def solve_spd(matrix, right):
    """Solution of a small symmetric positive definite system by Cholesky, and whether there is one."""
    n = len(right)
    lower = np.zeros((n, n))
    x = right.copy()
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 1e-300:
                    return x, False
                lower[i, i] = np.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    for i in range(n):
        for k in range(i):
            x[i] -= lower[i, k] * x[k]
        x[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= lower[k, i] * x[k]
        x[i] /= lower[i, i]
    return x, True


@njit(cache=True, nogil=True)
def _cost(pose, points, uv, weights, used, intrinsics, robust):
    cost = 0.0
    for i in range(len(points)):
        if used[i]:
            chi2 = chi2_of(pose, points[i], uv[i, 0], uv[i, 1], weights[i], intrinsics)
            if not np.isfinite(chi2):
                cost += 2.0 * CHI2_TWO
            elif robust and chi2 > CHI2_TWO:
                cost += 2.0 * np.sqrt(CHI2_TWO * chi2) - CHI2_TWO
            else:
                cost += chi2
    return cost


@njit(cache=True, nogil=True)
def _optimize_pose(start, points, uv, weights, intrinsics):
    n = len(points)
    pose = start.copy()
    used = np.ones(n, np.bool_)
    information, damped, gradient = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
    error = np.inf
    for round_ in range(ROUNDS):
        robust = round_ < 2
        damping = 1e-6
        cost = _linearize(pose, points, uv, weights, used, intrinsics, robust, information, gradient)
        for _ in range(ITERATIONS):
            for a in range(6):
                for b in range(6):
                    damped[a, b] = information[a, b]
                damped[a, a] += damping * information[a, a] + 1e-12
            step, solved = solve_spd(damped, gradient)
            if not solved:
                break
            tried = compose(exponential(step), pose)
            tried_cost = _cost(tried, points, uv, weights, used, intrinsics, robust)
            if tried_cost < cost:
                gain = cost - tried_cost
                pose = tried
                cost = _linearize(pose, points, uv, weights, used, intrinsics, robust, information, gradient)
                damping *= 0.1
                if gain < 1e-4 * cost + 1e-12:
                    break
            else:
                damping *= 100.0
                if damping > 1e6:
                    break
        count, error = 0, 0.0
        for i in range(n):
            chi2 = chi2_of(pose, points[i], uv[i, 0], uv[i, 1], weights[i], intrinsics)
            used[i] = chi2 <= CHI2_TWO
            if used[i]:
                count += 1
                error += chi2
        if count < FEWEST:
            return start, np.zeros(n, np.bool_), np.inf, np.zeros((6, 6))
        error /= count
    _linearize(pose, points, uv, weights, used, intrinsics, False, information, gradient)
    return pose, used, error, information


def optimize_pose_reference(
    cam_from_world: np.ndarray, points: np.ndarray, uv_px: np.ndarray, sigma_px: np.ndarray, intrinsics: np.ndarray
) -> np.ndarray:
    """What `optimize_pose` converges to when all observations are inliers, in plain numpy: for tests. 4x4."""
    fx, fy, cx, cy = intrinsics
    pose = np.array(cam_from_world, np.float64)
    for _ in range(20):
        x, y, z = (points @ pose[:3, :3].T + pose[:3, 3]).T
        residual = np.stack([uv_px[:, 0] - fx * x / z - cx, uv_px[:, 1] - fy * y / z - cy], axis=1)
        zero = np.zeros_like(x)
        by_point = np.stack(
            [np.stack([fx / z, zero, -fx * x / z**2], axis=1), np.stack([zero, fy / z, -fy * y / z**2], axis=1)], axis=1
        )
        cross = np.stack(
            [np.stack([zero, z, -y], axis=1), np.stack([-z, zero, x], axis=1), np.stack([y, -x, zero], axis=1)], axis=1
        )
        jacobian = np.concatenate([by_point, by_point @ cross], axis=2) / sigma_px[:, None, None]
        weighted = residual / sigma_px[:, None]
        rows = jacobian.reshape(-1, 6)
        pose = exponential(np.linalg.lstsq(rows, weighted.ravel(), rcond=None)[0]) @ pose
    return pose
