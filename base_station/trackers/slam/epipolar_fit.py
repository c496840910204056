"""The motion between two pictures that fits matched keypoints most exactly: by how far off epipolar lines they lie.

Five numbers, no depths. A step aside looks much like a turn, most of all when the camera moves ahead and what it sees
is far: the cost has several lowest places then, tens of degrees of direction apart, and an essential matrix from a few
matches leads to any of them. A bundle adjustment with depths creeps along the valley. So the fit starts anew from the
axes' directions, too.
"""

from __future__ import annotations

import cv2
import numpy as np

from base_station.trackers.slam.se3 import pose_of

ROUNDS = 12
STEP = 1e-5
FARTHEST_STEP = 0.3
FINEST_PX, SOFT_SIGMAS = 0.15, 2.4


def epipolar_residuals(motion: np.ndarray, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    """Sampson's distance (n,) of rays (n, 3) with last number 1, in units of the focal length, for two_from_one."""
    return _residuals(motion[:3, :3], motion[:3, 3], one, two)


def fitted_motions(
    motion: np.ndarray,
    turn: np.ndarray,
    one_px: np.ndarray,
    two_px: np.ndarray,
    camera_matrix: np.ndarray,
    sigma_px: np.ndarray,
) -> list[np.ndarray]:
    """What the fit comes to from this motion (two_from_one), and from a turn (3x3) along each axis.

    Matched keypoints (n, 2), their standard deviations (n,). Translations have length 1, and either sign fits as well.
    """
    inverse_matrix = np.linalg.inv(camera_matrix)
    one, two = (np.column_stack([px, np.ones(len(px))]) @ inverse_matrix.T for px in (one_px, two_px))
    weights = camera_matrix[0, 0] / sigma_px
    along = motion[:3, 3] / np.linalg.norm(motion[:3, 3])
    starts = [(motion[:3, :3], along), *((turn, axis) for axis in np.eye(3))]
    return [_fit(rotation, start, one, two, weights) for rotation, start in starts]


def _residuals(rotation: np.ndarray, along: np.ndarray, one: np.ndarray, two: np.ndarray) -> np.ndarray:
    x, y, z = along
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ rotation
    line_two, line_one = one @ essential.T, two @ essential
    square = np.square(line_two[:, :2]).sum(axis=1) + np.square(line_one[:, :2]).sum(axis=1)
    return np.einsum("ij,ij->i", two, line_two) / np.sqrt(np.maximum(square, 1e-18))


def _fit(rotation: np.ndarray, along: np.ndarray, one: np.ndarray, two: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Gauss-Newton over the turn and the direction; matches that fit badly count little."""
    for _ in range(ROUNDS):
        aside = np.linalg.svd(along[None])[2][1:]
        now = _residuals(rotation, along, one, two)
        turned = [_residuals(cv2.Rodrigues(STEP * axis)[0] @ rotation, along, one, two) for axis in np.eye(3)]
        led = [_residuals(rotation, along + STEP * axis, one, two) for axis in aside]
        jacobian = (np.column_stack(turned + led) - now[:, None]) / STEP * weights[:, None]
        residual = now * weights
        sigma = max(1.4826 * float(np.median(np.abs(residual))), FINEST_PX)
        soft = 1.0 / np.square(1.0 + np.square(residual / (SOFT_SIGMAS * sigma)))
        normal = jacobian.T @ (soft[:, None] * jacobian)
        normal[np.diag_indices(5)] *= 1.0 + 1e-3
        if np.linalg.cond(normal) > 1e12:
            break
        step = -np.linalg.solve(normal, jacobian.T @ (soft * residual))
        step *= min(1.0, FARTHEST_STEP / max(float(np.linalg.norm(step)), 1e-12))
        rotation = cv2.Rodrigues(step[:3])[0] @ rotation
        along = along + step[3:] @ aside
        along = along / np.linalg.norm(along)
    return pose_of(rotation, along)
