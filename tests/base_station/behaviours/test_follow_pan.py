"""Follow with a pan-tilt: the camera first, the body after it, a search when the target is lost."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from base_station.behaviours.base import Drive
from base_station.behaviours.follow import Follow
from base_station.behaviours.search import PanSearch, SearchSettings
from base_station.types import TrackerResult, TrackingState
from protocol import STOP, Command, PanTiltLimits, RobotLimits

WHEELS = RobotLimits(speed_scale=4.0)
REACH = PanTiltLimits(pan_rad=(-1.5, 1.5), tilt_rad=(-0.9, 0.9), slew_rad_s=5.0)
PERIOD_S = 1 / 30
LOST = TrackerResult(state=TrackingState.LOST, reason="gone")


@dataclass
class Servo:
    """The camera's head: goes to its goal at the slew rate; `scale` is how much further it turns than it believes."""

    limits: PanTiltLimits = REACH
    scale: float = 1.0
    pan_rad: float = 0.0
    goals: list[float] = field(default_factory=list)

    def look(self, pan_rad: float) -> None:
        self.goals.append(max(self.limits.pan_rad[0], min(self.limits.pan_rad[1], pan_rad)))

    def pass_time(self) -> None:
        reach = self.limits.slew_rad_s * PERIOD_S
        goal = self.goals[-1] if self.goals else 0.0
        self.pan_rad += max(-reach, min(reach, goal - self.pan_rad))

    @property
    def true_pan_rad(self) -> float:
        return self.scale * self.pan_rad


def seen(bearing_rad: float, zoom: float | None = 1.0) -> TrackerResult:
    return TrackerResult(state=TrackingState.TRACKING, bearing_rad=bearing_rad, zoom=zoom, confidence=1.0)


def motion(command: Command) -> tuple[float, float]:
    """Forward speed m/s and rate of turn rad/s (left positive)."""
    left, right = (wheel * WHEELS.metres_per_unit_s * WHEELS.speed_scale for wheel in (command.left, command.right))
    return (left + right) / 2, (right - left) / WHEELS.wheel_base_m


def follower(pan_rad: float = 0.0) -> tuple[Follow, Servo]:
    servo = Servo(pan_rad=pan_rad)
    return Follow(Drive(WHEELS), head=servo), servo


# -- signs -------------------------------------------------------------------------------------------------------------


def test_the_camera_turns_towards_the_target_from_where_it_looked():
    follow, servo = follower(pan_rad=0.3)
    follow.command(seen(0.1), 0.0)
    assert servo.goals == [pytest.approx(0.3 + 0.8 * 0.1)]


@pytest.mark.parametrize(("pan_rad", "bearing_rad"), [(0.1, 0.0), (0.0, 0.1), (0.2, -0.1)])
def test_the_body_turns_by_the_sum_of_pan_and_bearing(pan_rad, bearing_rad):
    follow, _ = follower(pan_rad)
    assert motion(follow.command(seen(bearing_rad), 0.0))[1] == pytest.approx(0.8, rel=0.03)  # 8 per s times 0.1


def test_the_body_stands_when_the_target_is_ahead_of_it_though_the_camera_looks_aside():
    follow, servo = follower(pan_rad=0.2)
    assert follow.command(seen(-0.2, 1 / math.cos(0.2)), 0.0).left == pytest.approx(0, abs=1)
    assert servo.goals[-1] < 0.2


@pytest.mark.parametrize(("pan_rad", "share"), [(0.0, 1.0), (1.0, math.cos(1.0)), (1.5, math.cos(1.5))])
def test_driving_forward_counts_as_far_as_the_body_faces_the_target(pan_rad, share):
    wide = Drive(RobotLimits(speed_scale=40.0, max_units=5000))  # so that turning leaves room for driving
    follow = Follow(wide, head=Servo(pan_rad=pan_rad))
    command = follow.command(seen(0.0, 1 / 1.15), 0.0)
    forward_m_s = (command.left + command.right) / 2 * wide.metres_per_wire_unit_s
    assert forward_m_s == pytest.approx(share * 0.8 * math.log(1.15), abs=0.01)


def test_a_target_behind_the_body_is_turned_to_and_not_driven_to():
    follow, _ = follower(pan_rad=1.5)
    forward_m_s, turn_rad_s = motion(follow.command(seen(0.4, 0.5), 0.0))
    assert turn_rad_s > 2.0 and forward_m_s == pytest.approx(0.0, abs=1e-3)


def test_the_range_is_told_by_zoom_and_the_bearing_in_the_picture():
    """At pan 0.5 and in the middle of the picture, zoom 1 is the learned range: no driving."""
    follow, _ = follower(pan_rad=0.5)
    assert motion(follow.command(seen(0.0, 1.0), 0.0))[0] == pytest.approx(0.0, abs=1e-3)


# -- the closed loop ---------------------------------------------------------------------------------------------------


