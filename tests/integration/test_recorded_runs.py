"""A simulated robot's run is recorded and replayed with the same results.

What goes wrong with the file never stops the run.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from base_station import cli
from base_station.kits import KitMaker
from base_station.landmarks_command import DEFAULT_MEMORY
from base_station.link import Link
from base_station.orders import Order
from base_station.recording.foxglove_file import NS_PER_S
from base_station.recording.reader import Recording
from base_station.recording.recorder import Recorder
from base_station.recording.replay import ReplayedRobot
from base_station.recording.replay_command import Replay, replay_run
from base_station.session import LinkSettings
from base_station.station import Station, StationSettings, Step
from base_station.types import Box
from tests.helpers import Program, Programs, numbered_picture, wait_until

LIMITED = """
import resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
from base_station.cli import main
sys.exit(main(sys.argv[2:]))
"""
"""The station, with files that may not grow beyond so many bytes: what a full disk does, without one."""


@pytest.fixture
def drawn(folder: Path) -> Path:
    """A video of a scene that moves a pixel per frame."""
    path = folder / "phone.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25, (320, 240))
    for number in range(40):
        writer.write(cv2.cvtColor(numbered_picture(number, 320, 240), cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def operate(port: int, path: Path) -> list[Step]:
    """Drive, record without loss, and change everything that an operator can change. Returns the steps."""
    steps: list[Step] = []
    orders = {
        15: [Order(kind="shadow", name="phase")],
        30: [Order.learn(Box(50, 40, 60, 50))],
        45: [Order(kind="tracker", name="z-shift"), Order(kind="behaviour", name="teleop")],
        60: [Order(kind="drive", forward=0.5, left=0.3), Order(kind="shadow")],
        75: [Order.learn(None), Order(kind="behaviour", name="idle")],
    }
    link = Link(LinkSettings(port=port), on_telemetry=lambda telemetry: recorder.note_telemetry(telemetry))
    make = KitMaker(memory=DEFAULT_MEMORY)
    settings = StationSettings(max_frames=110)
    run = {"options": {"tracker": "ztransform"}}
    recorder = Recorder(path, raw=True, run=run, hello=lambda: link.hello, driven=link.driven)

    def on_step(step: Step) -> None:
        steps.append(step)
        recorder.note_step(step)
        for order in orders.get(step.frame.number, []):
            station.post(order)

    station = Station(link, make("ztransform"), settings, keys=queue.SimpleQueue(), make=make, on_step=on_step)
    with contextlib.closing(station), link:
        station.run()
    recorder.close()
    return steps


def test_a_replay_gives_the_same_results_bit_for_bit(programs: Programs, port: int, folder: Path):
    programs.sim(port, "--rhythm", "lockstep", "--scenario", "leader")
    steps = operate(port, folder / "run.mcap")
    assert {step.tracker for step in steps} == {"ztransform", "z-shift"}
    assert {order.kind for step in steps for order in step.orders} == {
        "learn",
        "tracker",
        "shadow",
        "behaviour",
        "drive",
    }
    recorded = list(Recording(folder / "run.mcap"))
    assert [step.key[1] for step in recorded] == [step.frame.number for step in steps]
    assert cli.main(["replay", str(folder / "run.mcap"), "--same", "--json", str(folder / "same.json")]) == 0
    told = json.loads((folder / "same.json").read_text())
    assert [one["identical"] for one in told["against_recorded"]] == [True, True]
    assert told["against_recorded"][0]["frames"] == 110
    watch_the_replay(folder / "run.mcap", steps)
    # And it would be noticed if they were not the same.
    assert cli.main(["replay", str(folder / "run.mcap"), "--same", "--tracker", "phase"]) == 1


class Onlooker:
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.told: list[Step] = []
        self.stayed_after: list[int] = []

    def step(self, step: Step) -> None:
        self.told.append(step)

    def stay(self) -> None:
        self.stayed_after.append(len(self.told))


def watch_the_replay(path: Path, steps: list[Step]) -> None:
    """Whoever watches a replay is told of the same steps, and how the robot stood; at the end it may stay."""
    onlooker = Onlooker()
    robots = []

    def watch(stack: contextlib.ExitStack, robot: ReplayedRobot) -> Onlooker:
        stack.callback(lambda: robots.append((robot.state, robot.hello, robot.telemetry, robot.tracker)))
        return onlooker

    replay_run(Replay(source=path), Console(), watch)
    told = onlooker.told
    assert onlooker.stayed_after == [len(steps)]
    names = ("tracker", "shadow_tracker", "behaviour", "command", "learned", "orders", "pan_rad")
    for name in names:
        assert [getattr(step, name) for step in told] == [getattr(step, name) for step in steps], name
    ((state, hello, telemetry, tracker),) = robots
    assert state == "replay of run" and tracker is not None
    assert hello is not None and hello.rhythm == "lockstep" and hello.scenario is not None
    assert telemetry is not None and telemetry.wheels_measured is not None


def test_bands_of_rows_are_replayed_the_same(programs: Programs, port: int, folder: Path):
    run = folder / "run.mcap"
    programs.sim(port, "--rhythm", "lockstep", "--scenario", "clutter")
    options = ("--rows", "--target-rows", "24", "--max-frames", "150", "--record", str(run), "--record-raw")
    assert programs.station(port, "--no-status", *options, tracker="ztransform").exit_code(60) == 0
    frames = [step.frame for step in Recording(run)]
    assert len(frames) == 150
    assert any(frame is not None and not frame.is_whole for frame in frames)
    assert cli.main(["replay", str(run), "--same"]) == 0


def layered_pictures(folder: Path, count: int) -> Path:
    """What a camera sees that moves sideways past six walls, the lower the nearer: enough for a map."""
    chance = np.random.default_rng(1)
    walls = []
    for px_per_frame in (1.0, 1.6, 2.4, 3.2, 4.2, 5.2):
        wall = np.full((40, 960), 120, np.uint8)
        for x, y, side, gray in chance.integers((0, 0, 3, 0), (960, 40, 14, 256), (250, 4)).tolist():
            cv2.rectangle(wall, (x, y), (x + side, y + side), gray, -1)
        walls.append((wall, px_per_frame))
    folder.mkdir()
    for number in range(count):
        moves = [np.array([[1, 0, -step * number], [0, 1, 0]], np.float32) for _, step in walls]
        rows = [cv2.warpAffine(wall, move, (320, 40)) for (wall, _), move in zip(walls, moves, strict=True)]
        assert cv2.imwrite(str(folder / f"{number:03d}.png"), np.vstack(rows))
    return folder


def test_slam_repeats_itself_in_a_replay_with_every_pose(folder: Path):
    """In a replay it maps within the frame; live its mapper is another process, and its time is not repeated."""
    pictures, first = layered_pictures(folder / "walls", 25), folder / "first.mcap"
    assert cli.main(["replay", str(pictures), "--tracker", "slam", "--record", str(first)]) == 0
    steps = list(Recording(first))
    assert len(steps) == 25
    assert sum(step.result.cam_from_world is not None for step in steps) >= 10
    assert cli.main(["replay", str(first), "--same"]) == 0
    assert cli.main(["export", str(first), str(folder / "tum")]) == 0
    assert len((folder / "tum" / "trajectory.txt").read_text().splitlines()) >= 10


def test_recordings_are_compared_and_exported(
    programs: Programs, port: int, folder: Path, capsys: pytest.CaptureFixture[str]
):
    run = folder / "run.mcap"
    programs.sim(port, "--rhythm", "lockstep", "--scenario", "leader")
    station = programs.station(
        port, "--max-frames", "60", "--no-status", "--record", str(run), "--record-raw", tracker="ztransform"
    )
    assert station.exit_code(30) == 0
    assert "60 frames" in station.stderr
    picture, figures = folder / "plot.png", folder / "figures.json"
    arguments = ["--trackers", "ztransform,phase", "--picture", str(picture), "--json", str(figures)]
    assert cli.main(["compare", str(run), *arguments]) == 0
    told = json.loads(figures.read_text())
    assert told["against"] == "truth"
    assert [one["tracker"] for one in told["trackers"]] == ["ztransform", "phase", "recorded"]
    ours, _, recorded = told["trackers"]
    assert ours["bearing_error_deg_rms"] == recorded["bearing_error_deg_rms"] < 0.5
    assert told["against_recorded"]["ztransform"]["same"] == 60
    assert cv2.imread(str(picture)) is not None
    for form in ("tum", "euroc"):
        assert cli.main(["export", str(run), str(folder / form), "--format", form]) == 0
        exported_as_recorded(folder / form, Recording(run))
    assert cli.main(["export", str(run), str(folder / "tum")]) == 2
    assert "is there already" in capsys.readouterr().err


def exported_as_recorded(folder: Path, recording: Recording) -> None:
    """The field's reader finds pictures, times, camera and truth in the folder."""
    from base_station.evaluation.slam.sequence import read_gray, read_sequence

    sequence = read_sequence(folder)
    steps = list(recording)
    assert len(sequence) == len(steps) == 60
    assert np.allclose(sequence.times_s, [step.log_ns / NS_PER_S for step in steps], atol=1e-6)
    first = steps[0].frame
    assert first is not None
    assert np.array_equal(read_gray(sequence.pictures[0]), first.image)
    assert (sequence.camera.fx, sequence.camera.cx) == (first.camera.fx, first.camera.cx)
    assert sequence.truth is not None and len(sequence.truth) == 60
    truth = recording.truths[steps[-1].key]
    place = sequence.truth.world_from_cam[-1]
    assert np.allclose(place[:2, 3], truth.robot[:2], atol=1e-8)
    assert np.allclose(place[:2, 2], [np.cos(truth.robot[2]), np.sin(truth.robot[2])], atol=1e-7)


