"""--allow: who may connect, on all four ports."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from protocol import Request, encode
from tests.helpers import Operator, Programs, RawStation, closed_by_peer, connect, wait_until

ALLOWED, STRANGER = "127.0.0.2", "127.0.0.1"


@pytest.fixture
def allowed_operator(port: int) -> Iterator[Operator]:
    client = Operator(port, source=ALLOWED)
    yield client
    client.close()


def test_stranger_on_the_raw_ports(programs: Programs, port: int, pictures: Path) -> None:
    """An address that is not allowed is closed at once on 31440 and 31441, and the agent says who it was."""
    agent = programs.replay(port, pictures, "--allow", f"{ALLOWED}/32")
    for number in (port, port + 1):
        with connect(number, source=STRANGER) as stranger:
            assert closed_by_peer(stranger)
            name = "{}:{}".format(*stranger.getsockname())
        agent.says(f"{name} turned away: not in --allow")


def test_stranger_does_not_disturb(programs: Programs, port: int, pictures: Path, allowed_operator: Operator) -> None:
    """An allowed address gets frames, gives commands and is answered, also while strangers knock."""
    programs.replay(port, pictures, "--allow", f"{ALLOWED}/32")
    with RawStation(port, 160 * 120, source=ALLOWED) as station:
        station.read_frame()
        with connect(port, source=STRANGER) as stranger:
            assert closed_by_peer(stranger)
        station.send(10, 10)
        station.read_frame()
        assert allowed_operator.hello().busy_with == station.address


def test_stranger_on_the_control_port(
    programs: Programs, port: int, pictures: Path, operator: Operator, allowed_operator: Operator
) -> None:
    """A stranger's emergency stop or hello is not answered and has no effect; that of an allowed address is."""
    agent = programs.replay(port, pictures, "--allow", f"{ALLOWED}/32")
    assert operator.send_raw(encode(Request(action="stop")), timeout_s=0.5) is None
    agent.says("may not connect (--allow)")
    assert allowed_operator.hello().busy_with is None
    assert "emergency stop" not in agent.stderr


def test_stranger_hears_no_telemetry(programs: Programs, port: int, pictures: Path) -> None:
    """Telemetry goes to allowed addresses only."""
    programs.replay(port, pictures, "--allow", f"{ALLOWED}/32")
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    heard = {}
    for source in (ALLOWED, STRANGER):
        heard[source] = context.socket(zmq.SUB)
        heard[source].subscribe(b"")
        heard[source].connect(f"tcp://{source}:0;127.0.0.1:{port + 2}")
    try:
        wait_until(lambda: heard[ALLOWED].poll(10), 5.0, "telemetry for the allowed address")
        time.sleep(0.5)
        assert not heard[STRANGER].poll(0)
    finally:
        context.destroy(linger=0)


def test_several_networks(programs: Programs, port: int, pictures: Path) -> None:
    """--allow may be given more than once, with networks and single addresses."""
    programs.replay(port, pictures, "--allow", "10.0.0.0/8", "--allow", "127.0.0.2")
    with RawStation(port, 160 * 120, source="127.0.0.2") as station:
        assert len(station.read_frame()) == 160 * 120
    with connect(port, source="127.0.0.3") as stranger:
        assert closed_by_peer(stranger)


def test_a_station_that_is_refused_says_so_and_ends_when_told(programs: Programs, port: int, pictures: Path) -> None:
    """Its question is dropped by ZMQ before it is sent: that must not hold the station for ever."""
    programs.replay(port, pictures, "--allow", "10.0.0.0/8")
    for _ in range(3):
        station = programs.station(port, "--behaviour", "idle", "--no-status")
        station.says("--allow", 15.0)
        station.signal(signal.SIGTERM)
        assert station.exit_code(10.0) == 1, "no frame ever came"
