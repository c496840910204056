"""The wheels stop: whatever ends, hangs or floods, and whoever says so. Times are those of the agent's telemetry."""

from __future__ import annotations

import os
import random
import signal
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from protocol import Request, encode
from tests.helpers import Operator, Program, Programs, RawStation, TelemetryLog, connect, driving, standing, wait_until

pytestmark = pytest.mark.timed

Listen = Callable[[], TelemetryLog]
SIM_BYTES = REPLAY_BYTES = 160 * 120


def drive_in_the_simulation(
    programs: Programs, port: int, listen: Listen, behaviour: str = "pattern", tracker: str = "phase"
) -> tuple[Program, Program, TelemetryLog]:
    """Agent, station and telemetry, when the robot really drives."""
    agent = programs.sim(port)
    telemetry = listen()
    station = programs.station(port, "--behaviour", behaviour, tracker=tracker)
    telemetry.wait_for(
        lambda message: min(message.wheels_measured or (0, 0)) > 40, 20.0, what="wheels measured to turn forwards"
    )
    return agent, station, telemetry


def test_station_killed(programs: Programs, port: int, listen: Listen) -> None:
    """SIGKILL to a station that follows: wheels asked and measured stand within 600 ms."""
    agent, station, telemetry = drive_in_the_simulation(programs, port, listen, "follow", "ztransform")

    killed_s = time.monotonic()
    station.signal(signal.SIGKILL)
    stopped = telemetry.wait_for(standing, 3.0, since_s=killed_s, what="standing wheels")
    assert stopped.monotonic_s - killed_s <= 0.6
    assert stopped.safety == "stopped"
    assert "no station is connected" in stopped.reason
    time.sleep(0.3)
    assert all(standing(message) for message in telemetry.messages if message.monotonic_s > stopped.monotonic_s)
    assert agent.alive


def test_station_that_hangs(programs: Programs, port: int, listen: Listen) -> None:
    """SIGSTOP keeps the connections open: the watchdog stops the wheels within 700 ms, and they turn again after."""
    _, station, telemetry = drive_in_the_simulation(programs, port, listen)

    hung_s = time.monotonic()
    station.signal(signal.SIGSTOP)
    stopped = telemetry.wait_for(lambda message: not driving(message), 3.0, since_s=hung_s, what="a stop")
    assert 0.35 <= stopped.monotonic_s - hung_s <= 0.7
    telemetry.wait_for(standing, 0.5, since_s=stopped.monotonic_s, what="wheels measured to stand")
    assert stopped.reason.startswith("no command for")
    assert stopped.station is not None, "the connection is still there"

    station.signal(signal.SIGCONT)
    telemetry.wait_for(driving, 3.0, since_s=stopped.monotonic_s, what="wheels that turn again")


def test_camera_that_hangs(programs: Programs, port: int, listen: Listen) -> None:
    """A camera that gives no more pictures: the wheels stop though commands keep coming, and the reason names it."""
    agent = programs.sim(port, "--fault", "camera_hangs_at_s=1.0")
    telemetry = listen()
    with RawStation(port, SIM_BYTES) as station:
        going = threading.Event()

        def command() -> None:
            while not going.wait(0.03):
                station.send(30, 30)
                station.drain()

        thread = threading.Thread(target=command)
        thread.start()
        try:
            station.read_frame()
            telemetry.wait_for(driving, what="wheels that turn")
            stopped = telemetry.wait_for(lambda message: "camera hangs" in message.reason, what="the camera")
            last_frame = next(message for message in telemetry.messages if message.frame == stopped.frame)
            time.sleep(0.3)
        finally:
            going.set()
            thread.join()
    assert stopped.wheels_asked == (0, 0)
    assert stopped.reason.startswith("the camera hangs")
    assert 0.35 <= stopped.monotonic_s - last_frame.monotonic_s <= 0.7
    assert all(not driving(message) for message in telemetry.messages if message.sequence > stopped.sequence)
    assert agent.alive


def test_station_tells_of_the_camera_that_hangs(programs: Programs, port: int, listen: Listen) -> None:
    """The person at the station reads that it is the camera."""
    programs.sim(port, "--fault", "camera_hangs_at_s=1.0")
    telemetry = listen()
    station = programs.station(port)

    telemetry.wait_for(lambda message: "camera" in message.reason, 20.0, what="the camera as the reason")
    station.says("the camera hangs", 5.0)


