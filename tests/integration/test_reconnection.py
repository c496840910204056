"""Robots that go and come back, robots that are busy, and robots that speak the raw ports only."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from protocol import Request
from tests.helpers import (
    Operator,
    Programs,
    RawPeer,
    RawStation,
    TelemetryLog,
    closed_by_peer,
    connect,
    driving,
    numbered_picture,
    read_exactly,
    wait_until,
)

FRAME_BYTES = 160 * 120


def rows_in(results: Path) -> int:
    """Frames that the station has written to its results file so far."""
    return results.read_text().count("\n") if results.exists() else 0


def test_agent_killed_and_started_again(
    programs: Programs, port: int, pictures: Path, listen: Callable[[], TelemetryLog]
) -> None:
    """The station says that it lost the robot, connects again by itself and drives on."""
    agent = programs.replay(port, pictures)
    telemetry = listen()
    station = programs.station(port, "--behaviour", "pattern")
    telemetry.wait_for(driving, 20.0, what="wheels that turn")

    agent.kill()
    station.says("lost the robot", 5.0)
    station.says("waiting for the robot", 5.0)
    assert station.alive
    programs.replay(port, pictures)
    again_s = time.monotonic()
    driven = telemetry.wait_for(driving, 10.0, since_s=again_s, what="wheels that turn again")
    wait_until(
        lambda: telemetry.last and telemetry.last.frame and telemetry.last.frame.number > 30, 10.0, "30 more frames"
    )
    assert driven.safety == "ok"
    assert station.stderr.count(f"connected to 127.0.0.1:{port}, frames 160x120") >= 2
    station.signal(signal.SIGINT)
    assert station.exit_code() == 0


def test_station_before_its_agent(programs: Programs, port: int, pictures: Path) -> None:
    """A station that is started first waits, says so, and begins when the agent comes."""
    station = programs.station(port, "--behaviour", "idle", "--max-frames", "20")
    station.says("waiting for the robot")
    programs.replay(port, pictures)

    assert station.exit_code() == 0, station.stderr
    assert "connected to" in station.stderr


@pytest.mark.parametrize("rhythm", ["free", "lockstep"])
def test_second_station_is_turned_away(
    programs: Programs, port: int, pictures: Path, operator: Operator, rhythm: str
) -> None:
    """One station at a time: others are closed at once, hello names the first, and after it the robot is free again."""
    agent = programs.replay(port, pictures, "--rhythm", rhythm)
    with RawStation(port, FRAME_BYTES) as first:
        first.read_frame()
        assert operator.hello().busy_with == first.address
        with connect(port) as frames, connect(port + 1) as commands:
            assert closed_by_peer(frames) and closed_by_peer(commands)
        agent.says("turned away: second station, busy with " + first.address)
        for number in range(5):
            first.send(number, number)
            first.read_frame()

        second = programs.station(port)
        assert second.exit_code() == 1
        assert f"is busy with the station {first.address}" in second.stderr
        first.send(0, 0)
        first.read_frame()

    wait_until(lambda: operator.hello().busy_with is None, 3.0, "the robot is free")
    third = programs.station(port, "--behaviour", "idle", "--max-frames", "5")
    assert third.exit_code() == 0, third.stderr


@pytest.mark.parametrize("rhythm", ["free", "lockstep"])
@pytest.mark.parametrize("half", [0, 1])
def test_half_a_station_that_goes_leaves_the_robot_free(
    programs: Programs, port: int, pictures: Path, operator: Operator, rhythm: str, half: int
) -> None:
    """A peer with only one of the two connections, which then closes, does not keep the robot busy."""
    programs.replay(port, pictures, "--rhythm", rhythm)
    with connect(port + half):
        wait_until(lambda: operator.hello().busy_with is not None, 3.0, "the robot is busy")

    wait_until(lambda: operator.hello().busy_with is None, 3.0, "the robot is free")


def test_station_that_dies_with_unread_frames_leaves_the_robot_free(
    programs: Programs, port: int, pictures: Path, operator: Operator
) -> None:
    """Frames queued for a station that reads nothing and goes do not keep the robot busy."""
    programs.replay(port, pictures, "--size", "640x480")
    with RawStation(port, 640 * 480, receive_buffer=4096):
        time.sleep(0.5)
        assert operator.hello().busy_with is not None

    wait_until(lambda: operator.hello().busy_with is None, 3.0, "the robot is free")


@pytest.fixture
def peer(port: int) -> Iterator[RawPeer]:
    """A robot with the raw ports only."""
    robot = RawPeer(port)
    yield robot
    robot.close()


def test_plain_peer(programs: Programs, port: int, peer: RawPeer, tmp_path: Path) -> None:
    """Without hello the station says which frame size it assumes and that commands are cut to 0..127, and cuts them."""
    results = tmp_path / "results.csv"
    station = programs.station(
        port, "--behaviour", "pattern", "--width", "160", "--height", "120", "--max-frames", "40",
        "--results", str(results),
    )  # fmt: skip
    received = []
    with peer.station() as (frames, commands):
        for number in range(1, 41):
            frames.sendall(numbered_picture(number).tobytes())
            received.append(tuple(read_exactly(commands, 2)))
        assert station.exit_code() == 0, station.stderr
        assert read_exactly(commands, 2) == b"\x00\x00", "the stop at the end"
    assert "Assuming frames of 160x120" in station.stderr
    assert "arrival times" in station.stderr
    assert "cut to 0..127" in station.stderr
    assert received == [(100, 100)] * 15 + [(0, 100)] * 5 + [(100, 0)] * 5 + [(0, 0)] * 15
    assert rows_in(results) == 41


def test_plain_peer_that_reads_signed_commands(programs: Programs, port: int, peer: RawPeer) -> None:
    """With --signed-peer the whole of listing A.2's cycle goes out, backwards too."""
    station = programs.station(
        port, "--behaviour", "pattern", "--width", "160", "--height", "120", "--max-frames", "40", "--signed-peer"
    )
    received = []
    with peer.station() as (frames, commands):
        for number in range(1, 41):
            frames.sendall(numbered_picture(number).tobytes())
            received.append(tuple(read_exactly(commands, 2)))
        assert station.exit_code() == 0, station.stderr
    cycle = [(100, 100)] * 15 + [(-68, 100)] * 5 + [(100, -68)] * 5 + [(-100, -100)] * 15
    assert received == [(left % 256, right % 256) for left, right in cycle]
    assert "signed" in station.stderr


