"""What a run leaves behind and shows: the CSV of results, the words of the status line, the table at the end."""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from base_station.display import describe, summary_table
from base_station.errors import StationError
from base_station.evaluation.closed_loop import LoopLog
from base_station.evaluation.overlap import read_results
from base_station.geometry import PinholeCamera
from base_station.results import COLUMNS, ResultsFile
from base_station.station import Step
from base_station.types import Box, Frame, TrackerResult, TrackingState
from protocol import Command

SEEN = TrackerResult(
    state=TrackingState.TRACKING,
    shift_px=-12.5,
    shift_y_px=3.25,
    bearing_rad=math.radians(2.5),
    elevation_rad=math.radians(-1.0),
    zoom=1.125,
    confidence=0.875,
    box=Box(10.5, 20.25, 40, 30),
)
LOST = TrackerResult(state=TrackingState.LOST, reason='dark, or "gone"\nperhaps')


def step(number: int, result: TrackerResult, command: Command) -> Step:
    frame = Frame(
        image=np.zeros((6, 8), np.uint8), number=number, time_s=number / 30, camera=PinholeCamera.with_fov(8, 6)
    )
    return Step(
        frame=frame,
        result=result,
        shadow=None,
        command=command,
        learned=False,
        tracker_s=0,
        frame_to_command_s=None,
        tracker="ztransform",
        behaviour="follow",
    )


def test_each_frame_is_a_row_with_what_the_tracker_could_tell_and_the_command(tmp_path):
    results = ResultsFile(tmp_path / "r.csv")
    results.write(step(1, SEEN, Command(-5, 6)))
    results.write(step(2, LOST, Command(0, 0)))
    results.close()
    with (tmp_path / "r.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert rows[0] == {
        "frame": "1", "time_s": "0.033333", "state": "TRACKING", "reason": "",
        "x": "10.5000", "y": "20.2500", "width": "40.0000", "height": "30.0000",
        "shift_px": "-12.5000", "shift_y_px": "3.2500", "bearing_deg": "2.5000", "elevation_deg": "-1.0000",
        "zoom": "1.1250", "confidence": "0.8750", "left": "-5", "right": "6",
        "shadow_state": "", "shadow_bearing_deg": "", "shadow_zoom": "", "shadow_confidence": "", "pan_deg": "",
            "compass_deg": "",
            "view_angle_deg": "", "range_m": "",
    }  # fmt: skip
    assert rows[1]["state"] == "LOST"
    assert rows[1]["reason"] == LOST.reason
    assert [rows[1][name] for name in COLUMNS[4:13]] == [""] * 9
    boxes = read_results(tmp_path / "r.csv")
    assert boxes[0].tolist() == [10.5, 20.25, 40, 30]
    assert np.isnan(boxes[1]).all()


def test_results_that_lack_frames_are_not_scored_against_the_wrong_rows(tmp_path):
    results = ResultsFile(tmp_path / "r.csv")
    results.write(step(1, SEEN, Command(0, 0)))
    results.write(step(3, SEEN, Command(0, 0)))
    results.close()
    with pytest.raises(StationError, match="lockstep"):
        read_results(tmp_path / "r.csv")


def test_a_path_that_cannot_be_written_is_told_before_the_robot_moves(tmp_path):
    for path in (tmp_path, tmp_path / "nowhere" / "r.csv"):
        with pytest.raises(StationError, match="cannot be written") as caught:
            ResultsFile(path)
        assert caught.value.usage


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (SEEN, "bearing  +2.50°  zoom 1.125  confidence 0.88"),
        (TrackerResult(state=TrackingState.TRACKING, confidence=0.5), "confidence 0.50"),
        (
            TrackerResult(state=TrackingState.TRACKING, bearing_rad=math.radians(-31.25), confidence=1.0),
            "bearing -31.25°  confidence 1.00",
        ),
        (TrackerResult(state=TrackingState.LOST, reason="too dark"), "- too dark"),
        (TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet"), "- nothing learned yet"),
    ],
)
def test_a_result_is_described_by_what_it_has(result, words):
    assert describe(result) == words


def test_the_table_at_the_end_leaves_out_what_does_not_apply():
    bare = LoopLog(tracker="ztransform", behaviour="follow").summary(scenario=None, seed=None, rhythm=None)
    summary = dataclasses.replace(bare, frames=900, tracking_share=0.9956, final_distance_error_m=0.0042)
    console = Console(width=100, record=True, quiet=False, file=None, force_terminal=False)
    with console.capture() as captured:
        console.print(summary_table(summary))
    text = captured.get()
    for expected in ("ztransform · follow", "900", "99.6 %", "0.004 m"):
        assert expected in text
    assert "LOST" not in text
    assert "None" not in text
    assert "collisions" not in text


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has a device that is always full")
def test_a_full_disk_ends_the_file_and_not_the_run(caplog):
    rows = ResultsFile(Path("/dev/full"))
    for number in range(2000):  # more than is kept before it is written
        rows.write(step(number, TrackerResult(state=TrackingState.LOST, reason="x" * 80), Command(0, 0)))
    rows.close()
    said = [record.message for record in caplog.records]
    assert len(said) == 1 and "/dev/full" in said[0] and "No space left" in said[0]
