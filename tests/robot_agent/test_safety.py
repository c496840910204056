"""The supervisor: every reason to stop, what obstacles leave of a command, and that nothing gets past the limit."""

from __future__ import annotations

import dataclasses
import math
from functools import partial

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_agent.safety import (
    PRESETS,
    LinkState,
    SafetySettings,
    SafetyState,
    SafetySupervisor,
    WheelCommand,
)

NOW_S = 100.0
GOOD = LinkState(connected=True, last_frame_s=NOW_S)
CLEAR = (0,) * 7
FORWARD = WheelCommand(200, 200, NOW_S)


def decide(command=FORWARD, proximity=CLEAR, link=GOOD, *, now_s=NOW_S, settings=None):
    """(left, right, state) and the reason."""
    decision = SafetySupervisor(settings).step(now_s, command, proximity, link)
    return (decision.left, decision.right, decision.state), decision.reason


def near(sensor: int, reading: int = 4000) -> tuple[int, ...]:
    return tuple(reading if index == sensor else 0 for index in range(7))


def wheels(left: float, right: float) -> WheelCommand:
    return WheelCommand(left, right, NOW_S)


def test_with_nothing_wrong_the_command_goes_through():
    assert decide(wheels(200, -150)) == ((200, -150, SafetyState.OK), "")


def test_a_robot_without_proximity_sensors_drives_too():
    assert decide(proximity=None) == ((200, 200, SafetyState.OK), "")


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"link": LinkState(connected=False, last_frame_s=NOW_S)}, "no station is connected"),
        ({"link": LinkState(connected=True, last_frame_s=None)}, "the camera has not given a picture yet"),
        ({"link": LinkState(connected=True, last_frame_s=NOW_S - 0.61)}, "the camera hangs: no picture for 610 ms"),
        ({"link": LinkState(connected=True, last_frame_s=NOW_S, problem="the bus is gone")}, "the bus is gone"),
        ({"command": None}, "no command yet"),
        ({"command": WheelCommand(200, 200, NOW_S - 0.72)}, "no command for 720 ms"),
    ],
)
def test_each_failure_stops_the_wheels_and_says_why(changes, reason):
    assert decide(**changes) == ((0, 0, SafetyState.STOPPED), reason)


@pytest.mark.parametrize(("silent_s", "state"), [(0.5, SafetyState.OK), (0.5001, SafetyState.STOPPED)])
def test_the_time_without_a_command_or_a_picture_is_half_a_second_exactly(silent_s, state):
    now_s = silent_s  # the clock's zero is exact in binary
    command, link = WheelCommand(9, 9, 0.0), LinkState(connected=True, last_frame_s=0.0)
    fresh_command, fresh_link = WheelCommand(9, 9, now_s), LinkState(connected=True, last_frame_s=now_s)
    assert decide(command, link=fresh_link, now_s=now_s)[0][2] is state
    assert decide(fresh_command, link=link, now_s=now_s)[0][2] is state


def test_other_times_can_be_set_for_slow_cameras_and_links():
    slow = SafetySettings(command_timeout_s=2.0, frame_timeout_s=3.0)
    old = WheelCommand(9, 9, NOW_S - 1.9)
    assert decide(old, link=LinkState(connected=True, last_frame_s=NOW_S - 2.9), settings=slow)[1] == ""
    assert decide(old, link=LinkState(connected=True, last_frame_s=NOW_S - 3.1), settings=slow)[1].startswith("the cam")


def test_the_gravest_reason_is_told_first():
    everything = LinkState(connected=False, last_frame_s=None, problem="the bus is gone")
    supervisor = SafetySupervisor()
    supervisor.emergency_stop("by the operator")
    assert supervisor.step(NOW_S, None, near(2), everything).reason == "emergency stop: by the operator"
    supervisor.release()
    assert supervisor.step(NOW_S, None, near(2), everything).reason == "the bus is gone"
    assert decide(None, link=LinkState(connected=False, last_frame_s=None))[1] == "no station is connected"
    assert decide(None, link=LinkState(connected=True, last_frame_s=None))[1].startswith("the camera has not")


def test_the_emergency_stop_latches_until_it_is_released():
    supervisor = SafetySupervisor()
    supervisor.emergency_stop()
    for now_s in (NOW_S, NOW_S + 0.1, NOW_S + 3600):
        decision = supervisor.step(
            now_s, WheelCommand(9, 9, now_s), CLEAR, LinkState(connected=True, last_frame_s=now_s)
        )
        assert (decision.left, decision.right, decision.reason) == (0, 0, "emergency stop")
    supervisor.release()
    assert supervisor.step(NOW_S, FORWARD, CLEAR, GOOD).state is SafetyState.OK


@pytest.mark.parametrize("sensor", range(5))
def test_an_obstacle_before_any_of_the_five_front_sensors_stops_going_forward(sensor):
    assert decide(proximity=near(sensor)) == ((0, 0, SafetyState.LIMITED), "obstacle in front")


@pytest.mark.parametrize("sensor", [5, 6])
def test_an_obstacle_before_either_rear_sensor_stops_going_backward(sensor):
    assert decide(wheels(-200, -200), near(sensor)) == ((0, 0, SafetyState.LIMITED), "obstacle behind")


