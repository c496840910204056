"""The agent on Debian's own packages drives a real Aseba Thymio II over a real D-Bus, and stops it whatever happens."""

from __future__ import annotations

import math
import signal
import statistics
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import thymiodirect

from tests.helpers import Program, Programs, RawStation, TelemetryLog, wait_until
from tests.playground import EDGE_CM, Playground, needs_aseba

pytestmark = [needs_aseba, pytest.mark.timed]
FRAME_BYTES = 160 * 120
FULL_SPEED = 100
"""Wire units; with --speed-scale 4 these are 400 motor units, 13 cm/s."""


@pytest.fixture(scope="module")
def playground(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Playground]:
    """One for all tests: it takes some seconds to come up."""
    programs = Programs()
    try:
        yield Playground(programs, tmp_path_factory.mktemp("playground"))
    finally:
        programs.close()


@pytest.fixture
def agent(playground: Playground, port: int, pictures: Path) -> Iterator[Program]:
    """An agent that serves already; the robot stands far from everything and looks at the wall."""
    started = playground.agent(port, "--camera", "replay", "--source", str(pictures), "--speed-scale", "4")
    started.says("serving robot", 20.0)
    playground.put(60.0, 100.0, 0.0)
    yield started
    started.kill()


def drive(station: RawStation, seconds: float, left: int, right: int) -> None:
    """A command per frame, as a station gives them."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        station.read_frame()
        station.send(left, right)


def standing(look: dict) -> bool:
    return look.get("left") == 0 and look.get("right") == 0


def test_commands_reach_the_motors_soon_and_sigterm_stops_them(
    playground: Playground, agent: Program, port: int
) -> None:
    """The target in the robot changes within some playground steps of 30 ms; at the agent's end it is zero again."""
    delays_s = []
    with RawStation(port, FRAME_BYTES) as station:
        for turn in range(12):
            asked = (10 + turn, 20 + turn)
            drive(station, 0.25, 10 + turn - 1, 20 + turn - 1)
            station.send(*asked)
            sent_s = time.monotonic()
            wanted = (4 * asked[0], 4 * asked[1])
            seen = playground.wait_for(
                lambda look, wanted=wanted: (look.get("left"), look.get("right")) == wanted,
                f"targets {wanted}",
                timeout_s=2.0,
                since_s=sent_s,
            )
            delays_s.append(seen["time_s"] - sent_s)
        assert statistics.median(delays_s) < 0.15, f"{delays_s} (three answers of 30 ms belong to the looking itself)"
        drive(station, 0.5, 30, 30)
        asked_s = time.monotonic()
        agent.signal(signal.SIGTERM)
        assert agent.exit_code() == 0
    assert "did not confirm" not in agent.stderr
    playground.wait_for(standing, "standing wheels", timeout_s=1.0, since_s=asked_s)


def test_station_that_goes_leaves_a_robot_that_stands(playground: Playground, agent: Program, port: int) -> None:
    """A station that ends (as by SIGKILL, its sockets close): the robot's targets are zero within 700 ms."""
    begun_s = time.monotonic()
    with RawStation(port, FRAME_BYTES) as station:
        drive(station, 1.0, 40, 40)
        playground.wait_for(lambda look: look.get("left") == 160, "a robot that drives", since_s=begun_s)
    gone_s = time.monotonic()
    stood = playground.wait_for(standing, "standing wheels", since_s=gone_s)
    assert stood["time_s"] - gone_s <= 0.7


def test_station_that_hangs_leaves_a_robot_that_stands(playground: Playground, agent: Program, port: int) -> None:
    """No command for 500 ms while the connections stay open."""
    with RawStation(port, FRAME_BYTES) as station:
        drive(station, 1.0, 40, 40)
        silent_s = time.monotonic()
        stood = playground.wait_for(standing, "standing wheels", since_s=silent_s)
    assert 0.3 <= stood["time_s"] - silent_s <= 0.9


def test_asebamedulla_stops_and_starts_again(playground: Playground, agent: Program, port: int) -> None:
    """The station is told that the wheels are unknown; commands resume within 3 s of asebamedulla's return."""
    telemetry = TelemetryLog(port).wait_until_live()
    try:
        with RawStation(port, FRAME_BYTES) as station:
            drive(station, 1.0, 40, 40)
            playground.medulla.kill()
            killed_s = time.monotonic()
            drive(station, 0.5, 40, 40)
            told = telemetry.wait_for(
                lambda message: "wheels are unknown" in message.reason, since_s=killed_s, what="why"
            )
            assert told.safety == "stopped" and told.wheels_measured is None
            playground.start_medulla()
            back_s = time.monotonic()
            while time.monotonic() < back_s + 3.0:
                drive(station, 0.1, 35, 35)
                if any(look.get("left") == 140 for look in playground.looks(back_s)):
                    return
    finally:
        telemetry.close()
    raise AssertionError("commands did not resume within 3 s")


def test_obstacle_at_full_speed(playground: Playground, agent: Program, port: int) -> None:
    """Driving at the wall it stops before contact, and drives away backwards when told."""
    playground.put(120.0, 100.0, 0.0)
    begun_s = time.monotonic()
    with RawStation(port, FRAME_BYTES) as station:
        drive(station, 3.0, FULL_SPEED, FULL_SPEED)
        nearest_cm = max(look["x"] for look in playground.looks(begun_s))
        front_cm, wall_cm = nearest_cm + 8.0, 149.0
        assert nearest_cm > 122.0, "it never drove"
        assert front_cm < wall_cm, f"contact: front at {front_cm:.1f} cm, wall at {wall_cm} cm"
        backing_s = time.monotonic()
        drive(station, 1.5, -40, -40)
        playground.wait_for(lambda look: look["x"] < nearest_cm - 2, "driving away", since_s=backing_s)


