"""--rows with real processes, in clutter: fewer bytes, the same run; bands at their place; an older agent; refusals."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from protocol import Request
from tests.helpers import (
    Operator,
    Programs,
    RawStation,
    TelemetryLog,
    driving,
    free_ports,
    numbered_picture,
    read_exactly,
    standing,
    wait_until,
)

SECONDS = 6
MEASURED = ("loop_hz", "tracker_ms_p50", "frame_to_command_ms_p50", "frame_to_command_ms_p95", "agent_cpu_s",
            "station_cpu_s")  # fmt: skip
"""Times, rates and processor time: what two runs of the same may differ in."""
OLDER_AGENT = (
    "from robot_agent import answers; from robot_agent.cli import main\n"
    "new = answers.Answers._hello\n"
    "def hello(self):\n"
    "    said = new(self)\n"
    "    return answers.replace(said, capabilities=tuple(c for c in said.capabilities if c != 'rows'))\n"
    "answers.Answers._hello = hello\n"
    "raise SystemExit(main())\n"
)


def follow(programs: Programs, summary: Path, *options: str) -> dict:
    port = free_ports()
    agent = programs.sim(port, "--rhythm", "lockstep", "--scenario", "clutter", "--seed", "3")
    station = programs.station(
        port, "--duration", str(SECONDS), "--summary", str(summary), "--target-rows", "24", *options,
        tracker="ztransform",
    )  # fmt: skip
    assert station.exit_code(60) == 0, station.stderr
    agent.kill()
    return json.loads(summary.read_text())


def test_with_rows_the_run_is_the_same_and_the_bytes_are_fewer(programs: Programs, tmp_path: Path) -> None:
    """Among pictures like the target the right one is followed; and bands tell the tracker what whole frames tell it
    (the first two seconds are whole)."""
    whole = follow(programs, tmp_path / "whole.json")
    rows = follow(programs, tmp_path / "rows.json", "--rows")
    assert (whole["tracking_share"], whole["collisions"]) == (1.0, 0)
    assert whole["bearing_error_deg_rms"] <= 0.3 and whole["distance_error_rel_rms"] <= 0.03
    assert whole["frame_bytes_per_s"] == pytest.approx(160 * 120 * 30, rel=0.01)
    assert rows["frame_bytes_per_s"] < 0.75 * whole["frame_bytes_per_s"]
    for name in whole.keys() - {"frame_bytes_per_s", *MEASURED}:
        same = whole[name] if isinstance(whole[name], str) else pytest.approx(whole[name], abs=1e-5)
        assert rows[name] == same, name


def test_an_older_agent_is_named_in_one_sentence_and_sends_whole_frames(
    programs: Programs, port: int, tmp_path: Path
) -> None:
    agent = programs.start(
        sys.executable, "-c", OLDER_AGENT, "--size", "160x120", "--rhythm", "lockstep", "--port", str(port)
    )
    agent.says("serving robot", 20.0)
    summary = tmp_path / "summary.json"
    station = programs.station(port, "--rows", "--duration", "1", "--summary", str(summary), tracker="z-regions")
    assert station.exit_code(60) == 0, station.stderr
    assert station.stderr.count("--rows changes nothing") == 1
    assert "knows no bands of rows (an older agent)" in station.stderr
    assert json.loads(summary.read_text())["frame_bytes_per_s"] == pytest.approx(160 * 120 * 30, rel=0.05)


def test_rows_change_where_the_reply_says_and_only_for_the_station_served(
    programs: Programs, port: int, pictures: Path, operator: Operator
) -> None:
    """The raw stream with bands in it, byte for byte; what does not lie in the picture, or comes from another, changes
    nothing; a new connection begins with whole frames."""
    programs.replay(port, pictures, "--rhythm", "lockstep")
    picture = numbered_picture(1)

    def ask(rows: tuple[int, int] | None, station: str):
        return operator.ask(Request(action="rows", rows=rows, station=station))

    with RawStation(port, picture.size) as station:
        assert station.read_frame() == picture.tobytes()
        for rows in ((100, 121), (-1, 20), (50, 50), (60, 50), (0, 2**40)):
            refusal = ask(rows, station.address)
            assert not refusal.ok and f"rows {rows[0]}:{rows[1]} cannot be sent" in refusal.error
        other = ask((40, 56), "127.0.0.1:1")
        assert not other.ok and "only the station that gets the frames" in other.error
        number = 2
        for rows in ((40, 56), (8, 100), None):
            reply = ask(rows, station.address)
            assert (reply.ok, reply.frame) == (True, number)
            for _ in range(2):
                station.send(0, 0)
                sent = numbered_picture(number)[slice(*(rows or (0, 120)))]
                received = np.frombuffer(read_exactly(station.frames, sent.size), np.uint8)
                assert (received.reshape(sent.shape) == sent).all(), (rows, number)
                number += 1
        assert ask((40, 56), station.address).ok
    wait_until(lambda: not ask((40, 56), station.address).ok, 2.0, "its rows end with its connection")
    with RawStation(port, picture.size) as station:
        assert len(station.read_frame()) == picture.size


def test_asking_for_rows_is_no_command(
    programs: Programs, port: int, operator: Operator, listen: Callable[[], TelemetryLog]
) -> None:
    """A station that only asks for other rows, again and again, is one that has gone silent: the wheels stop."""
    programs.sim(port)
    telemetry = listen()
    with RawStation(port, 160 * 120) as station:

        def turning() -> bool:
            station.send(60, 60)
            station.drain()
            return telemetry.last is not None and driving(telemetry.last)

        wait_until(turning, 10.0, "wheels that turn")
        asked_s = time.monotonic()
        while time.monotonic() < asked_s + 1.0:
            station.drain()
            assert operator.ask(Request(action="rows", rows=(40, 60), station=station.address)).ok
        telemetry.wait_for(standing, 2.0, since_s=asked_s + 0.6, what="standing wheels")