def test_a_video_of_ones_own_is_replayed(folder: Path, drawn: Path, capsys: pytest.CaptureFixture[str]):
    seen, results = folder / "seen.mp4", folder / "results.csv"
    arguments = ["--target", "100,60,100,100", "--video", str(seen), "--results", str(results)]
    assert cli.main(["replay", str(drawn), *arguments]) == 0
    assert "100.0 %" in capsys.readouterr().out
    rows = results.read_text().splitlines()
    assert len(rows) == 41
    assert float(rows[-1].split(",")[8]) == pytest.approx(39, abs=2)  # px to the right: one per frame
    capture = cv2.VideoCapture(str(seen))
    assert int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) == 40
    capture.release()


@pytest.mark.parametrize("command", [["replay"], ["compare", "--trackers", "phase"]], ids=" ".join)
def test_a_target_beside_the_picture_is_no_result(drawn: Path, capsys: pytest.CaptureFixture[str], command: list[str]):
    assert cli.main([*command, str(drawn), "--target", "5000,5000,40,40", "--max-frames", "3"]) == 1
    assert "was never learned" in capsys.readouterr().err


def test_a_video_that_the_disk_has_no_room_for_is_told(folder: Path, drawn: Path, capsys: pytest.CaptureFixture[str]):
    with small_disk(folder) as disk:
        (disk / "full").write_bytes(b"\0" * 390_000)
        assert cli.main(["replay", str(drawn), "--target", "100,60,100,100", "--video", str(disk / "seen.avi")]) == 1
    assert "is cut short" in capsys.readouterr().err


