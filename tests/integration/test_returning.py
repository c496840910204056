"""Back to a remembered pose, with real processes: from aside, and by a landmark alone; and the landmarks command."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from protocol import Truth
from tests.base_station.trackers.conftest import World
from tests.helpers import Program, Programs, TelemetryLog

SIZE = ("--size", "320x240", "--rhythm", "lockstep")


def landmarks(programs: Programs, *arguments: str | Path, code: int = 0) -> Program:
    """base-station landmarks, which ends with this code."""
    program = programs.start(sys.executable, "-m", "base_station", "landmarks", *map(str, arguments))
    assert program.exit_code(40) == code, program.stderr
    return program


def last_truth(telemetry: TelemetryLog) -> Truth:
    """Where things were in the newest frame."""
    return next(message.truth for message in reversed(telemetry.messages) if message.truth is not None)


def test_from_aside_it_comes_back_to_the_full_pose(programs: Programs, port: int, tmp_path: Path) -> None:
    """Scenario arc: learned from 0.5 m, set down 1 m away and 20 degrees round. The bars of the project."""
    programs.sim(port, "--scenario", "arc", "--seed", "1", *SIZE)
    summary = tmp_path / "summary.json"
    station = programs.station(
        port, "--behaviour", "goto", "--duration", "26", "--summary", str(summary), "--target-width-m", "0.207",
        tracker="ztransform",
    )  # fmt: skip

    assert station.exit_code(90) == 0, station.stderr
    told = json.loads(summary.read_text())
    assert told["final_lateral_error_m"] <= 0.04
    assert told["final_heading_error_deg"] <= 3.0
    assert told["final_distance_error_m"] <= 0.01
    assert told["tracking_share"] >= 0.99
    assert told["view_angle_estimate_error_deg_rms"] <= 3.0
    assert told["range_estimate_error_rel_rms"] <= 0.03
    assert told["collisions"] == 0
    assert "there: where the target was learned" in station.stderr


def test_it_returns_by_the_landmark_alone(
    programs: Programs, port: int, listen: Callable[[], TelemetryLog], tmp_path: Path
) -> None:
    """The poster is learned into a file by one program; another one, after the robot was put away, goes back."""
    memory = tmp_path / "memory.npz"
    programs.sim(port, "--scenario", "poster", "--seed", "2", *SIZE)
    telemetry = listen()
    learned = landmarks(programs, "learn", "poster", "--port", port, "--memory", memory, "--learned-distance-m", "0.5")
    assert "learned 'poster'" in learned.stdout
    away = programs.station(port, "--behaviour", "idle", "--duration", "2.5")
    assert away.exit_code(30) == 0, away.stderr
    seen = json.loads(landmarks(programs, "find", "--port", port, "--memory", memory, "--json").stdout)
    (sighting,) = seen["seen"]
    truth = last_truth(telemetry)
    assert sighting["name"] == "poster"
    assert sighting["range_m"] == pytest.approx(truth.range_m, rel=0.04) == pytest.approx(1.0, abs=0.05)
    assert sighting["bearing_deg"] == pytest.approx(math.degrees(truth.bearing_rad), abs=0.6)

    station = programs.station(
        port, "--behaviour", "goto", "--landmark", "poster", "--memory", str(memory), "--until-there",
        "--duration", "30", tracker="ztransform",
    )  # fmt: skip
    assert station.exit_code(60) == 0, station.stderr
    there = last_truth(telemetry)
    assert there.range_m == pytest.approx(0.5, abs=0.02)
    assert math.degrees(there.bearing_rad) == pytest.approx(0, abs=1)
    assert abs(math.remainder(there.robot[2] - there.target[2], 2 * math.pi)) < math.radians(4)


def test_a_landmark_that_is_nowhere_is_given_up(programs: Programs, port: int, tmp_path: Path) -> None:
    """It turns once, stands, and the program ends with code 1 and the reason."""
    picture, memory = tmp_path / "elsewhere.png", tmp_path / "memory.npz"
    cv2.imwrite(str(picture), World(7, 320, 240).view())
    landmarks(programs, "learn", "elsewhere", "--memory", memory, "--image", picture, "--target", "100,80,120,90")
    programs.sim(port, "--scenario", "poster", *SIZE)
    station = programs.station(
        port, "--behaviour", "goto", "--landmark", "elsewhere", "--memory", str(memory), "--until-there",
        tracker="ztransform",
    )  # fmt: skip
    assert station.exit_code(60) == 1
    assert "Not there: gave up after a whole turn: landmark 'elsewhere' is not in view" in station.stderr


def test_the_command_learns_lists_finds_and_forgets(programs: Programs, tmp_path: Path) -> None:
    """From pictures in files."""
    world, memory = World(3), tmp_path / "memory.npz"
    cv2.imwrite(str(tmp_path / "learned.png"), world.view())
    cv2.imwrite(str(tmp_path / "now.jpg"), world.view(30, 0, 1.3, gain=0.6))
    landmarks(
        programs, "learn", "door", "--memory", memory, "--image", tmp_path / "learned.png",
        "--target", "250,180,140,120", "--target-width-m", "0.3",
    )  # fmt: skip
    landmarks(programs, "learn", "room", "--memory", memory, "--image", tmp_path / "learned.png")
    listed = landmarks(programs, "list", "--memory", memory).stdout.splitlines()
    assert len(listed) == 2 and "door" in listed[0] and "140x120" in listed[0] and "a place" in listed[1]

    found = landmarks(programs, "find", "--memory", memory, "--image", tmp_path / "now.jpg").stdout
    (door,) = [line for line in found.splitlines() if line.startswith("door")]
    assert "zoom 1.3" in door or "zoom 1.29" in door
    assert "range 0.8" in door

    landmarks(programs, "forget", "door", "--memory", memory)
    assert [row["name"] for row in json.loads(landmarks(programs, "list", "--memory", memory, "--json").stdout)] == [
        "room"
    ]


def test_what_a_person_does_wrong_with_landmarks(programs: Programs, port: int, tmp_path: Path) -> None:
    """One clear line, exit code 2 or 1, no traceback."""
    memory, blank, broken = tmp_path / "memory.npz", tmp_path / "blank.png", tmp_path / "broken.npz"
    picture = tmp_path / "learned.png"
    cv2.imwrite(str(picture), World(3).view())
    cv2.imwrite(str(blank), np.full((480, 640), 99, np.uint8))
    broken.write_bytes(b"no landmarks")
    landmarks(programs, "learn", "door", "--memory", memory, "--image", picture)
    said = landmarks(programs, "learn", "door", "--memory", memory, "--image", picture)
    assert "replaced, 'door'" in said.stdout and "holds 1 landmark" in said.stdout
    box = ("--target", "250,180,140,120")

    def run(*options: str | Path) -> tuple[str, ...]:
        return ("run", "--port", str(port), *map(str, options))

    mistakes: list[tuple[tuple[str | Path, ...], int, str]] = [
        (("landmarks", "list", "--memory", tmp_path / "no.npz"), 2, "no.npz cannot be read"),
        (("landmarks", "list", "--memory", broken), 1, "broken.npz is no file of landmarks"),
        (("landmarks", "forget", "dor", "--memory", memory), 2, "no landmark 'dor'"),
        (("landmarks", "learn", "x", "--memory", memory, "--image", blank, *box), 1, "featureless"),
        (("landmarks", "learn", "x", "--memory", memory, "--image", tmp_path / "no.png"), 2, "There is no picture"),
        (("landmarks", "learn", "x", "--memory", memory, "--image", broken), 2, "is no picture"),
        (("landmarks", "learn", "x", "--memory", memory, "--image", picture, "--target", "1,2"), 2, "x,y,width,height"),
        (("landmarks", "learn", "x", "--image", picture, "--target-width-m", "1"), 2, "needs a target"),
        (("landmarks", "find", "--memory", memory, "--image", picture, "--fov-deg", "200"), 2, "--fov-deg must be"),
        (run("--landmark", "x", "--memory", memory), 2, "no landmark 'x'"),
        (run("--landmark", "door", "--memory", memory, "--target", "1,2,3,4"), 2, "leave out --target"),
        (run("--landmark", "door", "--memory", memory, "--tracker", "phase"), 2, "leave out --tracker"),
        (run("--target-width-m", "-1"), 2, "--target-width-m must be positive"),
        (run("--target-width-m", "1", "--learned-distance-m", "1"), 2, "one tells the other"),
    ]
    started = [programs.start(sys.executable, "-m", "base_station", *map(str, options)) for options, _, _ in mistakes]
    for program, (options, code, said) in zip(started, mistakes, strict=True):
        assert program.exit_code(60) == code, (options, program.stderr)
        assert said in " ".join(program.stderr.split()), options