@pytest.mark.parametrize("sensor", range(7))
def test_the_threshold_itself_is_not_yet_an_obstacle(sensor):
    command = wheels(200, 200) if sensor < 5 else wheels(-200, -200)
    assert decide(command, near(sensor, 2000))[0][2] is SafetyState.OK
    assert decide(command, near(sensor, 2001))[0][2] is SafetyState.LIMITED


def test_an_obstacle_takes_the_mean_and_leaves_the_difference():
    assert decide(wheels(300, 100), near(2))[0] == (100, -100, SafetyState.LIMITED)
    assert decide(wheels(100, 300), near(2))[0] == (-100, 100, SafetyState.LIMITED)
    assert decide(wheels(-300, -100), near(5))[0] == (-100, 100, SafetyState.LIMITED)
    assert decide(wheels(300, -100), near(2))[0] == (200, -200, SafetyState.LIMITED)
    assert decide(wheels(3, 1), near(2))[0] == (1, -1, SafetyState.LIMITED)


@pytest.mark.parametrize(
    ("command", "sensor"),
    [
        (wheels(-200, -200), 2),
        (wheels(-200, 100), 2),
        (wheels(-90, 90), 2),
        (wheels(200, 200), 5),
        (wheels(90, -90), 6),
    ],
)
def test_turning_on_the_spot_and_going_away_from_an_obstacle_are_untouched(command, sensor):
    assert decide(command, near(sensor)) == ((command.left, command.right, SafetyState.OK), "")


def test_between_two_obstacles_only_turning_is_left():
    both = (0, 0, 4000, 0, 0, 4000, 0)
    assert decide(wheels(200, 100), both)[0] == (50, -50, SafetyState.LIMITED)
    assert decide(wheels(-200, -100), both)[0] == (-50, 50, SafetyState.LIMITED)
    assert decide(wheels(-70, 70), both)[0] == (-70, 70, SafetyState.OK)


@pytest.mark.parametrize(
    ("sensor", "reading", "stops"),
    [
        (0, 4500, False), (1, 4500, False), (5, 4500, False), (6, 4500, False),
        (2, 1000, False), (2, 1001, True), (3, 2000, False), (3, 2001, True), (4, 1000, False), (4, 1001, True),
    ],
)  # fmt: skip
def test_the_preset_thesis_is_the_rule_of_listing_a1_to_the_letter(sensor, reading, stops):
    for command in (wheels(200, 100), wheels(-200, -200), wheels(-90, 90)):
        (left, right, state), reason = decide(command, near(sensor, reading), settings=PRESETS["thesis"])
        if stops:
            assert (left, right, state) == (0, 0, SafetyState.STOPPED)
            assert "listing A.1" in reason
        else:
            assert (left, right, state) == (command.left, command.right, SafetyState.OK)


def test_the_preset_thesis_keeps_every_other_reason_to_stop():
    lost = LinkState(connected=False, last_frame_s=NOW_S)
    assert decide(link=lost, settings=PRESETS["thesis"])[1] == "no station is connected"


def test_the_presets_differ_in_the_obstacle_rule_only():
    assert dataclasses.replace(PRESETS["thesis"], thesis_rule=False) == PRESETS["default"] == SafetySettings()


@pytest.mark.parametrize(
    ("asked", "allowed"),
    [((1000, 500), (500, 250)), ((-500, 1000), (-250, 500)), ((500, -500), (500, -500)), ((501, 0), (500, 0))],
)
def test_too_fast_is_slowed_with_both_wheels_in_their_ratio(asked, allowed):
    assert decide(wheels(*asked))[0] == (*allowed, SafetyState.OK)


def test_the_limit_is_that_of_the_robot():
    assert decide(wheels(400, -100), settings=SafetySettings(limit_units=200))[0][:2] == (200, -50)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_no_number_stops_the_wheels(bad):
    for command in (wheels(bad, 0), wheels(0, bad), wheels(bad, bad), WheelCommand(1, 1, math.nan)):
        (left, right, state), reason = decide(command)
        assert (left, right, state) == (0, 0, SafetyState.STOPPED)
        assert reason


def test_a_clock_that_is_no_number_stops_the_wheels():
    assert decide(now_s=math.nan)[0] == (0, 0, SafetyState.STOPPED)
    assert decide(link=LinkState(connected=True, last_frame_s=math.nan))[0] == (0, 0, SafetyState.STOPPED)


@pytest.mark.parametrize("readings", [(), (0, 0, 0, 0, 0), (0,) * 6, (0,) * 8])
def test_another_number_of_readings_than_seven_is_a_broken_sensor_and_stops_the_wheels(readings):
    for preset in PRESETS.values():
        (left, right, state), reason = decide(proximity=readings, settings=preset)
        assert (left, right, state) == (0, 0, SafetyState.STOPPED)
        assert str(len(readings)) in reason