@pytest.mark.alone
def test_a_station_that_is_killed_leaves_all_but_the_last_second(programs: Programs, port: int, folder: Path):
    run = folder / "run.mcap"
    programs.sim(port)
    station = programs.station(port, "--no-status", "--record", str(run), "--record-raw")
    wait_until(lambda: run.exists() and run.stat().st_size > 500_000, 20, "half a megabyte of recording")
    time.sleep(1.2)
    killed_ns = time.time_ns()
    station.signal(signal.SIGKILL)
    station.process.wait()
    recording = Recording(run)
    steps = list(recording)
    assert "cut short" in recording.notes[0]
    assert (killed_ns - steps[-1].log_ns) / NS_PER_S <= 1.0
    assert [step.key[1] for step in steps] == list(range(steps[0].key[1], steps[0].key[1] + len(steps)))
    assert cli.main(["replay", str(run), "--same"]) == 0


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A file system of 400 kilobytes; where that cannot be had, the test is skipped."""
    at = folder / "disk"
    at.mkdir()
    mounted = (
        os.geteuid() == 0
        and not subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=400k", "zservo-test", str(at)], capture_output=True
        ).returncode
    )
    if not mounted:
        pytest.skip("no tmpfs can be mounted here: not root, or a container")
    try:
        yield at
    finally:
        subprocess.run(["umount", str(at)], check=True)


def check_full(station: Program, run: Path) -> None:
    assert station.exit_code(30) == 0
    said = station.stderr
    assert said.count("The recording ends here") == 1
    assert "The robot goes on" in said
    assert "ended early" in said
    assert re.search(r"frames\s+│ 60 ", said), "the robot did not go on"
    recording = Recording(run)
    frames = len(list(recording))
    assert 5 <= frames < 50
    assert cli.main(["replay", str(run), "--same"]) == 0


def test_a_full_disk_ends_the_recording_and_not_the_run(programs: Programs, port: int, folder: Path):
    programs.sim(port)
    with small_disk(folder) as disk:
        run = disk / "run.mcap"
        options = ("--no-status", "--max-frames", "60", "--record", str(run), "--record-raw")
        station = programs.station(port, *options)
        check_full(station, run)
        assert "No space left" in station.stderr


def test_a_file_that_may_not_grow_ends_the_recording_and_not_the_run(programs: Programs, port: int, folder: Path):
    programs.sim(port)
    run = folder / "run.mcap"
    options = ("--tracker", "phase", "--no-status", "--max-frames", "60", "--record", str(run), "--record-raw")
    station = programs.start(sys.executable, "-c", LIMITED, "400000", "run", "--port", str(port), *options)
    check_full(station, run)


def test_a_video_that_is_none_is_told_in_one_line(programs: Programs, tmp_path: Path):
    (tmp_path / "empty.mp4").touch()
    replay = programs.start(sys.executable, "-m", "base_station", "replay", str(tmp_path / "empty.mp4"))
    assert replay.exit_code(40) == 2
    assert replay.stderr.strip().endswith("is no video that can be read.") and "moov" not in replay.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "--record", "/proc/nowhere/run.mcap"], "cannot be written"),
        (["run", "--record", "there.mcap"], "is there already"),
        (["run", "--record-raw"], "--record-raw goes with --record"),
        (["replay", "there.mcap"], "is no MCAP file"),
        (["replay", "nowhere.mcap"], "There is no nowhere.mcap"),
        (["replay", "there.avi"], "is no video"),
        (["replay", "empty"], "has no pictures"),
        (["replay", "there.mcap", "--speed", "0"], "--speed is fast or"),
        (["replay", "empty", "--width", "3"], "--width must be"),
        (["compare", "there.mcap", "--trackers", ","], "--trackers: name"),
        (["compare", "pictures", "--trackers", "ztransfrom"], "did you mean ztransform"),
        (["replay", "pictures", "--same"], "--same needs a recording"),
        (["export", "there.mcap", "out"], "is no MCAP file"),
        (["export", "empty", "out"], "is a folder: name a FILE.mcap"),
        (["run", "--picture", "run.pdf"], "--picture: name a file that ends in .png, not run.pdf"),
        (["run", "--summary", "empty"], "--summary: empty is a folder"),
        (["replay", "pictures", "--picture", "seen.jpg"], "--picture: name a file that ends in .png"),
        (["compare", "pictures", "--trackers", "phase", "--json", "nowhere/a.json"], "there is no folder nowhere"),
    ],
    ids=lambda value: " ".join(value)[:40] if isinstance(value, list) else "",
)
def test_mistakes_are_said_before_anything_moves(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
):
    monkeypatch.chdir(folder)
    Path("there.mcap").write_bytes(b"precious")
    Path("there.avi").write_bytes(b"no video")
    Path("empty").mkdir()
    Path("pictures").mkdir()
    assert cv2.imwrite("pictures/1.png", numbered_picture(1))
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # `run` takes the signals, and pytest wants them back
    assert cli.main(arguments) == 2
    assert said in " ".join(capsys.readouterr().err.split())
    assert Path("there.mcap").read_bytes() == b"precious"
