"""Poses on the floor as matrices (4x4): of the robot, and of a camera on it that looks along its heading or its pan.

World: x and y on the floor, z up. Robot: x ahead, y to the left, z up. Camera: x to the right, y down, z ahead, as in
computer vision; it stands above the robot's axle, and its height is left out.
"""

from __future__ import annotations

import math

import numpy as np

ROBOT_FROM_CAMERA = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])


def turned_about_z(angle_rad: float) -> np.ndarray:
    """To the left, where x looks ahead."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def world_from_robot(x_m: float, y_m: float, heading_rad: float) -> np.ndarray:
    """A robot at this place."""
    found = turned_about_z(heading_rad)
    found[:2, 3] = x_m, y_m
    return found


def world_from_camera(x_m: float, y_m: float, heading_rad: float, pan_rad: float = 0.0) -> np.ndarray:
    """Of the robot at this place."""
    return world_from_robot(x_m, y_m, heading_rad + pan_rad) @ ROBOT_FROM_CAMERA


def inverse(pose: np.ndarray) -> np.ndarray:
    """Of a rigid pose; of a matrix that is none, something finite."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = pose[:3, :3].T, -pose[:3, :3].T @ pose[:3, 3]
    return found