def mostly(usual: st.SearchStrategy, rare: st.SearchStrategy) -> st.SearchStrategy:
    """The rare thing one time in ten: when everything is odd at once, one oddity hides the others."""
    return st.integers(0, 9).flatmap(lambda dice: rare if dice == 9 else usual)


TIME = mostly(st.just(NOW_S), st.sampled_from([NOW_S - 0.3, NOW_S - 0.6, NOW_S + 0.6, math.nan, math.inf, -math.inf]))
SPEED = mostly(st.integers(-600, 600) | st.floats(-1500, 1500), st.sampled_from([math.nan, math.inf, -math.inf, 1e300]))
SEVEN = st.lists(st.integers(0, 4500), min_size=7, max_size=7).map(tuple)
READINGS = mostly(SEVEN, st.none() | st.lists(st.integers(), max_size=9).map(tuple))
LINKS = st.builds(
    LinkState,
    connected=mostly(st.just(True), st.just(False)),
    last_frame_s=mostly(TIME, st.none()),
    problem=mostly(st.just(""), st.just("broken")),
)
SETTINGS = st.builds(
    SafetySettings,
    obstacle=st.integers(1000, 4500),
    limit_units=st.integers(0, 600),
    thesis_rule=mostly(st.just(False), st.just(True)),
)


@given(
    now_s=TIME,
    command=mostly(st.builds(WheelCommand, SPEED, SPEED, TIME), st.none()),
    proximity=READINGS,
    link=LINKS,
    chosen=SETTINGS,
    emergency=mostly(st.just(False), st.just(True)),
)
@settings(derandomize=True, max_examples=400, deadline=None)
def test_whatever_comes_in_the_promises_hold(now_s, command, proximity, link, chosen, emergency):
    supervisor = SafetySupervisor(chosen)
    if emergency:
        supervisor.emergency_stop()
    decision = supervisor.step(now_s, command, proximity, link)
    assert supervisor.step(now_s, command, proximity, link) == decision  # asked again it says the same
    assert abs(decision.left) <= chosen.limit_units
    assert abs(decision.right) <= chosen.limit_units
    assert (decision.reason == "") == (decision.state is SafetyState.OK)
    if decision.state is SafetyState.STOPPED:
        assert (decision.left, decision.right) == (0, 0)
    if emergency or command is None or not link.connected or link.last_frame_s is None or link.problem:
        assert decision.state is SafetyState.STOPPED
    if proximity is not None and len(proximity) == 7 and not chosen.thesis_rule:
        if max(proximity[:5]) > chosen.obstacle:
            assert decision.left + decision.right <= 0
        if max(proximity[5:]) > chosen.obstacle:
            assert decision.left + decision.right >= 0


MODERATE = st.floats(-2000, 2000)


@given(left=MODERATE, right=MODERATE, proximity=st.lists(st.integers(0, 5000), min_size=7, max_size=7).map(tuple))
@settings(derandomize=True, max_examples=200, deadline=None)
def test_while_driving_the_turn_is_never_reversed_and_the_curve_never_bent_without_saying_so(left, right, proximity):
    decision = SafetySupervisor().step(NOW_S, wheels(left, right), proximity, GOOD)
    asked, allowed = right - left, decision.right - decision.left
    assert asked * allowed >= 0
    assert abs(allowed) <= abs(asked) + 1.0
    if decision.state is SafetyState.OK:
        factor = min(1.0, 500 / max(abs(left), abs(right), 1.0))
        assert decision.left == pytest.approx(left * factor, abs=0.51)
        assert decision.right == pytest.approx(right * factor, abs=0.51)
    else:
        assert decision.left + decision.right == 0


def test_an_edge_in_front_lets_the_robot_turn_and_back_off_only():
    ask = partial(decide_with, ground=(900, 20))
    assert (ask(100, 60).left, ask(100, 60).right) == (20, -20)
    assert ask(100, 60).reason == "an edge in front"
    assert (ask(-80, -80).left, ask(-80, -80).right) == (-80, -80)
    assert decide_with(100, 60, ground=(900, 850)).state is SafetyState.OK
    looking_away = SafetySettings(edge=None)
    assert decide_with(100, 60, settings=looking_away, ground=(0, 0)).state is SafetyState.OK


def test_a_robot_that_is_picked_up_stands():
    assert decide_with(100, 60, acceleration=(0, 1, 22)).state is SafetyState.OK
    tilted = decide_with(100, 60, acceleration=(0, 15, 17))
    assert tilted.state is SafetyState.STOPPED and "picked up: tilted by 41 degrees" in tilted.reason
    assert decide_with(100, 60, acceleration=(0, 0, -23)).state is SafetyState.STOPPED, "upside down"
    assert decide_with(100, 60, acceleration=(0, 0, 0)).state is SafetyState.OK, "no accelerometer"
    assert decide_with(100, 60, settings=SafetySettings(tilt_rad=None), acceleration=(0, 23, 0)).left == 100


def decide_with(left, right, *, settings=None, **senses):
    """The decision on a fresh command with a live camera and these senses."""
    link = LinkState(connected=True, last_frame_s=9.99)
    return SafetySupervisor(settings).step(10.0, WheelCommand(left, right, 9.99), None, link, **senses)
