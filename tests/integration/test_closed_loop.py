"""The main job, with real processes: a robot follows what it sees, in both rhythms."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers import Programs, TelemetryLog, free_ports, standing

PROMISED = {
    "scenario", "tracker", "seed", "duration_s", "frames", "loop_hz", "tracker_ms_p50", "agent_cpu_s", "station_cpu_s",
    "collisions", "frame_to_command_ms_p50", "frame_to_command_ms_p95", "tracking_share", "bearing_error_deg_rms",
    "bearing_estimate_error_deg_rms", "distance_error_rel_rms", "final_distance_error_m", "final_bearing_error_deg",
}  # fmt: skip
"""What every summary must hold."""
MEASURED = {
    "loop_hz", "tracker_ms_p50", "frame_to_command_ms_p50", "frame_to_command_ms_p95", "agent_cpu_s", "station_cpu_s",
}  # fmt: skip
"""What differs between two runs of the same: times, rates and processor time. Nothing else may."""


SECONDS = 6


def run_leader(programs: Programs, summary: Path, *station_options: str, seed: int = 3) -> dict:
    """Follow the leader in lockstep; the summary."""
    port = free_ports()
    agent = programs.sim(port, "--rhythm", "lockstep", "--scenario", "leader", "--seed", str(seed))
    station = programs.station(
        port, "--duration", str(SECONDS), "--summary", str(summary), *station_options, tracker="ztransform"
    )
    assert station.exit_code(60) == 0, station.stderr
    agent.kill()
    return json.loads(summary.read_text())


def compared(summary: dict) -> dict:
    """What two runs of the same must have in common."""
    return {name: value for name, value in summary.items() if name not in MEASURED}


@pytest.fixture(scope="module")
def leader_run(tmp_path_factory: pytest.TempPathFactory) -> dict:
    """The summary of one run, with which others are compared."""
    programs = Programs()
    try:
        return run_leader(programs, tmp_path_factory.mktemp("run") / "summary.json")
    finally:
        programs.close()


def test_lockstep_follows_the_leader(leader_run: dict) -> None:
    """In lockstep the leader is tracked in every frame and followed closely; the summary tells all that it must."""
    assert leader_run.keys() >= PROMISED, PROMISED - leader_run.keys()
    assert leader_run["scenario"] == "leader" and leader_run["tracker"] == "ztransform" and leader_run["seed"] == 3
    assert leader_run["duration_s"] == pytest.approx(SECONDS, abs=1e-3)
    assert leader_run["frames"] == SECONDS * 30 + 1
    assert leader_run["tracking_share"] == 1.0
    assert leader_run["bearing_error_deg_rms"] <= 1.0
    assert leader_run["bearing_estimate_error_deg_rms"] <= 1.0
    assert leader_run["distance_error_rel_rms"] <= 0.05
    assert leader_run["collisions"] == 0
    for name in MEASURED:
        assert leader_run[name] > 0, name


def test_lockstep_tells_the_same_twice(programs: Programs, leader_run: dict, tmp_path: Path) -> None:
    """The same seed gives the same summary in all fields but times, rates and processor time."""
    again = run_leader(programs, tmp_path / "again.json")

    assert compared(again) == compared(leader_run)


def test_another_seed_is_another_run(programs: Programs, leader_run: dict, tmp_path: Path) -> None:
    """The seed reaches the simulation: the comparison of two runs is not one of two constants."""
    other = run_leader(programs, tmp_path / "other.json", seed=4)

    assert other["seed"] == 4
    assert other["final_distance_error_m"] != leader_run["final_distance_error_m"]


def test_shadow_tracker_leaves_the_drive_as_it_is(programs: Programs, leader_run: dict, tmp_path: Path) -> None:
    """--shadow phase: a second tracker on the same frames changes nothing in what the first one does."""
    both = run_leader(programs, tmp_path / "both.json", "--shadow", "phase")

    shadows = {name for name in both if name.startswith("shadow")}
    assert shadows and both["shadow_tracker"] == "phase" and both["shadow_tracking_share"] > 0.9
    assert {**compared(both), **dict.fromkeys(shadows)} == compared(leader_run)


def test_free_rhythm_follows_at_the_cameras_rate(
    programs: Programs, port: int, listen: Callable[[], TelemetryLog], tmp_path: Path
) -> None:
    """In free rhythm the leader is tracked at about 30 frames per second, and at the end the wheels stand."""
    programs.sim(port, "--scenario", "leader")
    telemetry = listen()
    summary = tmp_path / "summary.json"
    station = programs.station(port, "--duration", "8", "--summary", str(summary), tracker="ztransform")

    driven = telemetry.wait_for(lambda message: sum(message.wheels_asked) > 40, what="wheels that drive forward")
    assert station.exit_code(30) == 0, station.stderr
    told = json.loads(summary.read_text())
    assert told["tracking_share"] >= 0.98
    assert 20 <= told["loop_hz"] <= 31
    assert told["bearing_error_deg_rms"] <= 3.0
    assert told["collisions"] == 0
    telemetry.wait_for(standing, 2.0, since_s=driven.monotonic_s + 6, what="standing wheels at the end")
    places = [message.truth.robot[:2] for message in telemetry.messages if message.truth is not None]
    assert math.dist(places[0], places[-1]) > 0.05, "the robot went nowhere"


def test_unknown_shadow_is_wrong_usage(programs: Programs, port: int) -> None:
    """The name after --shadow is looked up too."""
    station = programs.station(port, "--shadow", "phaze")

    assert station.exit_code() == 2
    assert "phaze" in station.stderr and "phase" in station.stderr


TORCH = "base_station/trackers/example.py:TorchTracker"


def test_a_users_own_tracker_drives(
    programs: Programs, port: int, listen: Callable[[], TelemetryLog], tmp_path: Path
) -> None:
    """The worked example, named as file and class, turns the robot towards the brightest spot."""
    programs.sim(port, "--rhythm", "lockstep")
    telemetry = listen()
    results = tmp_path / "results.csv"
    station = programs.station(port, "--duration", "3", "--results", str(results), tracker=TORCH)

    assert station.exit_code(30) == 0, station.stderr
    rows = list(csv.DictReader(results.open()))
    tracked = [row for row in rows if row["state"] == "TRACKING"]
    assert len(rows) == 91
    assert len(tracked) > 45, "the torch was hardly ever seen"
    assert all(row["zoom"] == "" for row in rows), "a torch's distance is not known"
    assert any(message.wheels_asked != (0, 0) for message in telemetry.messages)


def test_a_users_tracker_that_fails_stops_the_robot(
    programs: Programs, port: int, listen: Callable[[], TelemetryLog], tmp_path: Path
) -> None:
    """An error in a user's update: the robot stands, one line says what failed and where, the exit code is 1."""
    broken = tmp_path / "broken.py"
    broken.write_text(
        "from base_station.types import TrackerResult, TrackingState\n"
        "class BrokenTracker:\n"
        "    seen = 0\n"
        "    def learn(self, frame, target): pass\n"
        "    def update(self, frame):\n"
        "        self.seen += 1\n"
        "        if self.seen == 30:\n"
        "            raise RuntimeError('the sun is in my eyes')\n"
        "        return TrackerResult(state=TrackingState.TRACKING, bearing_rad=0.3, zoom=0.9, confidence=1.0)\n"
        "    def close(self): pass\n"
    )
    programs.sim(port)
    telemetry = listen()
    station = programs.station(port, tracker=f"{broken}:BrokenTracker")

    assert station.exit_code(20) == 1
    (line,) = [line for line in station.stderr.splitlines() if "the sun is in my eyes" in line]
    assert "broken.py" in line and "line 8" in line and "RuntimeError" in line
    driven = telemetry.wait_for(lambda message: message.wheels_asked != (0, 0), what="wheels that turn")
    telemetry.wait_for(standing, 1.0, since_s=driven.monotonic_s + 0.5, what="standing wheels")


def test_a_users_tracker_that_returns_nothing_is_named(programs: Programs, port: int, tmp_path: Path) -> None:
    """The commonest slip of a first tracker: a forgotten return."""
    (tmp_path / "mine.py").write_text(
        "class Mine:\n"
        "    def learn(self, frame, target): pass\n"
        "    def update(self, frame): pass\n"
        "    def close(self): pass\n"
    )
    programs.sim(port)
    station = programs.station(port, "--duration", "5", tracker=f"{tmp_path / 'mine.py'}:Mine")
    assert station.exit_code() == 1
    assert "Mine.update returned NoneType, not a TrackerResult" in station.stderr
