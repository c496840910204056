"""SLAM in the loop, with real processes, in lockstep: a stretch of the furnished room's lap, and the turntable."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers import Programs

pytest.importorskip("pycolmap")
pytest.importorskip("gtsam")
pytestmark = pytest.mark.alone  # the mapper needs the second core


def drive(programs: Programs, port: int, folder: Path, scenario: str, seconds: int, *options: str) -> dict:
    """The summary of a run."""
    programs.sim(port, "--scenario", scenario, "--size", "320x240", "--fps", "15", "--rhythm", "lockstep")
    summary = folder / "summary.json"
    station = programs.station(
        port, "--duration", str(seconds), "--summary", str(summary), *options, tracker="slam"
    )  # fmt: skip
    assert station.exit_code(120) == 0, station.stderr
    return json.loads(summary.read_text())


def test_driving_the_course_it_maps_where_it_truly_was(programs: Programs, port: int, tmp_path: Path) -> None:
    """Ten seconds by wheel odometry along the waypoints that hello tells: a metre, mapped to some centimetres."""
    told = drive(programs, port, tmp_path, "loop", 11, "--behaviour", "route", "--shadow", "ztransform")
    assert told["behaviour"] == "route" and told["laps"] == 0 and told["collisions"] == 0
    assert 0.9 <= told["path_m"] <= 1.3
    assert told["keyframes"] >= 3 and told["maps"] == 1 and told["loops_closed"] == 0
    assert told["trajectory_share"] >= 0.6  # in lockstep SLAM waits for its mapper; 0.8 of 13 s when this was written
    assert 0 < told["ate_rmse_m"] <= 0.05
    assert told["compass_share"] >= 0.95 and told["compass_error_deg_rms"] <= 2.0
    assert told["shadow_frames_tracked"] > 20
