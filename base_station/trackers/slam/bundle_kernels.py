"""A small bundle adjustment, compiled: what local BA needs after every keyframe, much faster than a general one.

Levenberg-Marquardt on the reprojection errors with Huber's loss. The points are eliminated (Schur complement): each
depends on its own three numbers only, so what remains to solve has six numbers for each moving keyframe (Triggs et al.,
"Bundle Adjustment: A Modern Synthesis", 2000, section 6). `bundle_adjustment` has the same by pycolmap, for whole maps;
a test holds the two together.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from base_station.trackers.slam.bundle_problem import BundleProblem
from base_station.trackers.slam.pose_optimization import CHI2_TWO, LEAST_DEPTH
from base_station.trackers.slam.se3 import compose, exponential

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-8, 1e6
ENOUGH = 1e-4
"""An iteration that lowers the cost by a smaller share is the last one."""
BEHIND_COST = 50.0
"""Of an observation whose point lies behind the camera."""


def adjust_small(
    problem: BundleProblem, intrinsics: np.ndarray, scales: np.ndarray, *, iterations: int = 6
) -> tuple[np.ndarray, np.ndarray]:
    """Better poses (K, 4, 4) and points (P, 3); keyframes that are `fixed` stay. `scales` (levels,): sigma in px."""
    poses, points, _ = adjust_with_cost(problem, intrinsics, scales, iterations=iterations, enough=ENOUGH)
    return poses, points


def adjust_with_cost(
    problem: BundleProblem,
    intrinsics: np.ndarray,
    scales: np.ndarray,
    *,
    iterations: int,
    enough: float,
    magnification: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """As `adjust_small`, and the cost of all observations then: chi-squares, those beyond the bound grow as their root.
    `enough`: an iteration that lowers it by a smaller share is the last one. `magnification` (N,): how many px of the
    picture one px is where each observation lies, when it is not one.
    """
    moving = np.where(problem.fixed, -1, np.cumsum(~problem.fixed) - 1)
    order = np.argsort(problem.point * (len(moving) + 1) + moving[problem.keyframe] + 1, kind="stable")
    point, keyframe = problem.point[order].astype(np.int64), problem.keyframe[order].astype(np.int64)
    uv, weights = problem.uv_px[order], 1.0 / scales[problem.octave[order]] ** 2
    if magnification is not None:
        weights *= magnification[order] ** 2
    poses, points = problem.poses.copy(), problem.points.copy()
    slots = moving[keyframe]
    size = 6 * int((~problem.fixed).sum())
    point_inverse, point_gradient = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    cross = np.zeros((len(point), 6, 3))
    damping = FIRST_DAMPING
    cost = _cost(poses, points, keyframe, point, uv, weights, intrinsics)
    for _ in range(iterations):
        matrix, right = np.zeros((size, size)), np.zeros(size)
        _reduce(
            poses, points, keyframe, point, slots, uv, weights, intrinsics, damping,
            matrix, right, point_inverse, point_gradient, cross,
        )  # fmt: skip
        try:
            step = np.linalg.solve(matrix, right) if size else right
        except np.linalg.LinAlgError:
            break
        tried_poses, tried_points = poses.copy(), points.copy()
        _step(tried_poses, tried_points, moving, step, point, slots, point_inverse, point_gradient, cross)
        tried_cost = _cost(tried_poses, tried_points, keyframe, point, uv, weights, intrinsics)
        if tried_cost < cost:
            gain, cost, poses, points = cost - tried_cost, tried_cost, tried_poses, tried_points
            damping = max(damping * 0.1, LEAST_DAMPING)
            if gain < enough * cost:
                break
        else:
            damping *= 100.0
            if damping > MOST_DAMPING:
                break
    return poses, points, float(cost)


@njit(cache=True, nogil=True)
def _cost(poses, points, keyframe, point, uv, weights, intrinsics):
    cost = 0.0
    for i in range(len(point)):
        pose, p = poses[keyframe[i]], points[point[i]]
        z = pose[2, 0] * p[0] + pose[2, 1] * p[1] + pose[2, 2] * p[2] + pose[2, 3]
        if z <= LEAST_DEPTH:
            cost += BEHIND_COST
            continue
        x = pose[0, 0] * p[0] + pose[0, 1] * p[1] + pose[0, 2] * p[2] + pose[0, 3]
        y = pose[1, 0] * p[0] + pose[1, 1] * p[1] + pose[1, 2] * p[2] + pose[1, 3]
        du = uv[i, 0] - intrinsics[0] * x / z - intrinsics[2]
        dv = uv[i, 1] - intrinsics[1] * y / z - intrinsics[3]
        chi2 = weights[i] * (du * du + dv * dv)
        cost += chi2 if chi2 <= CHI2_TWO else 2.0 * np.sqrt(CHI2_TWO * chi2) - CHI2_TWO
    return cost


@njit(cache=True, nogil=True)
def _reduce(
    poses, points, keyframe, point, slots, uv, weights, intrinsics, damping,
    matrix, right, point_inverse, point_gradient, cross,
):  # fmt: skip
    """Fill the reduced normal equations, and per point and observation what `_step` needs to go back to the points."""
    fx, fy = intrinsics[0], intrinsics[1]
    j_pose, j_point, h, w = np.zeros((2, 6)), np.zeros((2, 3)), np.zeros((3, 3)), np.zeros((6, 3))
    first, n = 0, len(point)
    while first < n:
        row, end = point[first], first
        for a in range(3):
            point_gradient[row, a] = 0.0
            for b in range(3):
                h[a, b] = 0.0
        while end < n and point[end] == row:
            i = end
            end += 1
            slot = slots[i]
            for a in range(6):
                for b in range(3):
                    cross[i, a, b] = 0.0
            pose, p = poses[keyframe[i]], points[row]
            x = pose[0, 0] * p[0] + pose[0, 1] * p[1] + pose[0, 2] * p[2] + pose[0, 3]
            y = pose[1, 0] * p[0] + pose[1, 1] * p[1] + pose[1, 2] * p[2] + pose[1, 3]
            z = pose[2, 0] * p[0] + pose[2, 1] * p[1] + pose[2, 2] * p[2] + pose[2, 3]
            if z <= LEAST_DEPTH:
                continue
            over = 1.0 / z
            du = uv[i, 0] - fx * x * over - intrinsics[2]
            dv = uv[i, 1] - fy * y * over - intrinsics[3]
            weight, chi2 = weights[i], weights[i] * (du * du + dv * dv)
            if chi2 > CHI2_TWO:
                weight *= np.sqrt(CHI2_TWO / chi2)
            uz, vz = -fx * x * over * over, -fy * y * over * over
            for c in range(3):
                j_point[0, c] = fx * over * pose[0, c] + uz * pose[2, c]
                j_point[1, c] = fy * over * pose[1, c] + vz * pose[2, c]
            for a in range(3):
                point_gradient[row, a] += weight * (j_point[0, a] * du + j_point[1, a] * dv)
                for b in range(3):
                    h[a, b] += weight * (j_point[0, a] * j_point[0, b] + j_point[1, a] * j_point[1, b])
            if slot < 0:
                continue
            j_pose[0, 0], j_pose[0, 1], j_pose[0, 2] = fx * over, 0.0, uz
            j_pose[1, 0], j_pose[1, 1], j_pose[1, 2] = 0.0, fy * over, vz
            j_pose[0, 3], j_pose[0, 4], j_pose[0, 5] = y * uz, fx - x * uz, -fx * over * y
            j_pose[1, 3], j_pose[1, 4], j_pose[1, 5] = y * vz - fy, -x * vz, fy * over * x
            base = 6 * slot
            for a in range(6):
                right[base + a] += weight * (j_pose[0, a] * du + j_pose[1, a] * dv)
                for b in range(6):
                    value = weight * (j_pose[0, a] * j_pose[0, b] + j_pose[1, a] * j_pose[1, b])
                    matrix[base + a, base + b] += value * (1.0 + damping) if a == b else value
                for b in range(3):
                    cross[i, a, b] = weight * (j_pose[0, a] * j_point[0, b] + j_pose[1, a] * j_point[1, b])
        for a in range(3):
            h[a, a] = h[a, a] * (1.0 + damping) + 1e-9
        _invert3(h, point_inverse[row])
        inverse, g = point_inverse[row], point_gradient[row]
        for i in range(first, end):
            if slots[i] < 0:
                continue
            base = 6 * slots[i]
            for a in range(6):
                for b in range(3):
                    w[a, b] = (
                        cross[i, a, 0] * inverse[0, b] + cross[i, a, 1] * inverse[1, b] + cross[i, a, 2] * inverse[2, b]
                    )
                right[base + a] -= w[a, 0] * g[0] + w[a, 1] * g[1] + w[a, 2] * g[2]
            for j in range(i, end):  # ordered by slot: all of it above the diagonal, which is mirrored at the end
                other = 6 * slots[j]
                for a in range(6):
                    for b in range(6):
                        matrix[base + a, other + b] -= (
                            w[a, 0] * cross[j, b, 0] + w[a, 1] * cross[j, b, 1] + w[a, 2] * cross[j, b, 2]
                        )
        first = end
    for a in range(len(right)):
        for b in range(a):
            matrix[a, b] = matrix[b, a]


@njit(cache=True, nogil=True)
def _invert3(m, result):
    result[0, 0] = m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1]
    result[0, 1] = m[0, 2] * m[2, 1] - m[0, 1] * m[2, 2]
    result[0, 2] = m[0, 1] * m[1, 2] - m[0, 2] * m[1, 1]
    result[1, 0] = m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2]
    result[1, 1] = m[0, 0] * m[2, 2] - m[0, 2] * m[2, 0]
    result[1, 2] = m[0, 2] * m[1, 0] - m[0, 0] * m[1, 2]
    result[2, 0] = m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0]
    result[2, 1] = m[0, 1] * m[2, 0] - m[0, 0] * m[2, 1]
    result[2, 2] = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    determinant = m[0, 0] * result[0, 0] + m[0, 1] * result[1, 0] + m[0, 2] * result[2, 0]
    scale = 1.0 / determinant if abs(determinant) > 1e-300 else 0.0
    for a in range(3):
        for b in range(3):
            result[a, b] *= scale


@njit(cache=True, nogil=True)
def _step(poses, points, moving, step, point, slots, point_inverse, point_gradient, cross):
    """Move the keyframes by the solution and every point by what then is best for it."""
    for i in range(len(point)):
        if slots[i] < 0:
            continue
        base, row = 6 * slots[i], point[i]
        for b in range(3):
            for a in range(6):
                point_gradient[row, b] -= cross[i, a, b] * step[base + a]
    for i in range(len(point)):
        row = point[i]
        if i and point[i - 1] == row:
            continue
        g, inverse = point_gradient[row], point_inverse[row]
        for a in range(3):
            points[row, a] += inverse[a, 0] * g[0] + inverse[a, 1] * g[1] + inverse[a, 2] * g[2]
    twist = np.zeros(6)
    for k in range(len(moving)):
        if moving[k] < 0:
            continue
        for a in range(6):
            twist[a] = step[6 * moving[k] + a]
        moved = compose(exponential(twist), poses[k])
        for a in range(4):
            for b in range(4):
                poses[k, a, b] = moved[a, b]
