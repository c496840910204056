"""A calibration board in the simulation, and somebody who shows it to the camera: from pose to pose, still in each.

The board is the one that `base-station calibrate board` prints unless told otherwise (ChArUco, 7 x 5 squares), smaller:
the camera stands 10 cm above the floor, and the board has to reach the lower rim of its view. The poses visit nine
parts of the picture, tilted to all sides, near and a little farther away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_agent.sim import thymio
from robot_agent.sim.projection import HORIZONTAL_FOV_RAD

COLUMNS, ROWS, SQUARE_M = 7, 5, 0.020
MARKER_SHARE = 0.7
RIM_M = 0.005
"""White, around the squares."""
SHEET_M = (COLUMNS * SQUARE_M + 2 * RIM_M, ROWS * SQUARE_M + 2 * RIM_M)
HOLD_S, MOVE_S = 0.3, 0.2

_ROUNDS = 3
"""Visits to each part of the picture; then it all begins anew."""
_TILTS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""About the vertical and the horizontal."""
_NEAR_M, _FAR_M = (0.165, 0.195), (0.24, 0.28)
_SQUARE_ON = (0.5, 0.5, -0.5, -0.5)
"""The quaternion of a board that looks straight at a camera that looks along the world's x axis."""


@dataclass(frozen=True)
class Held:
    """Where the middle of the board's face is in the room, and how it is turned (w, x, y, z): the printed face is the
    board's xy plane, x to its right and y up, and is seen from +z."""

    position_m: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class Showing:
    """Poses one after another: `positions_m` (n, 3), `quaternions` (n, 4)."""

    positions_m: np.ndarray
    quaternions: np.ndarray

    def at(self, time_s: float) -> Held:
        """At a time of the scenario, which may be any."""
        step, within_s = divmod(time_s, HOLD_S + MOVE_S)
        here = int(step) % len(self.positions_m)
        there = (here + 1) % len(self.positions_m)
        share = max(0.0, within_s - HOLD_S) / MOVE_S
        share = share * share * (3.0 - 2.0 * share)  # off and on gently
        position = (1 - share) * self.positions_m[here] + share * self.positions_m[there]
        first, second = self.quaternions[here], self.quaternions[there]
        mixed = (1 - share) * first + share * (second if first @ second >= 0 else -second)
        mixed = mixed / np.linalg.norm(mixed)
        x, y, z = position.tolist()
        qw, qx, qy, qz = mixed.tolist()
        return Held((x, y, z), (qw, qx, qy, qz))


def draw_showing(rng: np.random.Generator) -> Showing:
    """Poses before a robot that stands in the room's origin and looks along the x axis."""
    tangent = math.tan(HORIZONTAL_FOV_RAD / 2)
    parts = [(across, down) for down in (-1, 0, 1) for across in (-1, 0, 1)]
    positions, quaternions = [], []
    for turn in range(_ROUNDS):
        for number in rng.permutation(len(parts)).tolist():
            across, down = parts[number]
            far = turn == 1 and down <= 0
            depth_m = float(rng.uniform(*(_FAR_M if far else _NEAR_M)))
            reach = (0.62 if far else 0.5) * tangent * depth_m
            left_m = -across * reach * float(rng.uniform(0.95, 1.05))
            up_m = -down * 0.72 * reach * float(rng.uniform(0.95, 1.05))
            positions.append((depth_m, left_m, thymio.CAMERA_HEIGHT_M + up_m))
            turned, tipped = _TILTS[len(positions) % len(_TILTS)]
            tilt_rad = float(rng.uniform(0.38, 0.55))
            quaternions.append(_quaternion(turned * tilt_rad, tipped * tilt_rad, float(rng.uniform(-0.15, 0.15))))
    return Showing(positions_m=np.array(positions), quaternions=np.array(quaternions))


def _quaternion(turned_rad: float, tipped_rad: float, rolled_rad: float) -> tuple[float, ...]:
    """Of a board held before the camera, rolled, then tipped about the horizontal, then turned about the vertical."""
    turned, tipped, rolled = (
        (math.cos(angle / 2), *(math.sin(angle / 2) * (axis == k) for k in (0, 1, 2)))
        for axis, angle in ((2, turned_rad), (1, tipped_rad), (0, rolled_rad))
    )
    return _times(turned, _times(tipped, _times(rolled, _SQUARE_ON)))


def _times(left: tuple[float, ...], right: tuple[float, ...]) -> tuple[float, ...]:
    """Product of two quaternions: the rotation `right`, then `left`."""
    a, b, c, d = left
    w, x, y, z = right
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )
