"""The simulated robot moves, senses and reports as the real one would; the scenarios are what they say."""

import importlib
import math

import numpy as np
import pytest

from robot_agent.errors import AgentError, CameraError
from robot_agent.robots.sim import SimRobot
from robot_agent.sim import engine, thymio
from robot_agent.sim.faults import Faults
from robot_agent.sim.scenarios import SCENARIOS, build_stage
from robot_agent.sim.world import World

SMALL = {"width": 160, "height": 120}


def world(scenario: str = "plain", seed: int = 0, **options) -> World:
    return World(scenario=scenario, seed=seed, **(SMALL | options))


def robot(simulated: World) -> tuple[float, float, float]:
    return simulated.capture().truth.robot


def travelled(before: tuple[float, float, float], after: tuple[float, float, float]) -> float:
    """Metres along the heading at the start, positive forwards."""
    dx, dy = after[0] - before[0], after[1] - before[1]
    return dx * math.cos(before[2]) + dy * math.sin(before[2])


def turned(simulated: World, seconds: float) -> float:
    """Rotation in `seconds`, revolutions counted."""
    total, before = 0.0, robot(simulated)[2]
    for _ in range(round(seconds / 0.5)):
        simulated.advance(0.5)
        after = robot(simulated)[2]
        total += math.remainder(after - before, 2.0 * math.pi)
        before = after
    return total


def test_200_units_for_10_seconds_are_65_cm_back_and_forth():
    simulated = world()
    start = robot(simulated)
    simulated.set_wheels(-200, -200)
    simulated.advance(10.0)
    back = robot(simulated)
    simulated.set_wheels(200, 200)
    simulated.advance(10.0)
    assert travelled(start, back) == pytest.approx(-0.65, rel=0.01)
    assert travelled(back, robot(simulated)) == pytest.approx(0.65, rel=0.015)
    assert robot(simulated)[2] == pytest.approx(start[2], abs=math.radians(0.1))


@pytest.mark.parametrize("sign", [1, -1])
def test_opposite_wheels_turn_it_on_the_spot_at_the_rate_of_its_base(sign):
    simulated = world()
    start = robot(simulated)
    simulated.set_wheels(-100 * sign, 100 * sign)
    simulated.advance(0.5)
    assert turned(simulated, 8.0) / 8.0 == pytest.approx(sign * 2 * 0.0325 / 0.094, rel=0.02)
    end = robot(simulated)
    assert math.hypot(end[0] - start[0], end[1] - start[1]) < 0.002


def test_without_a_command_it_stays_where_it_is():
    simulated = world()
    start = robot(simulated)
    simulated.advance(20.0)
    assert robot(simulated) == pytest.approx(start, abs=1e-5)


def test_the_robot_gathers_speed_with_a_time_constant_of_50_ms_and_as_fast_as_its_wheels():
    simulated = world()
    start = robot(simulated)
    simulated.set_wheels(-500, -500)
    wheels_m = 0.0
    for _ in range(80):
        simulated.advance(0.0025)
        wheels_m += simulated.state().wheels_measured[0] * 0.000325 * 0.0025
    lag_s = 0.2 + travelled(start, robot(simulated)) / 0.1625
    assert lag_s == pytest.approx(0.055, abs=0.006), "ground lost against an immediate start"
    assert travelled(start, robot(simulated)) == pytest.approx(wheels_m, abs=0.0006)


def test_wheel_commands_are_clamped_at_500():
    simulated = world()
    simulated.set_wheels(-9000, 9000)
    simulated.advance(1.0)
    assert simulated.state().wheels_measured == pytest.approx((-500, 500), abs=8)


def test_proximity_grows_monotonically_to_4500_and_a_crash_counts_once():
    simulated = world("poster")
    simulated.start()
    simulated.advance(2.1)
    turn = simulated.capture().truth.bearing_rad
    simulated.set_wheels(*((-30, 30) if turn > 0 else (30, -30)))
    simulated.advance(abs(turn) / (2 * 30 * 0.000325 / 0.094))
    simulated.set_wheels(400, 400)
    middle = []
    for _ in range(80):
        simulated.advance(0.1)
        middle.append(simulated.state().proximity[2])
    assert middle[0] == 0 and middle == sorted(middle)
    assert middle[-1] == pytest.approx(thymio.CONTACT_VALUE, rel=0.02)
    front, rear = simulated.state().proximity[:5], simulated.state().proximity[5:]
    assert front[0] > 3000 and front[4] > 3000 and rear == (0, 0)
    assert simulated.capture().truth.collisions == 1
    simulated.set_wheels(-400, -400)
    simulated.advance(1.5)
    assert simulated.state().proximity == (0,) * 7
    assert simulated.capture().truth.collisions == 1


