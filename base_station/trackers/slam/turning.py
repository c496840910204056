"""The turn between two pictures, from the pictures themselves, whatever the map knows of them.

In a quick turn most corners have no point in the map yet, and those that have one leave the view. All corners of both
pictures tell the turn, though, for in one step a turn moves them much more than the way aside does.
"""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.matching import NEAR, Grid, agreeing_in_turn, match_projections

ROUNDS = 8
RADIUS_PX = 60.0
"""Around where the expected turn would put a corner."""
LEAST = 30
SPREAD_PX = 3.0
"""What the way aside may leave, before a match counts less."""


def turn_between(
    one: Features, two: Features, grid: Grid, expected: np.ndarray, camera: SlamCamera
) -> np.ndarray | None:
    """3x3, two_from_one; None when too few corners agree. `expected`: about what it is; `grid`: of picture two."""
    rays = _rays(one.xy_px, camera)
    octave = one.octave.astype(np.int64)
    matches = match_projections(
        camera.project(rays @ expected.T), np.full(len(rays), RADIUS_PX),
        np.stack([octave - 1, octave + 1], axis=1), one.descriptors, two, grid, most=NEAR, ratio=0.9,
    )  # fmt: skip
    rows = np.flatnonzero(agreeing_in_turn(matches, one.angle_deg, two.angle_deg) >= 0)
    if len(rows) < LEAST:
        return None
    rotation, residual_px = fit_turn(rays[rows], _rays(two.xy_px[matches[rows]], camera), camera.fx)
    return rotation if (residual_px < 3 * SPREAD_PX).sum() >= LEAST else None


def fit_turn(one: np.ndarray, two: np.ndarray, focal_px: float) -> tuple[np.ndarray, np.ndarray]:
    """The rotation (3x3) that brings rays one (n, 3) to rays two, and by how many px (n,) it misses each. Rays have
    length 1; those that miss by much count little."""
    weights, rotation, residual = np.ones(len(one)), np.eye(3), np.zeros(len(one))
    for _ in range(ROUNDS):
        u, _, vt = np.linalg.svd((two * weights[:, None]).T @ one)
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        residual = np.linalg.norm(two - one @ rotation.T, axis=1) * focal_px
        weights = 1.0 / (1.0 + (residual / SPREAD_PX) ** 2)
    return rotation, residual


def _rays(xy_px: np.ndarray, camera: SlamCamera) -> np.ndarray:
    rays = camera.rays(xy_px)
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
