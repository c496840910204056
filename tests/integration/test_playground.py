"""The Thymio's driver with the real Aseba programs: asebaplayground and asebamedulla on a bus of the agent's own."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers import Program, Programs, TelemetryLog, standing, wait_until
from tests.playground import agent_with_playground, needs_playground

STARTED = {"Xvfb", "dbus-daemon", "asebaplayground", "asebamedulla"}

pytestmark = [needs_playground, pytest.mark.alone]


@pytest.fixture
def playground(programs: Programs, port: int, folder: Path) -> Program:
    return agent_with_playground(programs, port, folder, "--size", "320x240")


def children(agent: Program) -> dict[str, int]:
    """The programs that the agent has started: name and process id."""
    pids = Path(f"/proc/{agent.process.pid}/task/{agent.process.pid}/children").read_text().split()
    return {name: int(pid) for pid in pids if (name := program_of(int(pid))) is not None}


def program_of(pid: int) -> str | None:
    """What this process runs; None when it has ended."""
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return None
    return Path(words[0].decode()).name or None


def all_gone(started: dict[str, int]) -> bool:
    return all(program_of(pid) != name for name, pid in started.items())


def test_it_follows_the_leader_and_leaves_nothing(
    programs: Programs, port: int, playground: Program, listen: Callable[[], TelemetryLog], folder: Path
) -> None:
    """15 s behind the leader: tracked, straight ahead, at the distance. SIGTERM ends every program and every file."""
    telemetry, summary = listen(), folder / "summary.json"
    started = children(playground)
    assert started.keys() == STARTED
    station = programs.station(port, "--duration", "15", "--summary", str(summary), tracker="ztransform")
    assert station.exit_code(60) == 0, station.stderr

    run = json.loads(summary.read_text())
    assert run["scenario"] == "leader" and run["seed"] == 3
    assert run["tracking_share"] >= 0.98
    assert run["bearing_error_deg_rms"] <= 3.0
    assert run["distance_error_rel_rms"] <= 0.12
    assert run["collisions"] == 0
    places = [message.truth.robot[:2] for message in telemetry.messages if message.truth is not None]
    assert math.dist(places[0], places[-1]) > 0.3, "the leader did not lead anywhere"
    telemetry.wait_for(standing, what="standing wheels without a station")

    playground.signal(signal.SIGTERM)
    assert playground.exit_code() == 0, playground.stderr
    assert "did not confirm" not in playground.stderr
    assert all_gone(started)
    assert [path.name for path in folder.iterdir()] == ["summary.json"]


def test_a_killed_agent_leaves_no_programs(playground: Program) -> None:
    """SIGKILL gives the agent no time for anything: the kernel ends what it has started."""
    started = children(playground)
    assert started.keys() == STARTED

    playground.signal(signal.SIGKILL)
    playground.exit_code()

    wait_until(lambda: all_gone(started), 3.0, "the end of the programs")


def test_a_dead_playground_is_an_error_in_words(playground: Program) -> None:
    """The world has gone: the agent ends, says which program it was, and takes the others along."""
    started = children(playground)

    os.kill(started["asebaplayground"], signal.SIGKILL)

    assert playground.exit_code() == 1
    assert "asebaplayground has ended" in playground.stderr
    assert all_gone(started)


def test_a_missing_program_is_named_with_its_package(folder: Path) -> None:
    """Nothing on the search path: what to install is said, in one line."""
    finished = subprocess.run(
        [sys.executable, "-m", "robot_agent", "--robot", "playground"],
        env=os.environ | {"PATH": str(folder)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert finished.returncode == 1
    assert "asebaplayground" in finished.stderr and "apt-get install aseba" in finished.stderr
    assert "Traceback" not in finished.stderr


@pytest.mark.parametrize("options", [["--rhythm", "lockstep"], ["--fault", "wheel_slip=0.2"], ["--camera", "sim"]])
def test_what_the_playground_cannot_do_is_wrong_usage(options: list[str]) -> None:
    """It keeps its own time, has no faults but noise, and comes with its camera."""
    command = [sys.executable, "-m", "robot_agent", "--robot", "playground", *options]
    finished = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert finished.returncode == 2, finished.stderr
    assert "playground" in finished.stderr.lower() and "Traceback" not in finished.stderr
