"""Rigid motions as 4x4 float64 matrices: `target_from_source` takes a point of source's coordinates to target's."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NEWTON_STEPS = 4
"""Each squares how far a matrix is from a rotation: from 0.1 to nothing."""


def inverse(pose: np.ndarray) -> np.ndarray:
    """world_from_cam of cam_from_world. Also of a stack (..., 4, 4)."""
    turned = np.swapaxes(pose[..., :3, :3], -1, -2)
    result = np.zeros_like(pose)
    result[..., :3, :3] = turned
    result[..., :3, 3] = -(turned @ pose[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def pose_of(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """4x4 of a 3x3 rotation and a translation of three numbers, in any shape."""
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = np.ravel(translation)
    return pose


def camera_centers(cam_from_world: np.ndarray) -> np.ndarray:
    """Where cameras stand in the world: (..., 3) of poses (..., 4, 4)."""
    return inverse(cam_from_world)[..., :3, 3]


def transform(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (n, 3) in the target's coordinates."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def rotation_angle_rad(rotation: np.ndarray) -> float:
    """By how much a 3x3 rotation (or the rotation of a 4x4) turns: 0..pi."""
    r = rotation[:3, :3]
    twice_sine = math.sqrt((r[2, 1] - r[1, 2]) ** 2 + (r[0, 2] - r[2, 0]) ** 2 + (r[1, 0] - r[0, 1]) ** 2)
    return math.atan2(twice_sine, float(np.trace(r)) - 1.0)


def apart(one_from_world: np.ndarray, two_from_world: np.ndarray) -> tuple[float, float]:
    """How far apart two cameras stand, and by how much they are turned against each other, 0..pi rad: by
    `camera_centers` and `rotation_angle_rad`, but sooner."""
    distance, turn_rad = _apart(np.ascontiguousarray(one_from_world), np.ascontiguousarray(two_from_world))
    return float(distance), float(turn_rad)


@njit(cache=True, nogil=True)
def _apart(one, two):
    r, square = np.empty((3, 3)), 0.0
    for i in range(3):
        off = 0.0
        for j in range(3):
            off += two[j, i] * two[j, 3] - one[j, i] * one[j, 3]
            r[i, j] = one[i, 0] * two[j, 0] + one[i, 1] * two[j, 1] + one[i, 2] * two[j, 2]
        square += off * off
    twice_sine = np.sqrt((r[2, 1] - r[1, 2]) ** 2 + (r[0, 2] - r[2, 0]) ** 2 + (r[1, 0] - r[0, 1]) ** 2)
    return np.sqrt(square), np.arctan2(twice_sine, r[0, 0] + r[1, 1] + r[2, 2] - 1.0)


def median_depth(cam_from_world: np.ndarray, points: np.ndarray, rows: np.ndarray) -> float:
    """Of the points (n, 3) in these rows, but -1, before a camera; NaN without any."""
    return float(_median_depth(np.ascontiguousarray(cam_from_world), points, rows))


@njit(cache=True, nogil=True)
def _median_depth(pose, points, rows):
    depths, n = np.empty(len(rows)), 0
    for row in rows:
        if row >= 0:
            depths[n] = pose[2, 0] * points[row, 0] + pose[2, 1] * points[row, 1] + pose[2, 2] * points[row, 2]
            depths[n] += pose[2, 3]
            n += 1
    return np.median(depths[:n]) if n else np.nan


def relative(one_from_world: np.ndarray, two_from_world: np.ndarray) -> np.ndarray:
    """one_from_two, 4x4, its rotation brought back to a true one (the nearest): products of many drift."""
    return _relative(np.ascontiguousarray(one_from_world), np.ascontiguousarray(two_from_world))


@njit(cache=True, nogil=True)
def _relative(one, two):
    rotation, product, pose = np.empty((3, 3)), np.empty((3, 3)), np.zeros((4, 4))
    for i in range(3):
        pose[i, 3] = one[i, 3]
        for j in range(3):
            rotation[i, j] = one[i, 0] * two[j, 0] + one[i, 1] * two[j, 1] + one[i, 2] * two[j, 2]
        for j in range(3):
            pose[i, 3] -= rotation[i, j] * two[j, 3]
    for _ in range(NEWTON_STEPS):
        for i in range(3):
            for j in range(3):
                product[i, j] = -0.5 * (
                    rotation[0, i] * rotation[0, j] + rotation[1, i] * rotation[1, j] + rotation[2, i] * rotation[2, j]
                )
            product[i, i] += 1.5
        for i in range(3):
            x, y, z = rotation[i, 0], rotation[i, 1], rotation[i, 2]
            for j in range(3):
                rotation[i, j] = x * product[0, j] + y * product[1, j] + z * product[2, j]
    pose[:3, :3] = rotation
    pose[3, 3] = 1.0
    return pose


@njit(cache=True, nogil=True)
def exponential(twist):
    """4x4 motion of a twist: three of translation, then three of rotation (axis times radians)."""
    wx, wy, wz = twist[3], twist[4], twist[5]
    angle2 = wx * wx + wy * wy + wz * wz
    angle = np.sqrt(angle2)
    if angle < 1e-6:
        a, b, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
        c = (1.0 - a) / angle2
    w, pose = np.zeros((3, 3)), np.zeros((4, 4))
    w[0, 1], w[0, 2], w[1, 2] = -wz, wy, -wx
    w[1, 0], w[2, 0], w[2, 1] = wz, -wy, wx
    pose[3, 3] = 1.0
    for i in range(3):
        along = 0.0
        for j in range(3):
            squared = w[i, 0] * w[0, j] + w[i, 1] * w[1, j] + w[i, 2] * w[2, j]
            unit = 1.0 if i == j else 0.0
            pose[i, j] = unit + a * w[i, j] + b * squared
            along += (unit + b * w[i, j] + c * squared) * twist[j]
        pose[i, 3] = along
    return pose


@njit(cache=True, nogil=True)
def compose(a, b):
    """a @ b of two poses. Compiled code has no matrix product without SciPy, which nothing else here needs."""
    pose = np.zeros((4, 4))
    pose[3, 3] = 1.0
    for i in range(3):
        pose[i, 3] = a[i, 3]
        for j in range(3):
            pose[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
            pose[i, 3] += a[i, j] * b[j, 3]
    return pose
