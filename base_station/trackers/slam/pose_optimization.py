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
    """`cam_from_world` 4x4, `inliers` (n,) bool, `error_px2`: their mean chi-square, 2 for honest sigmas;
    `information` (6, 6) about the twist (translation, rotation) that the inliers give."""

    cam_from_world: np.ndarray
    inliers: np.ndarray
    error_px2: float
    information: np.ndarray

    @property
    def spread(self) -> np.ndarray:
        """(6,): the standard deviation of the twist that the inliers leave; infinite where they say nothing."""
        try:
            return np.asarray(np.sqrt(np.maximum(np.diag(np.linalg.inv(self.information)), 0.0)))
        except np.linalg.LinAlgError:
            return np.full(6, np.inf)


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
    return PoseFit(pose, inliers, float(error), information)


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


@njit(inline="always")
def _off(pose, point, uv, intrinsics):
    """One over the depth, 0 behind the camera; where the point lies at depth 1; and how far off in px it is seen."""
    a, b, c = point[0], point[1], point[2]
    z = pose[2, 0] * a + pose[2, 1] * b + pose[2, 2] * c + pose[2, 3]
    if z <= LEAST_DEPTH:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    over = 1.0 / z
    x = (pose[0, 0] * a + pose[0, 1] * b + pose[0, 2] * c + pose[0, 3]) * over
    y = (pose[1, 0] * a + pose[1, 1] * b + pose[1, 2] * c + pose[1, 3]) * over
    return over, x, y, uv[0] - intrinsics[0] * x - intrinsics[2], uv[1] - intrinsics[1] * y - intrinsics[3]


@njit(cache=True, nogil=True)
def _cost(pose, points, uv, weights, used, intrinsics, robust):
    """What `_linearize` gives back, a step that is tried needs no more."""
    cost = 0.0
    for i in range(len(points)):
        if not used[i]:
            continue
        over, _, _, du, dv = _off(pose, points[i], uv[i], intrinsics)
        if over == 0.0:
            cost += 2.0 * CHI2_TWO
            continue
        chi2 = weights[i] * (du * du + dv * dv)
        cost += chi2 * 2.0 * np.sqrt(CHI2_TWO / chi2) - CHI2_TWO if robust and chi2 > CHI2_TWO else chi2
    return cost


@njit(cache=True, nogil=True)
def _linearize(pose, points, uv, weights, used, intrinsics, robust, information, gradient):
    """Fill the normal equations (6, 6) and (6,); the cost comes back.

    One observation's Jacobian has two zeros, and what is left is written out: this is where a pose takes its time.
    """
    fx, fy = intrinsics[0], intrinsics[1]
    cost, g0, g1, g2, g3, g4, g5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    h00, h02, h03, h04, h05, h11, h12, h13, h14, h15 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    h22, h23, h24, h25, h33, h34, h35, h44, h45, h55 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(points)):
        if not used[i]:
            continue
        over, x, y, du, dv = _off(pose, points[i], uv[i], intrinsics)
        if over == 0.0:
            cost += 2.0 * CHI2_TWO
            continue
        weight = weights[i]
        chi2 = weight * (du * du + dv * dv)
        if robust and chi2 > CHI2_TWO:
            root = np.sqrt(CHI2_TWO / chi2)
            weight *= root
            cost += chi2 * 2.0 * root - CHI2_TWO
        else:
            cost += chi2
        u0, u2, u3, u4, u5 = fx * over, -fx * x * over, -fx * x * y, fx * (1.0 + x * x), -fx * y
        v1, v2, v3, v4, v5 = fy * over, -fy * y * over, -fy * (1.0 + y * y), fy * x * y, fy * x
        wu0, wu2, wu3, wu4, wu5 = weight * u0, weight * u2, weight * u3, weight * u4, weight * u5
        wv1, wv2, wv3, wv4, wv5 = weight * v1, weight * v2, weight * v3, weight * v4, weight * v5
        g0 += wu0 * du
        g1 += wv1 * dv
        g2 += wu2 * du + wv2 * dv
        g3 += wu3 * du + wv3 * dv
        g4 += wu4 * du + wv4 * dv
        g5 += wu5 * du + wv5 * dv
        h00 += wu0 * u0
        h02 += wu0 * u2
        h03 += wu0 * u3
        h04 += wu0 * u4
        h05 += wu0 * u5
        h11 += wv1 * v1
        h12 += wv1 * v2
        h13 += wv1 * v3
        h14 += wv1 * v4
        h15 += wv1 * v5
        h22 += wu2 * u2 + wv2 * v2
        h23 += wu2 * u3 + wv2 * v3
        h24 += wu2 * u4 + wv2 * v4
        h25 += wu2 * u5 + wv2 * v5
        h33 += wu3 * u3 + wv3 * v3
        h34 += wu3 * u4 + wv3 * v4
        h35 += wu3 * u5 + wv3 * v5
        h44 += wu4 * u4 + wv4 * v4
        h45 += wu4 * u5 + wv4 * v5
        h55 += wu5 * u5 + wv5 * v5
    gradient[:] = g0, g1, g2, g3, g4, g5
    information[0, :] = h00, 0.0, h02, h03, h04, h05
    information[1, :] = 0.0, h11, h12, h13, h14, h15
    information[2, :] = h02, h12, h22, h23, h24, h25
    information[3, :] = h03, h13, h23, h33, h34, h35
    information[4, :] = h04, h14, h24, h34, h44, h45
    information[5, :] = h05, h15, h25, h35, h45, h55
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
                pose, cost = tried, tried_cost
                damping *= 0.1
                if gain < 1e-4 * cost + 1e-12:
                    break
                _linearize(pose, points, uv, weights, used, intrinsics, robust, information, gradient)
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
