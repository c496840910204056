"""Synthetic truth for the solvers: cameras, points, and what the ones see of the others."""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam.features import Features
from base_station.trackers.slam.se3 import exponential, transform

INTRINSICS = np.array([500.0, 500.0, 319.5, 239.5])
MATRIX = np.array([[500.0, 0.0, 319.5], [0.0, 500.0, 239.5], [0.0, 0.0, 1.0]])
SCALES = 1.2 ** np.arange(8)


def box_of_points(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3), 3 to 7 before a camera at the origin, all in its view."""
    depth = rng.uniform(3.0, 7.0, count)
    return (
        np.column_stack([rng.uniform(-0.5, 0.5, count), rng.uniform(-0.4, 0.4, count), np.ones(count)]) * depth[:, None]
    )


def project(cam_from_world: np.ndarray, points: np.ndarray) -> np.ndarray:
    seen = transform(cam_from_world, points)
    return seen[:, :2] / seen[:, 2:] * INTRINSICS[:2] + INTRINSICS[2:]


def motion(rng: np.random.Generator, translation: float, rotation_rad: float) -> np.ndarray:
    """A 4x4 with a translation and a rotation of these sizes, about random axes."""
    twist = rng.normal(size=6)
    twist[:3] *= translation / np.linalg.norm(twist[:3])
    twist[3:] *= rotation_rad / np.linalg.norm(twist[3:])
    return exponential(twist)


def random_looks(rng: np.random.Generator, count: int) -> np.ndarray:
    """Descriptors (count, 4) that differ in some 128 bits from each other."""
    return rng.integers(0, 2**64, (count, 4), dtype=np.uint64)


def features_of(uv: np.ndarray, looks: np.ndarray) -> Features:
    """Of the finest level, upright."""
    return Features(uv.astype(np.float32), np.zeros(len(uv), np.uint8), np.zeros(len(uv), np.float32), looks)