def test_emergency_stop_latches(
    programs: Programs, port: int, pictures: Path, listen: Listen, operator: Operator
) -> None:
    """Emergency stop over the control port: wheels stand within 100 ms though commands keep coming, until release."""
    programs.replay(port, pictures)
    telemetry = listen()
    programs.station(port, "--behaviour", "pattern")
    telemetry.wait_for(driving, 20.0, what="wheels that turn")

    asked_s = time.monotonic()
    assert operator.ask(Request(action="stop", text="a hand on the button")).ok
    stopped = telemetry.wait_for(lambda message: not driving(message), 2.0, since_s=asked_s, what="standing wheels")
    assert stopped.monotonic_s - asked_s <= 0.1
    assert stopped.reason == "emergency stop: a hand on the button"

    time.sleep(0.7)
    later = [message for message in telemetry.messages if message.monotonic_s > stopped.monotonic_s]
    assert len(later) > 10
    assert all(not driving(message) and message.reason == stopped.reason for message in later)

    released_s = time.monotonic()
    assert operator.ask(Request(action="release")).ok
    again = telemetry.wait_for(driving, 2.0, since_s=released_s, what="wheels that turn again")
    assert again.safety == "ok"


def test_emergency_stop_outlives_its_station(
    programs: Programs, port: int, pictures: Path, listen: Listen, operator: Operator
) -> None:
    """A new station does not lift the emergency stop."""
    programs.replay(port, pictures)
    telemetry = listen()
    assert operator.ask(Request(action="stop")).ok
    with RawStation(port, REPLAY_BYTES) as station:
        for _ in range(10):
            station.read_frame()
            station.send(50, 50)
        connected = telemetry.wait_for(lambda message: message.station == station.address, what="the station")
    assert connected.reason == "emergency stop"
    assert not any(driving(message) for message in telemetry.messages)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_to_the_agent(programs: Programs, port: int, listen: Listen, number: signal.Signals) -> None:
    """SIGINT and SIGTERM to the agent: the last telemetry tells of standing wheels, exit code 0, nothing is left."""
    agent, station, telemetry = drive_in_the_simulation(programs, port, listen)

    agent.signal(number)
    assert agent.exit_code(10) == 0, agent.stderr
    assert agent.orphans() == []
    wait_until(lambda: telemetry.last and telemetry.last.reason == "the agent ends", 2.0, "the agent's last word")
    assert telemetry.last is not None and not driving(telemetry.last)
    assert station.alive, "it waits for the robot to come back"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_to_the_station(programs: Programs, port: int, listen: Listen, number: signal.Signals) -> None:
    """SIGINT and SIGTERM to the station: the wheels stand at once, exit code 0, nothing is left; the agent stays."""
    agent, station, telemetry = drive_in_the_simulation(programs, port, listen)

    signalled_s = time.monotonic()
    station.signal(number)
    stopped = telemetry.wait_for(standing, 2.0, since_s=signalled_s, what="standing wheels")
    assert stopped.monotonic_s - signalled_s <= 0.45, "sooner than the watchdog would do it"
    assert station.exit_code(10) == 0, station.stderr
    assert station.orphans() == []
    assert agent.alive


def test_signal_to_a_waiting_station(programs: Programs, port: int) -> None:
    """A station that has never met its robot ends on SIGINT as well, with exit code 1: it did nothing."""
    station = programs.station(port)
    station.says("waiting for the robot")

    station.signal(signal.SIGINT)
    assert station.exit_code(10) == 1
    assert "No frame came" in station.stderr


def test_flood_of_garbage_on_the_command_port(programs: Programs, port: int, pictures: Path, listen: Listen) -> None:
    """Random bytes as fast as they go for 2 s: frames keep flowing, the agent lives, the wheels stop after it."""
    agent = programs.replay(port, pictures)
    telemetry = listen()
    garbage = random.Random(1).randbytes(65536)
    with RawStation(port, REPLAY_BYTES) as station:
        ended = threading.Event()
        sent = 0

        def flood() -> None:
            nonlocal sent
            station.commands.settimeout(0.5)
            while not ended.is_set():
                try:
                    sent += station.commands.send(garbage)
                except TimeoutError:
                    continue

        station.read_frame()
        thread = threading.Thread(target=flood)
        thread.start()
        begun_s = time.monotonic()
        frames = 0
        while time.monotonic() - begun_s < 2.0:
            station.read_frame()
            frames += 1
        flooded_s = time.monotonic()
        ended.set()
        thread.join()
    assert sent > 1_000_000, "that was no flood"
    assert frames / (flooded_s - begun_s) >= 20
    assert any(driving(message) for message in telemetry.messages), "random bytes are commands too"
    stopped = telemetry.wait_for(
        lambda message: message.station is None and not driving(message), 2.0, since_s=flooded_s, what="standing wheels"
    )
    assert stopped.reason == "no station is connected"
    assert agent.alive
    assert "Traceback" not in agent.stderr


def test_half_a_command(programs: Programs, port: int, pictures: Path, listen: Listen) -> None:
    """A single byte and then the end: said in the log, no wheel turns, and the robot is free for the next."""
    agent = programs.replay(port, pictures)
    telemetry = listen()
    with connect(port + 1) as commands:
        commands.sendall(b"\x64")
    agent.says("the stream ended inside command 1: 1 of 2 bytes", 3.0)
    assert not any(driving(message) for message in telemetry.messages)

    with RawStation(port, REPLAY_BYTES) as station:
        station.read_frame()
        station.send(20, 20)
        driven = telemetry.wait_for(driving, 3.0, what="wheels that turn")
    assert driven.wheels_asked == (20, 20)


