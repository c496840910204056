"""Robots announce themselves by real multicast DNS on the loopback, and are found there."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.helpers import Program, Programs, RawStation, free_ports

pytest.importorskip("zeroconf")


def robots(programs: Programs, *options: str) -> Program:
    return programs.start(sys.executable, "-m", "base_station", "robots", *options)


def multicast_works() -> bool:
    """Whether a datagram to the mDNS group comes back on the loopback."""
    script = """
import socket
group = socket.inet_aton("224.0.0.251") + socket.inet_aton("127.0.0.1")
listening, sending = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
listening.bind(("", 0))
listening.settimeout(1)
listening.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
sending.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
sending.sendto(b"x", ("224.0.0.251", listening.getsockname()[1]))
listening.recv(1)
"""
    return subprocess.run([sys.executable, "-c", script], capture_output=True, check=False).returncode == 0


needs_multicast = pytest.mark.skipif(not multicast_works(), reason="no multicast on this machine's loopback")


@needs_multicast
def test_robots_are_found_told_apart_and_gone_when_they_end(programs: Programs, pictures) -> None:
    """Two agents with the same name on one machine; a station at one of them; then both end."""
    ports = [free_ports(), free_ports()]
    agents = [programs.replay(port, pictures, "--announce") for port in ports]
    for agent in agents:
        agent.says("announced as", 10.0)
    with RawStation(ports[0], 160 * 120) as station:
        station.read_frame()
        listing = robots(programs)
        assert listing.exit_code() == 0
    rows = {int(line.split()[2]): line for line in listing.stdout.splitlines()[1:] if line}
    assert set(ports) <= set(rows), listing.stdout
    assert "busy with 127.0.0.1:" in rows[ports[0]]
    assert rows[ports[1]].endswith("free")
    assert all("127.0.0.1" in rows[port] and "ReplayCamera" in rows[port] for port in ports)
    for agent in agents:
        agent.signal(15)
        assert agent.exit_code() == 0
    gone = robots(programs, "--seconds", "1")
    gone.exit_code()
    assert not {str(port) for port in ports} & set(gone.stdout.split())


@needs_multicast
def test_an_agent_that_listens_on_the_loopback_is_silent(programs: Programs, pictures) -> None:
    port = free_ports()
    agent = programs.replay(port, pictures)
    listing = robots(programs, "--seconds", "1")
    listing.exit_code()
    assert str(port) not in listing.stdout.split()
    assert "announced" not in agent.stderr


def test_nothing_found_says_how_to_go_on(programs: Programs) -> None:
    """In a network namespace of its own nobody else's robot can be found; without any network neither."""
    if subprocess.run(["unshare", "-n", "ip", "link", "set", "lo", "up"], capture_output=True, check=False).returncode:
        pytest.skip("no network namespaces here (needs root)")
    command = f"{sys.executable} -m base_station robots --seconds 0.5"
    alone = programs.start("unshare", "-n", "sh", "-c", f"ip link set lo up && exec {command}")
    offline = programs.start("unshare", "-n", "sh", "-c", f"exec {command}")
    assert alone.exit_code() == offline.exit_code() == 1
    assert "No robot announces itself here." in alone.stderr
    assert "The network cannot be listened to" in offline.stderr
    assert "--host" in alone.stderr
    assert "--host" in offline.stderr
