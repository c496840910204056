"""The actors' motions keep what they promise, for every seed that is tried."""

import itertools
import math

import numpy as np
import pytest

from robot_agent.sim import courses
from robot_agent.sim.poses import Pose

SEEDS = range(10)
DISTANCE_M, BEHIND_M = 0.40, 0.036


def circle(radius_m: float) -> courses.ClosedCourse:
    angle = np.linspace(0.0, 2.0 * np.pi, 2001)
    return courses.ClosedCourse(radius_m * np.cos(angle), radius_m * np.sin(angle))


def course(seed: int) -> courses.ClosedCourse:
    return courses.draw_course(np.random.default_rng(seed), distance_m=DISTANCE_M, picture_behind_m=BEHIND_M)


def test_a_circle_has_the_radius_and_length_of_a_circle():
    loop = circle(0.9)
    assert loop.min_radius_m == pytest.approx(0.9, rel=1e-3)
    assert loop.length_m == pytest.approx(2.0 * math.pi * 0.9, rel=1e-4)
    assert loop.turns_left


def test_on_a_circle_the_pursuer_sees_the_picture_at_the_tractrix_angle():
    pursuit = courses.pursue(circle(1.0), distance_m=0.4, picture_behind_m=0.0)
    assert pursuit.max_facing_rad == pytest.approx(math.asin(0.4), abs=math.radians(0.4))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_drawn_course_can_be_followed_and_keeps_off_the_walls(seed):
    loop = course(seed)
    points = [loop.at(s) for s in np.arange(0.0, loop.length_m, 0.02)]
    heading = np.unwrap([pose.heading_rad for pose in points])
    assert np.abs(np.diff(heading)).max() / 0.02 < 1.0 / 0.74, "curvature, by differences"
    assert max(max(abs(pose.x_m), abs(pose.y_m)) for pose in points) <= 3.0 - 0.8
    pursuit = courses.pursue(loop, distance_m=DISTANCE_M, picture_behind_m=BEHIND_M)
    assert math.radians(10.0) < pursuit.max_facing_rad <= math.radians(33.0)
    assert pursuit.extent_m <= 3.0 - 0.8


@pytest.mark.parametrize("seed", SEEDS)
def test_a_course_closes_without_a_jump_in_place_or_direction(seed):
    loop = course(seed)
    before, after = loop.at(loop.length_m - 1e-4), loop.at(loop.length_m + 1e-4)
    assert math.hypot(after.x_m - before.x_m, after.y_m - before.y_m) == pytest.approx(2e-4, rel=0.01)
    assert abs(math.remainder(after.heading_rad - before.heading_rad, 2.0 * math.pi)) < 1e-3


def test_a_course_heads_where_it_goes():
    loop = course(3)
    for s in np.linspace(0.0, loop.length_m, 50):
        here, there = loop.at(s - 0.005), loop.at(s + 0.005)
        direction = math.atan2(there.y_m - here.y_m, there.x_m - here.x_m)
        assert math.remainder(direction - loop.at(s).heading_rad, 2.0 * math.pi) == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_leader_stands_for_a_second_then_drives_at_most_8_cm_a_second(seed):
    pace = courses.draw_pace(np.random.default_rng(seed))
    times = np.arange(0.0, 90.0, 0.01)
    speed = np.diff([pace.distance_m(t) for t in times]) / 0.01
    assert np.all(speed[times[:-1] < 0.99] == 0.0)
    assert speed.min() >= 0.0 and 0.06 < speed.max() <= 0.08 + 1e-9
    assert speed[times[:-1] > 4.0].min() > 0.03
    assert np.abs(np.diff(speed)).max() < 0.08 * 0.01, "it speeds up gently"


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_dash_turns_round_to_its_side_without_a_jump(side):
    dash, begin = courses.Dash(side=side), Pose(x_m=0.2, y_m=-0.3, heading_rad=0.5)
    way = [dash.pose(begin, t) for t in np.arange(0.0, 8.0, 0.01)]
    steps = [math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in itertools.pairwise(way)]
    assert way[0] == begin
    assert max(steps) == pytest.approx(0.40 * 0.01, rel=0.01)
    assert sum(steps) == pytest.approx(dash.length_m, rel=1e-3)
    assert way[-1].heading_rad - begin.heading_rad == pytest.approx(side * math.pi)
    expected = begin.moved(ahead_m=dash.straight_m - dash.back_m, left_m=side * 2.0 * dash.radius_m)
    assert (way[-1].x_m, way[-1].y_m) == pytest.approx((expected.x_m, expected.y_m), abs=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_turntable_swings_within_25_degrees_and_30_degrees_a_second_then_turns_once(seed):
    table = courses.draw_turntable(np.random.default_rng(seed))
    times = np.arange(0.0, 60.0, 0.01)
    angle = np.degrees([table.angle_rad(t) for t in times])
    swings = angle[times <= courses.SWINGS_END_S]
    assert angle[0] == 0.0
    assert 15.0 < np.abs(swings).max() <= 25.0
    assert np.abs(np.diff(swings)).max() / 0.01 > 10.0
    assert np.abs(np.diff(angle)).max() / 0.01 == pytest.approx(30.0, abs=0.01)
    assert abs(angle[-1]) == pytest.approx(360.0)
    assert np.all(np.abs(np.diff(angle[times > 34.0])) < 1e-9)


def test_the_light_falls_to_a_third_by_steps_and_by_ramps_every_20_seconds():
    times = np.arange(0.0, 65.0, 0.01)
    light = np.array([courses.changing_light(t) for t in times])
    assert np.all(light[times < 4.99] == 1.0)
    assert light.min() == pytest.approx(1.0 / 3.0, abs=1e-3) and light.max() == 1.0
    assert np.allclose(light[(times >= 5.01) & (times < 24.99)], light[(times >= 25.01) & (times < 44.99)], atol=2e-3)
    change = np.abs(np.diff(light))
    assert (change > 0.1).any() and ((change > 1e-4) & (change < 0.01)).sum() > 500
