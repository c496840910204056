"""How far a robot stands from where it learned its target, in the target's own coordinates. From the truth only."""

from __future__ import annotations

import math

from protocol import Truth

STANDS_WITHIN_M = 0.005
"""A target that moved by more than this since it was learned is no place to come back to."""


def lateral_error_m(truth: Truth, learned: Truth) -> float | None:
    """To the left, as one looks at the target, of where the robot was; None without a target that stands."""
    if not _stands(truth, learned):
        return None
    return _in_target(truth)[1] - _in_target(learned)[1]


def heading_error_rad(truth: Truth, learned: Truth) -> float | None:
    """Left positive."""
    return _wrapped(_in_target(truth)[2] - _in_target(learned)[2]) if _stands(truth, learned) else None


def view_angle_rad(truth: Truth, learned: Truth) -> float | None:
    """The true value of `TrackerResult.view_angle_rad`; the target may have moved. The camera is above the axle."""
    if truth.target is None or learned.target is None:
        return None
    return _wrapped(_sight_rad(truth) - _sight_rad(learned))


def _stands(truth: Truth, learned: Truth) -> bool:
    if truth.target is None or learned.target is None:
        return False
    return math.dist(truth.target[:2], learned.target[:2]) <= STANDS_WITHIN_M


def _in_target(truth: Truth) -> tuple[float, float, float]:
    """The robot in the target's coordinates: x the way one looks at it, y to the left, heading."""
    assert truth.target is not None
    (x, y, heading), (tx, ty, target_heading) = truth.robot, truth.target
    c, s = math.cos(target_heading), math.sin(target_heading)
    return c * (x - tx) + s * (y - ty), c * (y - ty) - s * (x - tx), heading - target_heading


def _sight_rad(truth: Truth) -> float:
    x, y, _ = _in_target(truth)
    return math.atan2(-y, -x)


def _wrapped(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2 * math.pi)
