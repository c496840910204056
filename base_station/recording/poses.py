"""Poses on the floor as matrices: of the robot, and of a camera on it that looks along its heading or its pan.

World: x and y on the floor, z up. Robot: x ahead, y to the left, z up. Camera: x to the right, y down, z ahead, as in
computer vision; it stands above the robot's axle, and its height is left out.
"""

from __future__ import annotations

import math

import numpy as np


def world_from_robot(x_m: float, y_m: float, heading_rad: float) -> np.ndarray:
    """4x4."""
    c, s = math.cos(heading_rad), math.sin(heading_rad)
    return np.array([[c, -s, 0, x_m], [s, c, 0, y_m], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def world_from_camera(x_m: float, y_m: float, heading_rad: float, pan_rad: float = 0.0) -> np.ndarray:
    """4x4."""
    c, s = math.cos(heading_rad + pan_rad), math.sin(heading_rad + pan_rad)
    return np.array([[s, 0, c, x_m], [-c, 0, s, y_m], [0, -1, 0, 0], [0, 0, 0, 1.0]])
