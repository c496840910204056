"""How sure a pose is, from the points that it was fitted to: few points, or all in one corner, leave it free to swing.

A pose found from nowhere (relocalization) has nothing else to be checked against. The covariance of the fit says how
far noise alone may have moved it; the residuals say whether it is only noise. A pose that takes wrong matches for right
ones, or points that are not where the map has them, has residuals as large as the bound lets pass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from base_station.trackers.slam.se3 import transform


@dataclass(frozen=True, kw_only=True)
class CertaintySettings:
    """When a pose from nowhere is sure."""

    sigma_of_depth: float = 0.01
    """Largest standard deviation of the position, as a share of the points' median depth..."""
    sigma_rad: float = math.radians(0.5)
    """...and of the rotation."""
    median_residual: float = 1.2
    """Largest median of the residuals, in px of the keypoint's level: that of noise with a deviation of 1 px."""


def is_certain(
    cam_from_world: np.ndarray,
    points: np.ndarray,
    seen_px: np.ndarray,
    scales: np.ndarray,
    intrinsics: np.ndarray,
    settings: CertaintySettings,
) -> bool:
    """Whether these points (n, 3), seen at (n, 2) on levels of these scales (n,), leave the pose no freedom."""
    in_cam = transform(cam_from_world, points)
    if len(in_cam) < 3 or not (in_cam[:, 2] > 0).all():
        return False
    expected_px = in_cam[:, :2] / in_cam[:, 2:] * intrinsics[:2] + intrinsics[2:]
    residual = float(np.median(np.linalg.norm(expected_px - seen_px, axis=1) / scales))
    if residual > settings.median_residual:
        return False
    position, rotation = pose_sigmas(in_cam, scales, intrinsics)
    return position <= settings.sigma_of_depth * float(np.median(in_cam[:, 2])) and rotation <= settings.sigma_rad


def pose_sigmas(in_cam: np.ndarray, sigma_px: np.ndarray, intrinsics: np.ndarray) -> tuple[float, float]:
    """Standard deviations of a pose's position (the points' unit) and rotation (rad), all axes together, when points
    (n, 3) before the camera are seen with `sigma_px` (n,). Infinite where they do not fix it."""
    x, y, depth = in_cam.T
    zero = np.zeros_like(depth)
    across = np.stack([1 / depth, zero, -x / depth**2], 1), np.stack([zero, 1 / depth, -y / depth**2], 1)
    rows = [
        focal * np.concatenate([row, np.cross(in_cam, row)], 1) / sigma_px[:, None]
        for focal, row in zip(intrinsics[:2], across, strict=True)
    ]
    jacobian = np.concatenate(rows)
    unit = float(np.median(depth))
    jacobian[:, :3] *= unit  # both halves in comparable numbers
    information = jacobian.T @ jacobian
    if np.linalg.cond(information) > 1e12:
        return math.inf, math.inf
    variance = np.diag(np.linalg.inv(information))
    return unit * math.sqrt(variance[:3].sum()), math.sqrt(variance[3:].sum())
