"""The behaviours that look at nothing: listing A.2's drive, standing still, and driving by keys."""

from __future__ import annotations

import queue

import pytest

from base_station.behaviours.base import Drive
from base_station.behaviours.registry import BEHAVIOURS, BehaviourContext, check_behaviour, make_behaviour
from base_station.behaviours.scripted import Idle, Pattern
from base_station.behaviours.teleop import Teleop, TeleopSettings
from base_station.geometry import PinholeCamera
from base_station.types import TrackerResult, TrackingState
from protocol import STOP, Command, RobotLimits

DRIVE = Drive(RobotLimits(speed_scale=4.0))
SEEN = TrackerResult(state=TrackingState.TRACKING, bearing_rad=0.3, zoom=0.5)
LOST = TrackerResult(state=TrackingState.LOST, reason="gone")
FORWARD, BACKWARD = Command(62, 62), Command(-62, -62)  # 8 cm/s at 1.3 mm/s a unit
LEFT, RIGHT = Command(-36, 36), Command(36, -36)  # 1 rad/s, wheels 9.4 cm apart


def listing_a2() -> list[tuple[int, int]]:
    """Its six loops with their bounds, and what each writes into chars[0] and chars[1]."""
    drive: list[tuple[int, int]] = []
    for start, end, left, right in (
        (0, 5, 100, 100),
        (5, 15, 100, 100),
        (15, 20, 2 * 16 - 100, 100),
        (20, 25, 100, 2 * 16 - 100),
        (25, 35, -100, -100),
        (35, 40, -100, -100),
    ):
        drive += [(left, right)] * (end - start)
    return drive


def test_pattern_is_listing_a2_over_and_over_whatever_is_seen():
    pattern = Pattern()
    results = (None, SEEN, LOST)
    driven = [pattern.command(results[frame % 3], frame / 30) for frame in range(100)]
    assert [(command.left, command.right) for command in driven] == (listing_a2() * 3)[:100]


def test_idle_stands():
    assert {Idle().command(result, 0.0) for result in (None, SEEN, LOST)} == {STOP}


def teleop() -> tuple[Teleop, queue.SimpleQueue[str]]:
    keys: queue.SimpleQueue[str] = queue.SimpleQueue()
    return Teleop(DRIVE, keys), keys


@pytest.mark.parametrize(
    ("key", "command"),
    [
        ("w", FORWARD), ("up", FORWARD), ("s", BACKWARD), ("down", BACKWARD),
        ("a", LEFT), ("left", LEFT), ("d", RIGHT), ("right", RIGHT), ("x", STOP), ("", STOP),
    ],
)  # fmt: skip
def test_each_key_drives_its_way_and_any_other_stops(key, command):
    driver, keys = teleop()
    assert driver.command(None, 0.0) == STOP
    keys.put(key)
    assert driver.command(SEEN, 0.1) == command


def test_a_key_pressed_once_is_held_for_a_terminal_s_first_delay_and_then_the_robot_stands():
    driver, keys = teleop()
    keys.put("w")
    assert driver.command(None, 0.0) == FORWARD
    assert driver.command(None, 0.59) == FORWARD
    assert driver.command(None, 0.61) == STOP
    assert driver.command(None, 0.3) == FORWARD  # only the time decides


def test_a_repeated_key_is_held_a_short_while_after_each_repeat():
    driver, keys = teleop()
    settings = TeleopSettings()
    for time_s in (0.0, 0.5, 0.53, 0.56):
        keys.put("w")
        assert driver.command(None, time_s) == FORWARD
    assert driver.command(None, 0.56 + settings.repeat_hold_s - 0.01) == FORWARD
    assert driver.command(None, 0.56 + settings.repeat_hold_s + 0.01) == STOP


def test_the_same_key_after_a_pause_is_a_first_press_again():
    driver, keys = teleop()
    for time_s in (0.0, 5.0):
        keys.put("w")
        assert driver.command(None, time_s) == FORWARD
    assert driver.command(None, 5.5) == FORWARD


def test_the_newest_key_counts_and_another_key_stops_at_once():
    driver, keys = teleop()
    for key in ("w", "a", "d"):
        keys.put(key)
    assert driver.command(None, 0.0) == RIGHT
    keys.put("x")
    assert driver.command(None, 0.01) == STOP
    assert driver.command(None, 0.02) == STOP


def test_every_behaviour_of_the_registry_can_be_made_and_stands_before_anything_is_learned():
    for name in BEHAVIOURS:
        made = make_behaviour(
            name,
            BehaviourContext(
                drive=DRIVE,
                keys=queue.SimpleQueue(),
                camera=PinholeCamera.with_fov(640, 480),
                course=((0.0, 0.0), (1.0, 0.0), (1.0, 1.0)),
            ),
        )
        assert made.command(None, 0.0) == (Command(100, 100) if name == "pattern" else STOP)


def test_an_unknown_behaviour_is_answered_with_those_there_are_and_the_nearest():
    with pytest.raises(ValueError, match=r"no behaviour 'folow'; there are follow, .*teleop.* you meant follow\."):
        check_behaviour("folow")
    with pytest.raises(ValueError, match="there are follow") as caught:
        make_behaviour(
            "zzz", BehaviourContext(drive=DRIVE, keys=queue.SimpleQueue(), camera=PinholeCamera.with_fov(640, 480))
        )
    assert "meant" not in str(caught.value)