def test_command_in_two_halves(programs: Programs, port: int, pictures: Path, listen: Listen) -> None:
    """A command cut in two by the network is one command, and the half alone moves nothing."""
    programs.replay(port, pictures)
    telemetry = listen()
    with RawStation(port, REPLAY_BYTES) as station:
        station.read_frame()
        station.commands.sendall(b"\x20")
        time.sleep(0.15)
        assert not any(driving(message) for message in telemetry.messages)
        station.commands.sendall(b"\xf0")
        driven = telemetry.wait_for(driving, 3.0, what="wheels that turn")
    assert driven.wheels_asked == (32, -16)


def test_command_connection_alone_goes(programs: Programs, port: int, pictures: Path, listen: Listen) -> None:
    """Only the command connection breaks, frames still flow: the wheels stop."""
    programs.replay(port, pictures)
    telemetry = listen()
    with RawStation(port, REPLAY_BYTES) as station:
        station.read_frame()
        station.send(50, 50)
        telemetry.wait_for(driving, 3.0, what="wheels that turn")
        closed_s = time.monotonic()
        station.commands.shutdown(socket.SHUT_RDWR)
        station.commands.close()
        stopped = telemetry.wait_for(
            lambda message: not driving(message), 2.0, since_s=closed_s, what="standing wheels"
        )
        assert stopped.monotonic_s - closed_s <= 0.3
        assert len(station.read_frame()) == REPLAY_BYTES


def test_command_does_not_outlive_its_connection(programs: Programs, port: int, pictures: Path, listen: Listen) -> None:
    """A station that comes at once after another does not find the wheels turning by the other's last command."""
    programs.replay(port, pictures)
    telemetry = listen()
    with RawStation(port, REPLAY_BYTES) as first:
        first.read_frame()
        first.send(50, 50)
        telemetry.wait_for(driving, 3.0, what="wheels that turn")
    closed_s = time.monotonic()
    telemetry.wait_for(lambda message: message.station is None, 1.0, since_s=closed_s, what="no station")
    with RawStation(port, REPLAY_BYTES) as second:
        met = telemetry.wait_for(lambda message: message.station == second.address, 1.0, what="the second station")
        assert met.monotonic_s - closed_s < 0.4, "too late to prove anything: the watchdog has stopped them"
        second.read_frame()
        second.read_frame()
        known = telemetry.wait_for(lambda message: message.reason == "no command yet", 1.0, since_s=met.monotonic_s)
    assert not any(driving(m) for m in telemetry.messages if met.monotonic_s <= m.monotonic_s <= known.monotonic_s)


def test_random_control_messages(programs: Programs, port: int, pictures: Path, operator: Operator) -> None:
    """Garbage, a huge message, wrong types and parts on the control port: an error or nothing; hello works after it."""
    agent = programs.replay(port, pictures)
    noise = random.Random(2)
    wrong_but_well_formed = [b"\x80", b"\xc0", b"\x93\x01\x02\x03", b"\x81\xa6action\x05", b"\x81\xa6action\xa4fly!"]
    for data in [b"", *(noise.randbytes(size) for size in (1, 7, 100, 4000)), *wrong_but_well_formed]:
        answer = operator.send_raw(data)
        assert answer is not None, f"no answer to {data[:20]!r}"
        assert b"error" in answer and b"\xa2ok\xc2" in answer
    operator.send_raw(bytes(1_000_000), timeout_s=0.3)
    in_two_parts = operator.send_raw([encode(Request(action="hello"))] * 2)
    assert in_two_parts is not None and b"error" in in_two_parts and b"\xa2ok\xc2" in in_two_parts
    with connect(port + 3) as not_zmq:
        not_zmq.sendall(noise.randbytes(2000))

    assert operator.hello().robot == "none"
    assert agent.alive
    assert "Traceback" not in agent.stderr


def test_memory_of_a_flooded_agent(programs: Programs, port: int, pictures: Path, operator: Operator) -> None:
    """A client that floods the control port with requests without reading the replies does not fill the memory."""
    import zmq

    agent = programs.replay(port, pictures)
    operator.hello()
    before = _resident_bytes(agent.process.pid)
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    with context.socket(zmq.DEALER) as flood:
        flood.linger = 0
        flood.connect(f"tcp://127.0.0.1:{port + 3}")
        until_s = time.monotonic() + 1.0
        while time.monotonic() < until_s:
            if flood.poll(10, zmq.POLLOUT):
                flood.send_multipart([b"", bytes(60_000)])
        assert operator.hello().robot == "none"
        assert _resident_bytes(agent.process.pid) - before < 200e6
    context.destroy(linger=0)


def _resident_bytes(pid: int) -> int:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
