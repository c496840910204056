"""What a mapping tracker made of a drive, against where the robot truly was."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from base_station.trackers.base import Survey
from protocol import Truth

CAMERA_FROM_ROBOT = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""Axes: the camera's are right, down, forwards; the robot's forwards, left, up. The camera stands above the axle."""


class Mapped(TypedDict):
    """The fields of `closed_loop.Summary` that tell of the map."""

    loops_closed: int | None
    loops_confirmed: int | None
    loops_at_m: list[float] | None
    keyframes: int | None
    maps: int | None
    trajectory_share: float | None
    ate_rmse_m: float | None
    ate_share_of_path: float | None


def mapped(survey: Survey | None, truths: list[tuple[float, Truth]], path_m: float | None) -> Mapped:
    """`truths`: (time_s, truth) of each frame since learning, in the frames' own time. None for a tracker without a
    map, and for errors where there is too little to compare."""
    if survey is None:
        return Mapped(
            loops_closed=None, loops_confirmed=None, loops_at_m=None, keyframes=None, maps=None, trajectory_share=None,
            ate_rmse_m=None, ate_share_of_path=None,
        )  # fmt: skip
    ate_m = _ate_m(survey, truths)
    return Mapped(
        loops_closed=survey.loops,
        loops_confirmed=survey.confirmed,
        loops_at_m=_driven_at_m(survey.loop_times_s, truths),
        keyframes=survey.keyframes,
        maps=survey.maps,
        trajectory_share=round(len(survey.trajectory) / len(truths), 6) if truths else None,
        ate_rmse_m=ate_m,
        ate_share_of_path=round(ate_m / path_m, 6) if ate_m is not None and path_m else None,
    )


def world_from_camera(truth: Truth) -> np.ndarray:
    """4x4 of the robot's camera, level, at height 0; z up."""
    x, y, heading = truth.robot
    c, s = math.cos(heading), math.sin(heading)
    pose = np.eye(4)
    pose[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ CAMERA_FROM_ROBOT.T
    pose[:2, 3] = x, y
    return pose


def _driven_at_m(times_s: Sequence[float], truths: list[tuple[float, Truth]]) -> list[float]:
    """How far the robot had truly driven at these times."""
    if not truths:
        return []
    places = np.array([truth.robot[:2] for _, truth in truths])
    driven_m = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    found = np.interp(times_s, [time_s for time_s, _ in truths], driven_m)
    return [round(float(metres), 3) for metres in found]


def _ate_m(survey: Survey, truths: list[tuple[float, Truth]]) -> float | None:
    if not survey.trajectory or not truths:
        return None
    from base_station.evaluation.slam.trajectory import Trajectory  # compiles: only for a tracker that has compiled too
    from base_station.evaluation.slam.trajectory_errors import errors

    true = Trajectory.of((time_s, world_from_camera(truth)) for time_s, truth in truths)
    found = errors(Trajectory.of(survey.trajectory), true)
    return None if found is None else round(found.ate_rmse, 6)
