"""Errors in the target's own coordinates, on poses whose answers are known."""

from __future__ import annotations

import math

import pytest

from base_station.evaluation import pose_errors
from protocol import Truth


def truth(ahead_m: float, left_m: float, heading_deg: float, *, target=(1.0, 2.0, 0.7)) -> Truth:
    """The robot so far ahead and to the left of the target, as one looks at it, and turned to the left."""
    x, y, heading = target
    c, s = math.cos(heading), math.sin(heading)
    robot = (x + c * ahead_m - s * left_m, y + s * ahead_m + c * left_m, heading + math.radians(heading_deg))
    return Truth(robot=robot, target=target)


LEARNED = truth(-0.5, 0.0, 0.0)


def test_lateral_and_heading_errors_are_those_of_the_targets_frame():
    now = truth(-0.45, 0.03, -2.0)
    assert pose_errors.lateral_error_m(now, LEARNED) == pytest.approx(0.03)
    assert math.degrees(pose_errors.heading_error_rad(now, LEARNED)) == pytest.approx(-2)


@pytest.mark.parametrize("arc_deg", [-30, 5, 60])
def test_the_view_angle_is_positive_to_the_right_of_where_it_was_learned(arc_deg):
    arc = math.radians(arc_deg)
    now = truth(-math.cos(arc), -math.sin(arc), 123.0)
    assert math.degrees(pose_errors.view_angle_rad(now, LEARNED)) == pytest.approx(arc_deg)


def test_a_target_that_moved_or_is_none_has_no_place_to_come_back_to():
    moved = truth(-0.5, 0.0, 0.0, target=(1.1, 2.0, 0.7))
    assert pose_errors.lateral_error_m(moved, LEARNED) is None
    assert pose_errors.heading_error_rad(moved, LEARNED) is None
    nothing = Truth(robot=(0.0, 0.0, 0.0))
    assert pose_errors.view_angle_rad(nothing, LEARNED) is None
    assert pose_errors.lateral_error_m(nothing, nothing) is None
