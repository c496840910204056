"""The pan-tilt with real programs: asked on the control port, told in telemetry, centred at the end, followed with."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from protocol import Command, Request
from tests.helpers import Operator, Programs, RawStation, TelemetryLog, free_ports, wait_until

SECONDS = 6


def test_look_turns_the_simulated_camera_within_reach_and_telemetry_tells_where_each_frame_looked(
    programs: Programs, port: int, operator: Operator, listen: Callable[[], TelemetryLog]
) -> None:
    """In lockstep, so that each frame's angle is known: 0.5 rad at 300 degrees a second and 30 ms of lag."""
    programs.sim(port, "--rhythm", "lockstep", "--pan-tilt", "sim")
    hello = operator.hello()
    assert "pan-tilt" in hello.capabilities
    assert hello.pan_tilt is not None
    assert [math.degrees(angle) for angle in (*hello.pan_tilt.pan_rad, *hello.pan_tilt.tilt_rad)] == pytest.approx(
        [-90, 90, -55, 55]
    )
    for out_of_reach in ({"pan_rad": 1.6}, {"tilt_rad": -1.0}, {"pan_rad": 1e300}):
        refused = operator.ask(Request(action="look", **out_of_reach))
        assert not refused.ok and "out of reach" in refused.error and "1.571" in refused.error
    telemetry = listen()
    with RawStation(port, 160 * 120) as station:
        for number in range(1, 11):
            station.read_frame()
            if number == 3:
                assert operator.ask(Request(action="look", pan_rad=0.5, tilt_rad=-0.1)).ok
            station.commands.sendall(bytes(Command(0, 0)))
        telemetry.wait_for(lambda message: message.frame is not None and message.frame.number == 10, what="frame 10")
        stamps = {message.frame.number: message.frame for message in telemetry.messages if message.frame is not None}
    pans = [stamps[number].pan_rad for number in range(1, 11)]
    assert pans[:3] == [0.0, 0.0, 0.0]
    assert pans[3] == pytest.approx(math.radians(300) * (1 / 30 - 0.03), abs=1e-6)
    assert pans[4] - pans[3] == pytest.approx(math.radians(10), abs=1e-6)
    assert pans[-1] == pytest.approx(0.5) and stamps[10].tilt_rad == pytest.approx(-0.1)


def test_a_fixed_camera_says_so_and_pan_against_it_is_one_sentence(
    programs: Programs, port: int, operator: Operator
) -> None:
    programs.sim(port)
    hello = operator.hello()
    assert "pan-tilt" not in hello.capabilities and hello.pan_tilt is None
    reply = operator.ask(Request(action="look", pan_rad=0.1))
    assert not reply.ok and "no pan-tilt" in reply.error

    station = programs.station(port, "--pan", "--no-status")
    assert station.exit_code() == 2
    (line,) = [line for line in station.stderr.splitlines() if line.startswith("base-station: ")]
    assert "cannot be turned" in line and "--pan-tilt sim" in line


def test_pan_goes_with_follow_only(programs: Programs, port: int) -> None:
    station = programs.station(port, "--pan", "--behaviour", "teleop")
    assert station.exit_code() == 2
    assert "--pan goes with --behaviour follow" in station.stderr


def test_servos_are_centred_when_the_agent_ends(
    programs: Programs, port: int, operator: Operator, pictures: Path, tmp_path: Path
) -> None:
    """A real FIFO in place of ServoBlaster's: SIGTERM while the camera looks aside leaves it straight ahead. And a
    device that is not there is one sentence, exit code 1."""
    fifo = tmp_path / "servoblaster"
    options = ("--pan-tilt", "servoblaster", "--servo-device", str(fifo), "--pan-servo", "P1-7", "--tilt-servo", "3")
    replay = ("--robot", "none", "--camera", "replay", "--source", str(pictures), "--port", str(port))
    early = programs.start(sys.executable, "-m", "robot_agent", *replay, *options)
    assert early.exit_code() == 1
    assert f"There is no servo device {fifo}" in early.stderr.splitlines()[-1]

    os.mkfifo(fifo)
    reader = os.open(fifo, os.O_RDWR | os.O_NONBLOCK)
    lines: list[str] = []

    def read() -> list[str]:
        with contextlib.suppress(BlockingIOError):
            lines.extend(os.read(reader, 65536).decode().splitlines())
        return lines

    agent = programs.agent(port, *replay[:-2], *options)
    wait_until(lambda: {"P1-7=1500us", "3=1500us"} <= set(read()), 2.0, "the centre at the start")
    begun_s = time.monotonic()
    assert operator.ask(Request(action="look", pan_rad=math.radians(90), tilt_rad=math.radians(55))).ok
    assert time.monotonic() - begun_s < 0.5
    wait_until(lambda: {"P1-7=2400us", "3=2050us"} <= set(read()), 2.0, "the limits")
    agent.signal(signal.SIGTERM)
    assert agent.exit_code() == 0
    assert [line for line in read() if line.startswith("P1-7")][-1] == "P1-7=1500us"
    assert [line for line in read() if line.startswith("3=")][-1] == "3=1500us"
    os.close(reader)


def follow(programs: Programs, summary: Path, scenario: str, *, pan: bool) -> dict:
    """Lockstep, so that two runs of the same are the same."""
    port = free_ports()
    agent = programs.sim(
        port, "--rhythm", "lockstep", "--scenario", scenario, "--seed", "3", *(["--pan-tilt", "sim"] if pan else [])
    )
    station = programs.station(
        port, "--duration", str(SECONDS), "--summary", str(summary), *(["--pan"] if pan else []), tracker="ztransform"
    )
    assert station.exit_code(60) == 0, station.stderr
    assert "turned" not in station.stderr and "does not turn" not in station.stderr
    agent.kill()
    return json.loads(summary.read_text())


TIMES = {
    "loop_hz", "tracker_ms_p50", "frame_to_command_ms_p50", "frame_to_command_ms_p95", "agent_cpu_s", "station_cpu_s",
}  # fmt: skip


def test_following_with_the_pan_is_as_good_and_the_same_twice(programs: Programs, tmp_path: Path) -> None:
    once, again = (follow(programs, tmp_path / f"{run}.json", "leader", pan=True) for run in ("once", "again"))
    assert once["tracking_share"] == 1.0 and once["collisions"] == 0
    assert once["bearing_error_deg_rms"] <= 1.0 and once["camera_error_deg_rms"] <= 1.0
    assert once["bearing_estimate_error_deg_rms"] <= 1.0
    assert once["distance_error_rel_rms"] <= 0.05
    assert {name: once[name] for name in once.keys() - TIMES} == {name: again[name] for name in again.keys() - TIMES}


def test_on_a_turntable_the_camera_keeps_the_place_in_the_middle_and_the_sum_of_angles_is_true(
    programs: Programs, tmp_path: Path
) -> None:
    """The body is held and turned by 15 degrees and more; only the camera can hold against it."""
    held = follow(programs, tmp_path / "pan.json", "turn", pan=True)
    assert held["tracking_share"] == 1.0
    assert held["camera_error_deg_rms"] <= 1.0
    assert held["bearing_estimate_error_deg_rms"] <= 0.5
