"""What an announcement may say, and what becomes of it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from base_station.cli import main
from base_station.discovery import MAX_TEXT, printable, robot_from


def announced(addresses=("10.0.0.7",), port=31440, properties=None):
    return robot_from("vm._zservo._tcp.local.", list(addresses), port, properties or {})


def test_a_robot_as_it_announces_itself():
    robot = announced(properties={b"robot": b"thymio", b"camera": b"PiCamera"})
    assert (robot.name, robot.address, robot.port) == ("vm", "10.0.0.7", 31440)
    assert (robot.robot, robot.camera, robot.busy) == ("thymio", "PiCamera", "does not answer")


@pytest.mark.parametrize("addresses", [(), ("nonsense",), ("224.0.0.251",), ("0.0.0.0",), ("fe80::1",)])
def test_an_announcement_without_an_address_one_could_connect_to_is_none(addresses):
    assert announced(addresses) is None


@pytest.mark.parametrize("port", [None, 0, -1, 65533, 10**9])
def test_an_announcement_without_four_ports_is_none(port):
    assert announced(port=port) is None


def test_no_more_addresses_than_are_sensible_are_looked_at():
    assert len(announced([f"10.0.0.{n}" for n in range(1, 255)]).addresses) == 8


def test_text_from_the_network_cannot_write_elsewhere_on_the_screen():
    robot = announced(properties={b"robot": b"\x1b[2Jthymio\n", b"camera": b"\xff" * 500})
    assert robot.robot == "?[2Jthymio?"
    assert len(robot.camera) == MAX_TEXT


@given(st.text(), st.dictionaries(st.binary(), st.one_of(st.none(), st.binary())))
def test_anything_announced_is_harmless(name, properties):
    robot = robot_from(name, ["10.0.0.7"], 31440, properties)
    for text in (robot.name, robot.robot, robot.camera, printable(name)):
        assert len(text) <= MAX_TEXT
        assert text == "" or text.isprintable()


@pytest.mark.parametrize("seconds", ["0", "-1", "1000", "nan"])
def test_a_time_that_is_none_is_wrong_usage(seconds):
    assert main(["robots", "--seconds", seconds]) == 2