def test_the_proximity_curve_falls_from_contact_to_nothing_at_12_cm():
    values = [thymio.proximity_value(d) for d in np.arange(0.0, 0.2, 0.005)]
    assert values[0] == 4500 and values == sorted(values, reverse=True)
    assert thymio.proximity_value(0.119) > 0 and thymio.proximity_value(0.12) == 0
    assert thymio.proximity_value(math.inf) == 0


def test_the_side_sensors_look_to_their_sides():
    directions = [math.degrees(angle) for _, _, angle in thymio.sensors()]
    assert directions == pytest.approx([40, 20, 0, -20, -40, 180, 180])
    sides = [y for _, y, _ in thymio.sensors()]
    assert sides[0] > sides[1] > 0.0 > sides[3] > sides[4] and sides[5] > 0.0 > sides[6]


def test_time_counts_whole_steps_and_nothing_is_lost_between_calls():
    simulated = world()
    for _ in range(1000):
        simulated.advance(0.0013)
    assert simulated.time_s == pytest.approx(1.3, abs=0.002)
    simulated.advance_to(1.0)
    assert simulated.time_s == pytest.approx(1.3, abs=0.002), "time does not run back"


@pytest.mark.parametrize("scenario", ["leader", "lights", "clutter", "plain"])
def test_the_leader_waits_for_the_start_and_stands_40_cm_ahead(scenario):
    simulated = world(scenario)
    simulated.advance(5.0)
    before = simulated.capture().truth
    assert before.range_m == pytest.approx(0.40, abs=0.001)
    assert before.bearing_rad == pytest.approx(0.0, abs=math.radians(0.05))
    assert before.in_view and before.collisions == 0
    simulated.start()
    simulated.advance(6.0)
    assert simulated.capture().truth.range_m > 0.5


@pytest.mark.parametrize("seed", range(2))
def test_the_poster_robot_is_held_at_the_goal_then_set_down_a_metre_off_and_turned(seed):
    simulated = world("poster", seed)
    simulated.start()
    simulated.set_wheels(500, 300)
    simulated.advance(1.9)
    held = simulated.capture().truth
    assert held.range_m == pytest.approx(0.50, abs=0.002)
    assert held.bearing_rad == pytest.approx(0.0, abs=math.radians(0.02))
    assert simulated.state().wheels_measured == (0, 0)
    simulated.set_wheels(0, 0)
    simulated.advance(0.2)
    free = simulated.capture().truth
    assert free.range_m == pytest.approx(1.0, abs=0.002)
    assert abs(free.bearing_rad) == pytest.approx(math.radians(20.0), abs=math.radians(0.1))
    assert free.in_view and free.collisions == 0
    normal = math.atan2(free.target[1] - free.robot[1], free.target[0] - free.robot[0])
    assert normal == pytest.approx(free.target[2], abs=1e-3), "on the picture's normal"
    simulated.set_wheels(-300, -300)
    simulated.advance(1.0)
    assert simulated.capture().truth.range_m > 1.05


def test_the_poster_robot_is_turned_to_either_side():
    stages = [build_stage("poster", seed) for seed in range(8)]
    turns = {round(math.degrees(stage.set_down.heading_rad)) for stage in stages}
    assert turns == {-20, 20}


def chase(simulated: World, seconds: float) -> list:
    """Follow the true picture at 40 cm as fast as the wire allows; the truths of every tenth of a second."""
    truths = []
    for _ in range(round(seconds * 10)):
        truth = simulated.capture().truth
        truths.append(truth)
        forward, turn = 0.06 + 1.5 * (truth.range_m - 0.40), 3.0 * truth.bearing_rad
        wheels = np.array((forward - turn * 0.047, forward + turn * 0.047)) / 0.000325
        simulated.set_wheels(*(int(units) for units in np.clip(wheels, -500, 500)))
        simulated.advance(0.1)
    return truths


@pytest.mark.parametrize("seed", [0, 1])
def test_in_plain_the_leader_escapes_whoever_follows(seed):
    simulated = world("plain", seed)
    simulated.start()
    truths = chase(simulated, 28.0)
    assert all(truth.in_view for truth in truths[:200])
    assert not any(truth.in_view for truth in truths[230:])
    assert truths[-1].collisions == 0


