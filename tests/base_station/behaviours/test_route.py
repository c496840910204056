"""Laps by odometry: the course, the steering on an ideal robot, and when it stands; wheel odometry itself."""

from __future__ import annotations

import math

import pytest

from base_station.behaviours.base import Drive
from base_station.behaviours.route import Course, Route, RouteSettings
from base_station.geometry import FlatPose
from base_station.odometry import WheelOdometry, rolled
from base_station.types import TrackerResult, TrackingState
from protocol import STOP, FrameStamp, RobotLimits, Telemetry

LIMITS = RobotLimits(speed_scale=4.0)
LOST = TrackerResult(state=TrackingState.LOST, reason="out of sight")
OVAL = [(1.1 * math.sin(a), 0.8 * (1 - math.cos(a))) for a in (k * math.tau / 60 for k in range(60))]
"""Begins at the origin along x, to the left."""


class Ideal:
    """A robot whose wheels turn as they are told; counts time in frames of 1/15 s."""

    def __init__(self, course: list[tuple[float, float]], settings: RouteSettings | None = None) -> None:
        self.pose: FlatPose | None = FlatPose(x_m=0.0, y_m=0.0, heading_rad=0.0)
        self.route = Route(Drive(LIMITS), course, lambda: self.pose, settings)
        self.way: list[FlatPose] = []

    def drive(self, frames: int) -> None:
        metres = Drive(LIMITS).metres_per_wire_unit_s / 15
        for _ in range(frames):
            command = self.route.command(LOST, len(self.way) / 15)
            self.pose = rolled(self.pose, command.left * metres, command.right * metres, LIMITS.wheel_base_m)
            self.way.append(self.pose)
            if self.route.outcome is not None:
                return


def test_it_drives_its_laps_along_the_course_and_stands():
    robot = Ideal(OVAL, RouteSettings(laps=2))
    robot.drive(3000)
    assert robot.route.outcome.there and robot.route.laps == 2
    course = Course(OVAL)
    off = [min(math.dist(course.at(k / 50), (p.x_m, p.y_m)) for k in range(310)) for p in robot.way[::5]]
    assert max(off) < 0.06
    driven = [math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) for a, b in zip(robot.way, robot.way[1:], strict=False)]
    assert sum(driven) == pytest.approx(2 * course.length_m, rel=0.05)
    assert max(driven) * 15 <= 0.125 and robot.way[-1].heading_rad == pytest.approx(4 * math.pi, abs=0.3)
    assert robot.route.command(LOST, 1e3) == STOP


def test_narrow_bends_are_driven_slowly_and_a_goal_behind_is_turned_to():
    robot = Ideal([(0.0, 0.0), (0.5, 0.0), (0.5, 0.5), (0.0, 0.5)], RouteSettings(laps=1, turn_limit_rad_s=0.3))
    robot.drive(3000)
    assert robot.route.outcome.there
    turns = [abs(a.heading_rad - b.heading_rad) * 15 for a, b in zip(robot.way, robot.way[1:], strict=False)]
    assert 0.2 < max(turns) < 0.33
    robot = Ideal([(0.0, 0.0), (-1.0, 0.0), (-1.0, 1.0)])
    command = robot.route.command(LOST, 0.0)
    assert command.left == -command.right != 0


def test_it_stands_where_nothing_is_known_and_when_it_was_carried_off():
    robot = Ideal(OVAL)
    robot.pose = None
    assert robot.route.command(LOST, 0.0) == STOP and robot.route.outcome is None
    robot.pose = FlatPose(x_m=0.0, y_m=-3.0, heading_rad=0.0)
    assert robot.route.command(LOST, 3.0) == STOP
    assert not robot.route.outcome.there and "off the course" in robot.route.outcome.text
    assert Ideal(OVAL).route.command(None, 0.0) == STOP


@pytest.mark.parametrize("waypoints", [[], [(0.0, 0.0), (1.0, 0.0)], [(0.0, 0.0), (0.0, 0.0), (1.0, 1.0)]])
def test_a_course_that_is_none_is_refused(waypoints):
    with pytest.raises(ValueError, match="three waypoints"):
        Ideal(waypoints)


def told(number: int, time_s: float, wheels: tuple[int, int] | None) -> Telemetry:
    stamp = FrameStamp(connection=1, number=number, capture_s=time_s, dropped=0)
    return Telemetry(
        sequence=number, monotonic_s=time_s, wall_s=0.0, frame=stamp, station="here", wheels_measured=wheels
    )


def test_odometry_rolls_a_circle_of_the_wheels_radius():
    odometry = WheelOdometry()
    assert odometry.of(("here", 1)) is None
    odometry.note(told(0, 0.0, None), LIMITS)
    assert odometry.of(("here", 1)) is None
    for k in range(201):
        odometry.note(told(k + 1, k / 10, (200, 300)), LIMITS)
    pose = odometry.of(("here", 201))
    turned = 100 * LIMITS.metres_per_unit_s / LIMITS.wheel_base_m * 20
    radius = 250 * LIMITS.metres_per_unit_s * 20 / turned
    assert pose.heading_rad == pytest.approx(turned)
    assert (pose.x_m, pose.y_m) == pytest.approx((radius * math.sin(turned), radius * (1 - math.cos(turned))))
    assert odometry.of(("here", 1)) == FlatPose(x_m=0.0, y_m=0.0, heading_rad=0.0)
    odometry.note(told(202, 100.0, (200, 300)), LIMITS)  # too long ago to know
    assert odometry.of(("here", 202)) == pose
