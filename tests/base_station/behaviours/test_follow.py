"""Follow: which way it drives, that it converges behind a moving leader, and when it stands."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from base_station.behaviours.base import Drive
from base_station.behaviours.follow import Follow, FollowSettings, log_range_error
from base_station.types import TrackerResult, TrackingState
from protocol import STOP, Command, RobotLimits

LIMITS = RobotLimits(speed_scale=4.0)
DRIVE = Drive(LIMITS)
PERIOD_S = 1 / 30
ZERO = {"bearing_rad": 0.0, "zoom": 1.0}


def seen(bearing_rad: float | None = 0.0, zoom: float | None = 1.0) -> TrackerResult:
    return TrackerResult(state=TrackingState.TRACKING, bearing_rad=bearing_rad, zoom=zoom, confidence=1.0)


def first(bearing_rad: float = 0.0, zoom: float | None = 1.0) -> Command:
    return Follow(DRIVE).command(seen(bearing_rad, zoom), 0.0)


def motion(command: Command) -> tuple[float, float]:
    """Forward speed m/s and rate of turn rad/s (left positive) of these wheels."""
    left, right = (wheel * LIMITS.metres_per_unit_s * LIMITS.speed_scale for wheel in (command.left, command.right))
    return (left + right) / 2, (right - left) / LIMITS.wheel_base_m


# -- signs -------------------------------------------------------------------------------------------------------------


def test_at_the_learned_place_it_stands():
    assert first() == STOP


def test_it_turns_towards_the_target():
    left, right = first(bearing_rad=0.1), first(bearing_rad=-0.1)
    assert left.left < 0 < left.right
    assert (right.left, right.right) == (left.right, left.left)
    assert motion(left)[1] == pytest.approx(0.8, rel=0.03)  # 8 per second times 0.1 rad


def test_it_goes_towards_a_target_that_is_too_far_and_backs_off_from_one_too_near():
    far, near = first(zoom=1 / 1.05), first(zoom=1.05)
    assert far.left == far.right > 0 > near.left == near.right
    assert motion(far)[0] == pytest.approx(0.8 * math.log(1.05), rel=0.03)


def test_without_zoom_it_only_turns():
    command = first(bearing_rad=0.2, zoom=None)
    assert command.left == -command.right < 0


@pytest.mark.parametrize(("bearing_rad", "range_ratio"), [(0.0, 2.0), (0.4, 1.0), (-0.4, 1.0), (0.3, 0.5)])
def test_the_range_error_is_that_of_the_range_not_of_the_depth(bearing_rad, range_ratio):
    depth_ratio = range_ratio * math.cos(bearing_rad)
    assert log_range_error(1 / depth_ratio, bearing_rad) == pytest.approx(math.log(range_ratio), abs=1e-12)


# -- standing ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "result",
    [
        None,
        TrackerResult(state=TrackingState.LOST, reason="out of sight"),
        TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned"),
        TrackerResult(state=TrackingState.TRACKING, zoom=0.5),
    ],
    ids=["nothing learned", "LOST", "INITIALIZING", "no bearing"],
)
def test_what_it_does_not_see_it_does_not_drive_by(result):
    follow = Follow(DRIVE)
    assert follow.command(seen(0.1, 0.9), 0.0) != STOP
    assert follow.command(result, PERIOD_S) == STOP


def test_after_a_loss_it_goes_on_without_a_jump():
    """Ten seconds without the target count as the longest gap, not as ten seconds of error."""
    commands = []
    for gap_s in (10.0, FollowSettings().longest_gap_s):
        follow = Follow(DRIVE)
        follow.command(seen(0.05, 0.95), 0.0)
        commands.append(follow.command(seen(0.05, 0.95), gap_s))
    assert commands[0] == commands[1]


def test_a_time_that_steps_back_integrates_nothing():
    back, still = Follow(DRIVE), Follow(DRIVE)
    for follow, second_s in ((back, -5.0), (still, 0.0)):
        follow.command(seen(0.05, 0.95), 0.0)
        follow.command(seen(0.05, 0.95), second_s)
    assert back.command(seen(0.0, 1.0), 0.0) == still.command(seen(0.0, 1.0), 0.0) == STOP


# -- limits ------------------------------------------------------------------------------------------------------------


def test_where_turning_and_driving_do_not_both_fit_turning_goes_first():
    forward_m_s, turn_rad_s = motion(first(bearing_rad=0.3, zoom=0.3))
    assert turn_rad_s == pytest.approx(2.4, rel=0.02)
    assert forward_m_s == pytest.approx(DRIVE.fastest_m_s - 2.4 * LIMITS.wheel_base_m / 2, rel=0.05)
    alone_m_s, _ = motion(first(zoom=0.3))
    assert alone_m_s == pytest.approx(0.16, rel=0.02)
    assert forward_m_s < 0.4 * alone_m_s


def test_a_turn_beyond_all_limits_uses_the_wheels_up_and_leaves_nothing_for_driving():
    command = DRIVE.command(1.0, 100.0)
    assert command.left == -command.right < 0
    assert motion(command)[1] == pytest.approx(2 * DRIVE.fastest_m_s / LIMITS.wheel_base_m, rel=0.01)


def test_the_rate_of_turn_is_limited():
    assert motion(first(bearing_rad=1.0, zoom=None))[1] == pytest.approx(2.5, rel=0.02)
    assert motion(first(bearing_rad=-1.0, zoom=None))[1] == pytest.approx(-2.5, rel=0.02)


def test_the_fastest_speed_is_the_robot_s_or_what_a_byte_can_say():
    assert Drive(RobotLimits(speed_scale=1.0)).fastest_m_s == pytest.approx(127 * 0.000325)
    assert Drive(RobotLimits(speed_scale=4.0)).fastest_m_s == pytest.approx(500 * 0.000325)


@pytest.mark.parametrize("scale", [1.0, 2.0, 4.0])
def test_the_same_motion_is_asked_of_a_robot_of_any_scale(scale):
    drive = Drive(RobotLimits(speed_scale=scale))
    command = drive.command(0.02, 0.3)
    unit_m_s = scale * 0.000325
    assert (command.left + command.right) / 2 * unit_m_s == pytest.approx(0.02, abs=unit_m_s)
    assert (command.right - command.left) * unit_m_s / 0.094 == pytest.approx(0.3, abs=unit_m_s / 0.094)


# -- integral ----------------------------------------------------------------------------------------------------------


def fed(follow: Follow, frames: int, result: TrackerResult) -> Command:
    """The command after `frames` more frames that all look like this."""
    command = STOP
    for _ in range(frames):
        fed.time_s += PERIOD_S
        command = follow.command(result, fed.time_s)
    return command


fed.time_s = 0.0


def test_a_constant_error_is_integrated():
    follow = Follow(DRIVE)
    once = motion(fed(follow, 1, seen(0.01, 0.99)))
    later = motion(fed(follow, 30, seen(0.01, 0.99)))
    assert later[0] > 1.5 * once[0] > 0  # integrated with a time constant of 1 s: twice as much after one
    assert later[1] > 3 * once[1] > 0  # 1/3 s: four times


def test_a_long_way_to_go_winds_nothing_up():
    follow = Follow(DRIVE)
    fed(follow, 900, seen(0.5, 0.25))
    assert fed(follow, 1, seen(0.0, 1.0)) == STOP


def test_what_the_wheels_cannot_do_is_not_integrated():
    """A small error for a minute: the sum of both parts stops at the limit, 0.1 is left in the integral."""
    follow = Follow(DRIVE)
    fed(follow, 1800, seen(0.0, math.exp(-0.1)))
    forward_m_s, turn_rad_s = motion(fed(follow, 1, seen(0.0, 1.0)))
    assert forward_m_s == pytest.approx(0.16 - 0.8 * 0.1, rel=0.05)
    assert turn_rad_s == 0.0


# -- the closed loop ---------------------------------------------------------------------------------------------------


@dataclass
class Run:
    """A kinematic run: per frame the true bearing in degrees, the range relative to the learned one, the path."""

    bearing_deg: np.ndarray
    range_ratio: np.ndarray
    positions: np.ndarray

    def after(self, seconds: float) -> Run:
        start = round(seconds / PERIOD_S)
        return Run(self.bearing_deg[start:], self.range_ratio[start:], self.positions[start:])


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def run(
    target: Callable[[float], tuple[float, float]],
    *,
    learned_m: float,
    heading_rad: float = 0.0,
    seconds: float = 30.0,
    latency_frames: int = 1,
    follow_settings: FollowSettings | None = None,
    gives_zoom: bool = True,
    slip: tuple[float, float] = (1.0, 1.0),
) -> Run:
    """A robot with ideal wheels starts at the origin and sees a point; a command acts `latency_frames` later."""
    follow = Follow(DRIVE, follow_settings)
    x, y, heading = 0.0, 0.0, heading_rad
    waiting = [STOP] * latency_frames
    bearings, ratios, positions = [], [], []
    for frame in range(round(seconds / PERIOD_S)):
        time_s = frame * PERIOD_S
        target_x, target_y = target(time_s)
        distance_m = math.hypot(target_x - x, target_y - y)
        bearing_rad = math.remainder(math.atan2(target_y - y, target_x - x) - heading, 2 * math.pi)
        bearings.append(math.degrees(bearing_rad))
        ratios.append(distance_m / learned_m)
        positions.append((x, y))
        zoom = learned_m / (distance_m * math.cos(bearing_rad)) if gives_zoom else None
        waiting.append(follow.command(seen(bearing_rad, zoom), time_s))
        command = waiting.pop(0)
        forward_m_s, turn_rad_s = motion(Command(round(command.left * slip[0]), round(command.right * slip[1])))
        heading += turn_rad_s * PERIOD_S
        x += forward_m_s * math.cos(heading) * PERIOD_S
        y += forward_m_s * math.sin(heading) * PERIOD_S
    return Run(np.array(bearings), np.array(ratios), np.array(positions))


def on_a_circle(time_s: float) -> tuple[float, float]:
    """From 0.4 m ahead, at 6 cm/s to the left round a circle of 0.6 m."""
    angle = 0.06 / 0.6 * time_s
    return 0.4 + 0.6 * math.sin(angle), 0.6 - 0.6 * math.cos(angle)


def straight_ahead(time_s: float) -> tuple[float, float]:
    return 0.4 + 0.08 * time_s, 0.0


def weaving(time_s: float) -> tuple[float, float]:
    """Ahead at 5 cm/s, 10 cm to either side every 12 s."""
    return 0.4 + 0.05 * time_s, 0.1 * math.sin(2 * math.pi * time_s / 12)


def test_behind_a_leader_on_a_circle_bearing_and_range_stay_within_the_figures_to_reach():
    end = run(on_a_circle, learned_m=0.4, seconds=60).after(10)
    assert rms(end.bearing_deg) < 0.1
    assert rms(end.range_ratio - 1) < 0.005
    inner_m = math.sqrt(0.6**2 - 0.4**2)  # a hunter who looks at its prey runs round a smaller circle
    path_m = np.hypot(*np.diff(end.positions, axis=0).T).sum()
    assert path_m == pytest.approx(50 * 0.06 * inner_m / 0.6, rel=0.05)


@pytest.mark.parametrize("latency_frames", [0, 1, 2])
def test_behind_a_weaving_leader_it_holds_up_to_two_frames_of_latency(latency_frames):
    end = run(weaving, learned_m=0.4, seconds=60, latency_frames=latency_frames).after(10)
    assert 0.02 < rms(end.bearing_deg) < 0.2  # small, but a turn to come cannot be foreseen
    assert rms(end.range_ratio - 1) < 0.01
    assert abs(float(np.mean(end.bearing_deg))) < 0.02


def test_a_leader_that_drives_straight_on_is_caught_up_with_and_without_the_integral_is_not():
    end = run(straight_ahead, learned_m=0.4, seconds=30).after(20)
    assert rms(end.range_ratio - 1) < 0.002
    proportional = dataclasses.replace(FollowSettings(), forward_integral_per_s=0.0, turn_integral_per_s=0.0)
    behind = run(straight_ahead, learned_m=0.4, seconds=30, follow_settings=proportional).after(20)
    assert float(np.mean(behind.range_ratio - 1)) == pytest.approx(math.exp(0.1) - 1, rel=0.05)  # 8 cm/s over 0.8


def test_from_twice_the_distance_and_turned_away_it_comes_to_the_goal_within_ten_seconds_and_stays():
    """The scenario `poster`: 1 m away, turned by 20 degrees, learned at 0.5 m."""
    whole = run(lambda time_s: (1.0, 0.0), learned_m=0.5, heading_rad=math.radians(20), seconds=20)
    assert whole.range_ratio[0] == pytest.approx(2.0)
    assert whole.bearing_deg[0] == pytest.approx(-20.0)
    end = whole.after(10)
    assert np.abs(end.range_ratio - 1).max() * 0.5 < 0.01
    assert np.abs(end.bearing_deg).max() < 0.5
    assert 0.96 < whole.range_ratio.min() < 0.99  # some cm beyond the goal first, as the integral has it


def test_too_near_it_backs_off():
    whole = run(lambda time_s: (0.25, 0.0), learned_m=0.5, seconds=15)
    assert whole.positions[-1][0] == pytest.approx(-0.25, abs=0.01)


def test_slipping_wheels_are_made_up_for():
    end = run(on_a_circle, learned_m=0.4, seconds=60, slip=(0.8, 0.95)).after(10)
    assert rms(end.bearing_deg) < 0.1
    assert rms(end.range_ratio - 1) < 0.005


def test_without_zoom_it_keeps_the_target_ahead_and_stays_where_it_is():
    end = run(lambda time_s: (0.5, 0.02 * time_s), learned_m=0.5, seconds=20, gives_zoom=False)
    assert rms(end.after(5).bearing_deg) < 0.5
    assert np.abs(end.positions).max() == 0.0


def test_the_same_frames_give_the_same_drive():
    once, again = (run(weaving, learned_m=0.4, seconds=5) for _ in range(2))
    assert np.array_equal(once.positions, again.positions)
