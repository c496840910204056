"""Recordings of every layout, played by an agent to a station that writes one row per picture."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import cv2
import pytest

from tests.helpers import Programs, numbered_picture, write_pictures

COUNT = 25


def image_folder(folder: Path) -> Path:
    return write_pictures(folder, COUNT)


def otb(folder: Path) -> Path:
    write_pictures(folder / "img", COUNT)
    (folder / "groundtruth_rect.txt").write_text("40,40,30,30\n" * COUNT)
    return folder


def tum(folder: Path) -> Path:
    write_pictures(folder / "rgb", COUNT)
    lines = [f"{1000 + number / 30:.6f} rgb/{number:05d}.png\n" for number in range(1, COUNT + 1)]
    (folder / "rgb.txt").write_text("# color images\n# timestamp filename\n" + "".join(lines))
    return folder


def euroc(folder: Path) -> Path:
    write_pictures(folder / "mav0" / "cam0" / "data", COUNT)
    lines = [f"{10**18 + number * 50_000_000},{number:05d}.png\n" for number in range(1, COUNT + 1)]
    (folder / "mav0" / "cam0" / "data.csv").write_text("#timestamp [ns],filename\n" + "".join(lines))
    return folder


def video(folder: Path) -> Path:
    folder.mkdir()
    path = folder / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (160, 120))
    assert writer.isOpened()
    for number in range(1, COUNT + 1):
        writer.write(cv2.cvtColor(numbered_picture(number), cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


LAYOUTS = {layout.__name__: layout for layout in (image_folder, otb, tum, euroc, video)}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_picture_once_in_lockstep(programs: Programs, port: int, tmp_path: Path, layout: str) -> None:
    """In lockstep each picture of the recording arrives once, with its time; at its end both programs end, code 0."""
    source = LAYOUTS[layout](tmp_path / "recording")
    agent = programs.replay(port, source, "--rhythm", "lockstep")
    results = tmp_path / "results.csv"
    station = programs.station(
        port, "--behaviour", "idle", "--target", "60,40,40,40", "--results", str(results), tracker="ztransform"
    )

    assert station.exit_code() == 0, station.stderr
    assert agent.exit_code() == 0, agent.stderr
    rows = list(csv.DictReader(results.open()))
    assert [int(row["frame"]) for row in rows] == list(range(1, COUNT + 1))
    times_s = [float(row["time_s"]) for row in rows]
    period_s = 0.05 if layout == "euroc" else 1 / 30
    assert times_s == pytest.approx([number * period_s for number in range(COUNT)], abs=1e-3)
    tracked = [row for row in rows if row["state"] == "TRACKING"]
    assert len(tracked) > COUNT / 2, rows[-1]
    assert float(tracked[10]["x"]) - float(tracked[0]["x"]) == pytest.approx(
        int(tracked[10]["frame"]) - int(tracked[0]["frame"]), abs=1.5
    ), "the scene moves by a pixel per picture"


def test_recording_at_its_own_rate(programs: Programs, port: int, tmp_path: Path) -> None:
    """In free rhythm a recording runs at its own pace and ends by itself, too; pictures may be passed over, not lost
    without being counted."""
    recording = write_pictures(tmp_path / "recording", 45)
    agent = programs.replay(port, recording)
    results = tmp_path / "results.csv"
    station = programs.station(port, "--behaviour", "idle", "--results", str(results))

    assert station.exit_code() == 0, station.stderr
    assert agent.exit_code() == 0, agent.stderr
    rows = list(csv.DictReader(results.open()))
    assert 30 <= len(rows) <= 45
    times_s = [float(row["time_s"]) for row in rows]
    assert times_s == sorted(times_s)
    assert times_s[-1] - times_s[0] == pytest.approx(44 / 30, abs=0.2)


def test_pictures_of_two_sizes(programs: Programs, port: int, tmp_path: Path) -> None:
    """A recording whose pictures differ in size ends with a line that says what to do, and with --size it plays."""
    folder = write_pictures(tmp_path / "recording", 5)
    shutil.copy(write_pictures(tmp_path / "other", 1, 80, 60) / "00001.png", folder / "00006.png")
    agent = programs.replay(port, folder, "--rhythm", "lockstep")
    station = programs.station(port, "--behaviour", "idle")
    station.says("lost the robot")
    station.kill()
    assert agent.exit_code() == 1
    assert "--size" in agent.stderr and "80x60" in agent.stderr

    agent = programs.replay(port, folder, "--rhythm", "lockstep", "--size", "160x120")
    results = tmp_path / "results.csv"
    station = programs.station(port, "--behaviour", "idle", "--results", str(results))
    assert station.exit_code() == 0, station.stderr
    assert agent.exit_code() == 0
    assert len(list(csv.DictReader(results.open()))) == 6
