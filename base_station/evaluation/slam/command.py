"""base-station evaluate slam: a SLAM system on a recorded sequence with true poses."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

import cv2
import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from threadpoolctl import threadpool_limits

from base_station.errors import StationError
from base_station.evaluation.benchmark_report import machine
from base_station.evaluation.slam.map_files import write_colmap, write_ply
from base_station.evaluation.slam.plots import plot_map, plot_trajectory
from base_station.evaluation.slam.run import Outcome, PictureOutcome, Slam, SlamRun, figures, show
from base_station.evaluation.slam.sequence import SlamSequence, read_sequence
from base_station.evaluation.slam.trajectory import Trajectory, write_euroc, write_tum
from base_station.evaluation.slam.trajectory_errors import LEAST_POSES, MOST_APART_S, associate
from base_station.evaluation.thesis.plotting import require
from base_station.evaluation.tracking_command import check_options, plain_console
from base_station.output_files import check_output, write_json
from base_station.trackers.own import close_tracker
from base_station.trackers.registry import made_from_file
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map_file import leave_map, take_up_map
from base_station.trackers.slam.saved_map import SavedMap

OWN = "slam"
SLAM_METHODS = ("track", "finish", "trajectory", "keyframes", "points", "statistics", "close")


@dataclass(frozen=True, kw_only=True)
class EvaluateSlam:
    """Run SLAM on a recorded sequence (TUM, EuRoC or KITTI layout): share of frames tracked, errors, times, map.

    Errors are of each frame's final pose, after the similarity that fits best. The unit is the truth's.
    """

    folder: tyro.conf.Positional[Path]
    """The sequence."""
    tracker: Annotated[str, tyro.conf.arg(aliases=["-t"])] = OWN
    """slam, or a class of your own as path/to/file.py:ClassName with the methods of SlamSystem."""
    realtime: bool = False
    """Show the pictures at the sequence's rate, and drop those that come too late."""
    camera: str | None = None
    """ORB-SLAM's YAML file, instead of the folder's own calibration; none: the default field of view."""
    max_frames: int | None = None
    """At the most."""
    single_process: bool = False
    """Map in the same process: slower, and the same result every time."""
    seed: int = 0
    map: Path | None = None
    """With slam: go on in the map of this file where it exists, and write it there at the end."""
    json: Path | None = None
    """Write all figures to this file."""
    output: Path | None = None
    """Write trajectories, the map and plots into this folder; it is made."""


def evaluate_slam(command: EvaluateSlam) -> None:
    """Measure, print, write. Raises StationError."""
    check_options(command.max_frames, command.json)
    if command.seed < 0:
        raise StationError(f"--seed must not be negative, not {command.seed}.", usage=True)
    if command.map is not None and command.tracker != OWN:
        raise StationError(f"--map goes with --tracker {OWN}.", usage=True)
    check_output("--map", command.map)
    if command.output is not None:
        require()
        _make(command.output)
    sequence = read_sequence(command.folder, camera=command.camera, max_frames=command.max_frames)
    run = run_slam(command, sequence)
    found = figures(sequence, run) | {"tracker": command.tracker, "realtime": command.realtime, "machine": machine()}
    plain_console().print(figure_table(found))
    _tell_trouble(run.shown)
    if (why := untimed(run.trajectory, sequence.truth)) is not None:
        print(why, file=sys.stderr)
    if command.json is not None:
        write_json(command.json, found)
    if command.output is not None:
        try:
            write_output(command.output, sequence, run)
        except OSError as error:
            raise StationError(f"--output: {command.output} cannot be written ({error.strerror}).") from error


def run_slam(command: EvaluateSlam, sequence: SlamSequence) -> SlamRun:
    """A new system, shown the sequence in one thread of OpenCV's, and closed whatever happens. Raises StationError."""
    threads = cv2.getNumThreads()
    saved = take_up_map(command.map, _say) if command.map is not None and command.map.exists() else None
    with Console(stderr=True).status("getting ready (the first time its kernels are compiled)"):
        slam = make_slam(
            command.tracker, sequence.camera, single_process=command.single_process, seed=command.seed, saved=saved
        )
    try:
        cv2.setNumThreads(1)
        with threadpool_limits(1), _progress(len(sequence)) as progress:
            task = progress.add_task("pictures", total=len(sequence))
            run = show(sequence, slam, realtime=command.realtime, on_frame=lambda: progress.advance(task))
        if command.map is not None and isinstance(slam, KeepsMap):
            leave_map(command.map, slam.saved(), _say)
        return run
    finally:
        cv2.setNumThreads(threads)
        close_tracker(slam)


def _say(text: str) -> None:
    print(text, file=sys.stderr)


@runtime_checkable
class KeepsMap(Protocol):
    """A system whose map can be kept, see `SlamSystem.saved`."""

    def saved(self) -> SavedMap | None: ...