def run(*, pan: bool, scale: float = 1.0, body_turns: bool = True, sway_deg: float = 0.0, start_deg: float = 0.0):
    """Ten seconds before a target in some direction of the room; its true bearings (degrees) from body and camera."""
    servo = Servo(scale=scale)
    follow = Follow(Drive(WHEELS), head=servo if pan else None)
    heading, waiting, body, camera = 0.0, STOP, [], []
    for frame in range(300):
        time_s = frame * PERIOD_S
        target = math.radians(start_deg + sway_deg * math.sin(2 * math.pi * time_s / 2.0))
        bearing = target - heading
        in_picture = bearing - servo.true_pan_rad
        body.append(math.degrees(bearing))
        camera.append(math.degrees(in_picture))
        waiting, command = follow.command(seen(in_picture, None), time_s), waiting
        heading += motion(command)[1] * PERIOD_S if body_turns else 0.0
        servo.pass_time()
    return np.array(body), np.array(camera)


def test_the_camera_is_there_first_and_the_body_follows_until_the_camera_looks_ahead():
    body, camera = run(pan=True, start_deg=25.0)
    assert abs(camera[4]) < 6 < abs(body[4])
    assert np.abs(body[150:]).max() < 0.5 and np.abs(camera[150:]).max() < 0.5


@pytest.mark.parametrize("scale", [0.7, 1.0, 1.3])
def test_servos_of_a_wrong_scale_converge_too(scale):
    body, camera = run(pan=True, start_deg=25.0, scale=scale)
    assert np.abs(camera[150:]).max() < 0.5 and np.abs(body[150:]).max() < 0.5


def test_a_body_that_is_held_leaves_the_target_to_the_camera():
    """30 degrees to either side every two seconds."""
    _, fixed = run(pan=False, body_turns=False, sway_deg=30.0)
    _, panned = run(pan=True, body_turns=False, sway_deg=30.0)
    assert np.abs(fixed).max() == pytest.approx(30.0, abs=0.1)
    assert np.abs(panned).max() < 7.0


def test_the_target_stays_nearer_to_the_middle_than_without_the_pan():
    _, fixed = run(pan=False, sway_deg=20.0)
    _, panned = run(pan=True, sway_deg=20.0)
    assert np.sqrt(np.mean(panned[30:] ** 2)) < 0.8 * np.sqrt(np.mean(fixed[30:] ** 2))


# -- searching ---------------------------------------------------------------------------------------------------------


def test_a_lost_target_is_waited_for_then_looked_for_to_both_sides_then_the_camera_is_centred():
    follow, servo = follower()
    follow.command(seen(0.2), 0.0)
    goals = []
    for frame in range(1, 600):
        assert follow.command(LOST, frame * PERIOD_S) == STOP
        goals.append(servo.goals[-1])
    steps = np.abs(np.diff(goals))
    assert goals[:29] == [pytest.approx(0.16)] * 29
    assert steps.max() <= SearchSettings().rate_rad_s * PERIOD_S + 1e-9
    assert max(goals) == pytest.approx(math.radians(70), abs=0.02)
    assert min(goals) == pytest.approx(-math.radians(70), abs=0.02)
    assert int(np.argmax(goals)) < int(np.argmin(goals))  # it was lost on the left
    assert goals[-60:] == [0.0] * 60


def test_it_looks_first_where_the_target_went_out_of_the_picture():
    follow, servo = follower()
    follow.command(seen(-0.2), 0.0)
    follow.command(LOST, 0.1)
    follow.command(LOST, 2.5)
    assert servo.goals[-1] < -0.16


def test_found_again_it_follows_and_a_second_loss_begins_anew():
    follow, servo = follower()
    follow.command(seen(0.0), 0.0)
    for time_s in (0.1, 3.0):
        follow.command(LOST, time_s)
    assert servo.goals[-1] > 0.5
    servo.pan_rad = servo.goals[-1]
    assert follow.command(seen(0.0), 3.1).left < 0
    follow.command(LOST, 3.2)
    assert servo.goals[-1] == pytest.approx(servo.pan_rad)


def test_before_anything_was_seen_the_camera_is_left_alone():
    follow, servo = follower()
    assert follow.command(None, 0.0) == follow.command(LOST, 5.0) == STOP
    assert servo.goals == []


def test_the_search_keeps_within_the_limits():
    narrow = PanTiltLimits(pan_rad=(-0.4, 0.2), tilt_rad=(0.0, 0.0), slew_rad_s=1.0)
    search = PanSearch(narrow, begin_rad=0.1, left_first=False)
    pans = [search.pan_rad(second / 10) for second in range(200)]
    assert (min(pans), max(pans)) == (pytest.approx(-0.4, abs=0.05), pytest.approx(0.2, abs=0.05))
    assert pans[0] == 0.1 and pans[-1] == 0.0