def test_a_table_s_edge(playground: Playground, agent: Program, port: int) -> None:
    """Driving at full speed to where the floor is black it stops with its wheels before the edge, and backs off."""
    playground.put(60.0, 100.0, math.pi)
    begun_s = time.monotonic()
    telemetry = TelemetryLog(port).wait_until_live()
    try:
        with RawStation(port, FRAME_BYTES) as station:
            drive(station, 3.5, FULL_SPEED, FULL_SPEED)
            telemetry.wait_for(lambda message: message.reason == "an edge in front", what="the edge")
            nearest_cm = min(look["x"] for look in playground.looks(begun_s))
            assert EDGE_CM < nearest_cm < 50.0, "the wheels are at the robot's own place"
            backing_s = time.monotonic()
            drive(station, 1.5, -40, -40)
            playground.wait_for(lambda look: look["x"] > nearest_cm + 2, "driving away", since_s=backing_s)
    finally:
        telemetry.close()


def test_without_d_bus_and_asebamedulla(programs: Programs, port: int, pictures: Path, tmp_path: Path) -> None:
    """--robot thymio-serial at the playground's TCP port, on Debian's Python with thymiodirect beside it: it drives,
    stops at the edge and when the station goes, and stands at the end."""
    playground = Playground(programs, tmp_path, medulla=False)
    (tmp_path / "packages").mkdir()
    (tmp_path / "packages/thymiodirect").symlink_to(Path(thymiodirect.__file__).parent)
    agent = playground.agent(
        port,
        *("--device", f"tcp:127.0.0.1:{playground.aseba_port}", "--speed-scale", "4"),
        *("--camera", "replay", "--source", str(pictures)),
        robot="thymio-serial",
        PYTHONPATH=str(tmp_path / "packages"),
    )
    agent.says("serving robot", 20.0)
    playground.put(60.0, 100.0, math.pi)
    telemetry = TelemetryLog(port).wait_until_live()
    try:
        with RawStation(port, FRAME_BYTES) as station:
            drive(station, 3.5, FULL_SPEED, FULL_SPEED)
            told = telemetry.wait_for(lambda message: message.reason == "an edge in front", what="the edge")
            assert told.battery_v is None, "this robot has no battery to measure"
            nearest_cm = min(look["x"] for look in playground.looks())
            assert EDGE_CM < nearest_cm < 50.0
            drive(station, 1.0, -40, -40)
            telemetry.wait_for(lambda message: message.wheels_measured == (-160, -160), what="driving backwards")
        gone_s = time.monotonic()
        telemetry.wait_for(lambda message: message.wheels_measured == (0, 0), 0.7, since_s=gone_s, what="standing")
        agent.signal(signal.SIGTERM)
        assert agent.exit_code() == 0
    finally:
        telemetry.close()
    assert "did not confirm" not in agent.stderr
    wait_until(lambda: len({look["x"] for look in playground.looks()[-5:]}) == 1, 1.0, "a robot that stands")


def test_it_drives_over_the_system_bus(playground: Playground, port: int, pictures: Path) -> None:
    """--bus system: the same bus under the system bus's name, and no session bus at all."""
    address = playground.environment["DBUS_SESSION_BUS_ADDRESS"]
    agent = playground.agent(
        port,
        *("--camera", "replay", "--source", str(pictures), "--bus", "system"),
        DBUS_SYSTEM_BUS_ADDRESS=address,
        DBUS_SESSION_BUS_ADDRESS="unix:path=/nowhere/bus",
    )
    agent.says("serving robot", 20.0)
    with RawStation(port, FRAME_BYTES) as station:
        begun_s = time.monotonic()
        drive(station, 1.0, 40, 40)
        playground.wait_for(lambda look: look.get("left") == 40, "a robot that drives", since_s=begun_s)
    agent.kill()


def test_what_is_not_there_is_said(playground: Playground, programs: Programs, port: int, pictures: Path) -> None:
    """No bus, no asebamedulla on the bus, no such node: exit code 1 and a sentence. (At once: some wait a while.)"""
    nowhere = "unix:path=/nowhere/bus"
    lonely = programs.start("dbus-daemon", "--session", "--nofork", "--print-address")
    cases = {
        "There is no D-Bus session bus": ((), {"DBUS_SESSION_BUS_ADDRESS": nowhere}),
        "There is no D-Bus system bus": (("--bus", "system"), {"DBUS_SYSTEM_BUS_ADDRESS": nowhere}),
        "asebamedulla is not on the bus": (
            (),
            {"DBUS_SESSION_BUS_ADDRESS": wait_until(lambda: lonely.stdout.strip(), 5.0, "a session bus")},
        ),
        "sees no node 'thymio-X' (it sees thymio-II; --node)": (("--node", "thymio-X"), {}),
    }
    camera = ("--camera", "replay", "--source", str(pictures))
    agents = {
        said: playground.agent(port, *camera, *options, **environment) for said, (options, environment) in cases.items()
    }
    for said, agent in agents.items():
        assert agent.exit_code(30.0) == 1
        assert said in agent.stderr and "Traceback" not in agent.stderr