def make_slam(
    name: str, camera: SlamCamera, *, single_process: bool, seed: int, saved: SavedMap | None = None
) -> Slam:  # fmt: skip
    """Our system, or a user's class that is made with the same arguments; `saved` is for ours. Raises StationError."""
    if name == OWN:
        from base_station.trackers.slam.system import SlamSystem

        return SlamSystem(camera, single_process=single_process, seed=seed, saved=saved)
    if ".py:" not in name:
        text = f"{name!r} gives no trajectory: evaluate slam runs slam, or your own class as path/to/file.py:ClassName."
        raise StationError(text, usage=True)
    try:
        made: Slam = made_from_file(name, SLAM_METHODS, camera, single_process=single_process, seed=seed)
    except ValueError as error:
        raise StationError(str(error), usage=True) from error
    return made


def write_output(folder: Path, sequence: SlamSequence, run: SlamRun) -> None:
    """Trajectories (TUM and EuRoC), frames.csv, the map (PLY, COLMAP), plots. Raises StationError or OSError."""
    for name, trajectory in (("CameraTrajectory", run.trajectory), ("KeyFrameTrajectory", run.keyframes)):
        write_tum(folder / f"{name}.txt", trajectory)
        write_euroc(folder / f"{name}.csv", trajectory)
    rows = ["time_s,outcome,ms,keyframe,reason"]
    for one in run.shown:
        reason = one.reason.replace('"', "'")
        rows.append(f'{one.time_s:.6f},{one.outcome.value},{one.ms:.3f},{int(one.keyframe)},"{reason}"')
    (folder / "frames.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    pictures = {float(time_s): path.name for time_s, path in zip(sequence.times_s, sequence.pictures, strict=True)}
    names = [pictures.get(float(time_s), f"{time_s:.6f}") for time_s in run.keyframes.times_s]
    camera = run.statistics.camera or sequence.camera
    write_colmap(folder / "colmap", camera, run.keyframes, names, run.points)
    write_ply(folder / "map.ply", run.points, run.keyframes)
    plot_trajectory(folder / "trajectory.png", run.trajectory, sequence.truth, np.array([one.ms for one in run.shown]))
    plot_map(folder / "map.png", run.points, run.keyframes)


def figure_table(found: dict[str, Any]) -> Table:
    """The figures that people ask for first, one a row."""
    table = Table(title=f"{found['tracker']} on {found['sequence']}", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("figure")
    table.add_column("value", justify="right")
    rows = {
        "frames": f"{found['frames']}",
        "tracked, of the shown ones": f"{found['tracked_share']:.1%}, {found['tracked_share_of_shown']:.1%}",
        "dropped, unreadable": f"{found['dropped_frames']}, {found['unreadable_frames']}",
        "ATE, RMSE": _rounded(found["ate_rmse"], 4),
        "ATE of keyframes, of poses told at once": f"{_rounded(found['ate_keyframes_rmse'], 4)}, "
        f"{_rounded(found['ate_online_rmse'], 4)}",
        "RPE, step to step": f"{_rounded(found['rpe_trans_rmse'], 4)}, {_rounded(found['rpe_rot_deg_rmse'], 3, '°')}",
        "ms a picture: median, p95, max": ", ".join(_rounded(found[f"ms_{part}"], 1) for part in ("p50", "p95", "max")),
        "keyframes, a second": f"{found['keyframes']}, {found['keyframes_per_s']:.2f}",
        "points": f"{found['points']}",
        "maps, loops, relocalizations": f"{found['maps']}, {found['loops']}, {found['relocalizations']}",
        "memory, MiB": _rounded(found["memory_mib"], 0),
    }
    for name, value in rows.items():
        table.add_row(name, value)
    table.caption, table.caption_justify = f"camera: {found['camera']}", "left"
    return table


def _rounded(value: float | None, digits: int, unit: str = "") -> str:
    return "-" if value is None else f"{value:.{digits}f}{unit}"


def untimed(found: Trajectory, truth: Trajectory | None) -> str | None:
    """Why there is nothing to measure the poses against, although there are some and a truth; None when there is."""
    if truth is None or not len(found):
        return None
    matched = len(associate(found.times_s, truth.times_s))
    if matched >= LEAST_POSES:
        return None
    if matched:
        have = f"{matched} of {len(found)}; {LEAST_POSES} are needed"
        return f"No errors: poses that have a true one within {MOST_APART_S} s: {have}."
    return (
        f"No errors: none of the {len(found)} poses has a true one within {MOST_APART_S} s: are both in the same clock "
        f"and unit? The poses' times begin with {found.times_s[0]:.3f} s, the true ones' with {truth.times_s[0]:.3f} s."
    )


def _tell_trouble(shown: Sequence[PictureOutcome]) -> None:
    """Pictures that were missing, and why nothing was tracked, if nothing was."""
    unreadable = [one.reason for one in shown if one.outcome is Outcome.UNREADABLE]
    if unreadable:
        many = f"{len(unreadable)} pictures were passed over; the first:" if len(unreadable) > 1 else "Passed over:"
        print(f"{many} {unreadable[0]}", file=sys.stderr)
    if all(one.outcome is not Outcome.TRACKING for one in shown):
        last = next((one.reason for one in reversed(shown) if one.reason), "no reason given")
        print(f"No picture was tracked: {last}", file=sys.stderr)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StationError(f"--output: {folder} cannot be made ({error.strerror}).", usage=True) from error


@contextlib.contextmanager
def _progress(total: int) -> Iterator[Progress]:
    console = Console(stderr=True)
    columns = (TextColumn("pictures"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        yield progress