def test_wrong_assumed_size_cannot_be_detected(programs: Programs, port: int, peer: RawPeer) -> None:
    """The raw bytes do not tell a frame's size: 160x120 sent, 160x60 assumed, gives two frames for one and no error.
    All that the station can do is to say what it assumes."""
    station = programs.station(port, "--behaviour", "idle", "--width", "160", "--height", "60", "--max-frames", "20")
    with peer.station() as (frames, commands):
        for number in range(1, 11):
            frames.sendall(numbered_picture(number)[:60].tobytes())
            read_exactly(commands, 2)
            frames.sendall(numbered_picture(number)[60:].tobytes())
            read_exactly(commands, 2)
        assert station.exit_code() == 0, station.stderr
    assert "Assuming frames of 160x60" in station.stderr


def test_peer_that_goes_inside_a_frame(programs: Programs, port: int, peer: RawPeer) -> None:
    """Half a frame and then the end: the station says in which frame the stream ended, and connects again."""
    station = programs.station(port, "--behaviour", "idle", "--width", "160", "--height", "120", "--max-frames", "8")
    with peer.station() as (frames, commands):
        for number in range(1, 4):
            frames.sendall(numbered_picture(number).tobytes())
            read_exactly(commands, 2)
        frames.sendall(numbered_picture(4).tobytes()[:9600])
    station.says("the stream ended inside frame 4: 9600 of 19200 bytes had arrived")
    with peer.station() as (frames, commands):
        for number in range(1, 6):
            frames.sendall(numbered_picture(number).tobytes())
            read_exactly(commands, 2)
        assert station.exit_code() == 0, station.stderr


def test_plain_peer_has_no_emergency_stop(programs: Programs, port: int, peer: RawPeer) -> None:
    """A robot without a control port does not keep its station waiting: the first frame is answered within a second."""
    programs.station(port, "--behaviour", "idle", "--width", "160", "--height", "120")
    with peer.station() as (frames, commands):
        sent_s = time.monotonic()
        frames.sendall(numbered_picture(1).tobytes())
        assert read_exactly(commands, 2) == b"\x00\x00"
        assert time.monotonic() - sent_s < 1.0


def test_control_request_to_a_busy_agent(programs: Programs, port: int, pictures: Path, operator: Operator) -> None:
    """Anybody who may connect may stop a robot that drives for another, not only its station."""
    programs.replay(port, pictures)
    with RawStation(port, FRAME_BYTES) as station:
        station.read_frame()
        assert operator.ask(Request(action="stop", text="I see smoke")).ok
        assert not operator.ask(Request(action="exposure", value=1000.0)).ok, "a recording has no exposure"