def test_in_leader_a_follower_keeps_the_whole_picture_in_view():
    simulated = world("leader", 5)
    simulated.start()
    truths = chase(simulated, 40.0)
    assert all(truth.in_view for truth in truths)
    assert max(abs(truth.range_m - 0.40) for truth in truths[50:]) < 0.05


def test_the_turntable_turns_the_robot_and_the_truth_counts_from_the_start():
    simulated = world("turn", 3)
    assert simulated.scenario.events[0].box is None
    start = robot(simulated)
    simulated.start()
    simulated.set_wheels(500, -500)
    bearings = []
    for _ in range(100):
        simulated.advance(0.1)
        truth = simulated.capture().truth
        assert truth.range_m is None and truth.target is None and truth.in_view
        assert truth.robot[:2] == pytest.approx(start[:2], abs=1e-4)
        assert truth.bearing_rad == pytest.approx(math.remainder(start[2] - truth.robot[2], 2 * math.pi), abs=1e-4)
        bearings.append(truth.bearing_rad)
    assert math.radians(10) < max(np.abs(bearings)) <= math.radians(25.1)


def test_slip_takes_its_share_of_the_motion_but_not_of_the_measured_speed():
    simulated = world(faults=Faults(wheel_slip=0.2))
    start = robot(simulated)
    simulated.set_wheels(-200, -200)
    simulated.advance(1.0)
    lefts = []
    for _ in range(90):
        simulated.advance(0.1)
        lefts.append(simulated.state().wheels_measured[0])
    end = robot(simulated)
    path = math.hypot(end[0] - start[0], end[1] - start[1])
    assert path / 0.65 == pytest.approx(0.8, abs=0.09)
    assert math.degrees(abs(end[2] - start[2])) > 2.0, "the wheels slip independently"
    assert np.mean(lefts) == pytest.approx(-200, abs=4) and np.std(lefts) < 15


def test_the_simulated_robot_passes_commands_on_and_stops_when_closed():
    simulated = world()
    driven = SimRobot(simulated)
    driven.set_wheels(-100, -100)
    simulated.advance(1.0)
    assert driven.state().wheels_measured == (-100, -100)
    assert driven.kind == "sim" and driven.limits.max_units == 500
    driven.close()
    simulated.advance(1.0)
    assert driven.state().wheels_measured == (0, 0)


def test_an_unknown_scenario_is_refused_with_the_list_of_known_ones():
    with pytest.raises(AgentError, match=", ".join(SCENARIOS)):
        world("moon")


@pytest.mark.parametrize("wrong", [{"wheel_slip": 0.6}, {"noise_sigma": -1.0}, {"lost_frames": 1.0}, {"blur_s": -0.1}])
def test_faults_out_of_range_are_refused_by_name(wrong):
    with pytest.raises(AgentError, match=next(iter(wrong))):
        Faults(**wrong)


def test_a_negative_seed_is_refused():
    with pytest.raises(AgentError, match="seed"):
        world(seed=-1)


@pytest.mark.parametrize(
    ("failure", "advice"),
    [
        (ModuleNotFoundError("No module named 'mujoco'"), "pip install 'zservo\\[sim\\]'"),
        (AttributeError("'NoneType' object has no attribute 'eglQueryString'"), "libegl1 libgl1 libgl1-mesa-dri"),
    ],
)
def test_without_mujoco_or_egl_a_person_learns_what_to_install(monkeypatch, failure, advice):
    def fail(name: str):
        raise failure

    monkeypatch.setattr(importlib, "import_module", fail)
    with pytest.raises(AgentError, match=advice):
        engine.load_mujoco()


def test_a_closed_world_gives_no_more_frames():
    simulated = world()
    assert simulated.capture() is not None
    simulated.close()
    simulated.close()
    with pytest.raises(CameraError):
        simulated.capture()


@pytest.mark.parametrize("seed", range(4))
def test_the_arc_robot_is_set_down_a_metre_from_the_picture_20_degrees_round_and_facing_it(seed):
    stage, poster = build_stage("arc", seed), build_stage("poster", seed)
    wall, down = stage.picture.wall_pose, stage.set_down
    assert (stage.robot_start, stage.picture) == (poster.robot_start, poster.picture)
    assert math.hypot(wall.x_m - down.x_m, wall.y_m - down.y_m) == pytest.approx(1.0)
    sight = math.atan2(wall.y_m - down.y_m, wall.x_m - down.x_m)
    assert down.heading_rad == pytest.approx(sight)
    assert abs(math.degrees(sight - wall.heading_rad)) == pytest.approx(20)
