"""The base-station command."""

from __future__ import annotations

import dataclasses
import functools
import json
import logging
import math
import queue
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.logging import RichHandler
from threadpoolctl import threadpool_limits
from tyro.conf import arg

from base_station.behaviours.base import Outcome
from base_station.behaviours.registry import check_behaviour
from base_station.discovery import find_robots
from base_station.display import StatusLine, summary_table
from base_station.errors import StationError
from base_station.evaluation.closed_loop import LoopLog, Summary
from base_station.evaluation.evaluate_command import Evaluate, evaluate
from base_station.evaluation.overlap import read_results, read_truth, score_boxes
from base_station.evaluation.picture import RunPicture
from base_station.geometry import PinholeCamera
from base_station.landmarks_command import (
    DEFAULT_MEMORY,
    Landmarks,
    landmarks,
    parse_box,
    scale_of,
    unknown_text,
)
from base_station.link import Link, LinkSettings
from base_station.results import ResultsFile
from base_station.scale import Scale
from base_station.station import ScaleMaker, Station, StationSettings, Step
from base_station.terminal import pressed_keys
from base_station.trackers.base import Surveyor, Tracker
from base_station.trackers.registry import DEFAULT_TRACKER, make_tracker, tracker_names
from base_station.types import Box
from protocol import FRAME_PORT

if TYPE_CHECKING:
    from base_station.trackers.ztransform.landmark import Landmark

ANY_CAMERA = PinholeCamera.with_fov(640, 480)
EXIT_DONE, EXIT_FAILED, EXIT_USAGE = 0, 1, 2
END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """Connect to a robot, watch its pictures with a tracker and drive it."""

    tracker: Annotated[str, arg(aliases=["-t"])] = DEFAULT_TRACKER
    """A name that `base-station trackers` lists, or one of your own: path/to/file.py:ClassName."""
    behaviour: Annotated[str, arg(aliases=["-b"])] = "follow"
    """follow, goto (back to where the target was learned), route (laps along a simulated scenario's waypoints), idle,
    pattern (listing A.2's drive) or teleop (w a s d or arrow keys)."""
    pan: bool = False
    """follow: turn the camera on its pan-tilt after the target, and the body after the camera."""
    target: str | None = None
    """Box x,y,width,height in px, learned in the first frame. Default: what the simulation says, else the whole
    view."""
    landmark: str | None = None
    """Follow this landmark, or with behaviour goto return to it, instead of learning something now."""
    memory: Path = DEFAULT_MEMORY
    """The file that holds the landmark (see base-station landmarks)."""
    until_there: bool = False
    """With behaviour goto or route: end when it is there, or has given up (exit code 1)."""
    target_width_m: float | None = None
    """How wide the target is; results then carry its distance."""
    learned_distance_m: float | None = None
    """How far away the target was when it was learned; the same."""
    shadow: str | None = None
    """A second tracker on the same frames; the first one steers."""
    rows: bool = False
    """Fewer bytes: let the robot send the rows only that the tracker wants (all, for a tracker that cannot say)."""
    target_rows: int | None = None
    """Of the target's box learn no more than so many rows, those in the middle: with --rows even fewer bytes."""
    host: str = "127.0.0.1"
    """The robot's name or address."""
    port: int = FRAME_PORT
    """The first of the robot's four ports."""
    width: int = 640
    """Picture width of a peer that says no hello."""
    height: int = 480
    """Picture height of a peer that says no hello."""
    signed_peer: bool = False
    """A peer without hello understands negative speeds; else they are cut to 0..127 for it."""
    duration: float | None = None
    """End after this many seconds of the frames' time."""
    max_frames: int | None = None
    """End after this many frames."""
    results: Path | None = None
    """Write a CSV row per frame to this file."""
    summary: Path | None = None
    """Write the run's summary to this JSON file."""
    picture: Path | None = None
    """Write a picture of the run (last view, path, errors) to this PNG file."""
    status: bool = True
    """Show the live status line."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Score:
    """Compare the boxes of a --results file with true ones (OTB's groundtruth_rect.txt): overlap, AUC, precision."""

    results: tyro.conf.Positional[Path]
    """A file written by `base-station run --results`."""
    truth: tyro.conf.Positional[Path]
    """Lines of x,y,width,height."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Trackers:
    """List the trackers."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Robots:
    """List the robots that announce themselves on this network."""

    seconds: float = 2.0
    """How long to listen."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 done, 1 failed, 2 wrong usage."""
    try:
        command = tyro.cli(
            Run | Landmarks | Score | Evaluate | Trackers | Robots,
            prog="base-station",
            description="The station on the PC: sees with a tracker, drives with a behaviour.",
            args=arguments,
            config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes),
        )
    except SystemExit as end:  # tyro's own way out: after --help, or after having said what was wrong
        return EXIT_USAGE if end.code else EXIT_DONE
    console = Console(stderr=True)
    try:
        if isinstance(command, Run):
            return _run(command, console)
        if isinstance(command, Score):
            return _score(command)
        if isinstance(command, Landmarks):
            landmarks(command)
            return EXIT_DONE
        if isinstance(command, Robots):
            return _robots(command)
        if isinstance(command, Evaluate):
            evaluate(command)
            return EXIT_DONE
        print("\n".join(tracker_names()))
        return EXIT_DONE
    except KeyboardInterrupt:
        return EXIT_DONE
    except StationError as error:
        console.print(f"base-station: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
        return EXIT_USAGE if error.usage else EXIT_FAILED


def _score(command: Score) -> int:
    found, truth = read_results(command.results), read_truth(command.truth)
    frames = min(len(found), len(truth))
    if frames == 0:
        raise StationError("There are no frames to compare.")
    if len(found) != len(truth):
        print(f"comparing the first {frames} frames ({len(found)} results, {len(truth)} true boxes)", file=sys.stderr)
    print(json.dumps(dataclasses.asdict(score_boxes(found[:frames], truth[:frames])), indent=2))
    return EXIT_DONE


def _robots(command: Robots) -> int:
    if not 0.1 <= command.seconds <= 60:
        raise StationError(f"--seconds must be 0.1..60, not {command.seconds:g}.", usage=True)
    found = find_robots(command.seconds)
    if not found:
        raise StationError(
            "No robot announces itself here. Is the agent started with --listen 0.0.0.0, is python3-zeroconf on "
            "the robot, are both on the same network? Networks that keep multicast back are common: then use "
            "base-station run --host ADDRESS (on the robot, hostname -I tells the address)."
        )
    rows = [("name", "address", "port", "robot", "camera", "state")]
    rows += [(robot.name, robot.address, str(robot.port), robot.robot, robot.camera, robot.busy) for robot in found]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip())
    print(f"\nbase-station run --host {found[0].address} --port {found[0].port}", file=sys.stderr)
    return EXIT_DONE


def _tracker(name: str) -> Tracker:
    try:
        return make_tracker(name)
    except ValueError as error:
        raise StationError(str(error), usage=True) from error


def _landmark(run: Run) -> Landmark | None:
    """The landmark to follow or to go to. Raises StationError."""
    if run.landmark is None:
        return None
    from base_station.trackers.ztransform.landmark_file import read_landmarks

    known = {landmark.name: landmark for landmark in read_landmarks(run.memory)}
    if run.landmark not in known:
        raise StationError(unknown_text(run.landmark, run.memory, list(known)), usage=True)
    return known[run.landmark]


def _recall_tracker(landmark: Landmark) -> Tracker:
    from base_station.trackers.ztransform.recall import RecallTracker

    return RecallTracker(landmark)


def _scale_maker(run: Run, landmark: Landmark | None) -> ScaleMaker | None:
    """How the scale follows from the options and what is learned."""
    if landmark is not None:
        depth_m = landmark.learned_depth_m
        return None if depth_m is None else lambda box, camera: Scale(learned_depth_m=depth_m)
    if run.learned_distance_m is None and run.target_width_m is None:
        return None
    return functools.partial(scale_of, width_m=run.target_width_m, distance_m=run.learned_distance_m)


def _close(tracker: Tracker) -> None:
    try:
        tracker.close()
    except Exception as error:  # a user's own tracker may fail here too; the run itself is over
        logging.getLogger(__name__).warning("the tracker did not close cleanly: %s: %s", type(error).__name__, error)


def _check(run: Run) -> None:
    """Find mistakes of usage before anything is opened."""
    try:
        check_behaviour(run.behaviour)
    except ValueError as error:
        raise StationError(str(error), usage=True) from error
    if run.pan and run.behaviour != "follow":
        raise StationError(f"--pan goes with --behaviour follow, not with {run.behaviour}.", usage=True)
    for name, value in (
        ("--duration", run.duration),
        ("--max-frames", run.max_frames),
        ("--target-rows", run.target_rows),
    ):
        if value is not None and not 0 < value < math.inf:
            raise StationError(f"{name} must be positive, not {value}.", usage=True)
    scale_of(Box(0, 0, 1, 1), ANY_CAMERA, width_m=run.target_width_m, distance_m=run.learned_distance_m)
    if run.landmark is not None:
        for name, given in (
            ("--target", run.target),
            ("--target-width-m", run.target_width_m),
            ("--learned-distance-m", run.learned_distance_m),
            ("--tracker", None if run.tracker == DEFAULT_TRACKER else run.tracker),
        ):
            if given is not None:
                raise StationError(f"A landmark knows its own: leave out {name}.", usage=True)
    for name, side in (("--width", run.width), ("--height", run.height)):
        if not 1 <= side <= 8192:
            raise StationError(f"{name} must be 1..8192, not {side}.", usage=True)
    if not 1 <= run.port <= 65532:
        raise StationError(f"--port must be 1..65532 (four ports in a row), not {run.port}.", usage=True)
    for name, path in (("--summary", run.summary), ("--picture", run.picture)):
        if path is not None and not path.parent.is_dir():
            raise StationError(f"{name}: there is no folder {path.parent}.", usage=True)
        if path is not None and path.is_dir():
            raise StationError(f"{name}: {path} is a folder; name a file.", usage=True)


def _run(run: Run, console: Console) -> int:
    _check(run)
    landmark = _landmark(run)
    for number in END_SIGNALS:  # until the loop runs, a signal simply ends the program
        signal.signal(number, _end_at_once)
    handler = RichHandler(console=console, show_path=False)
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[handler])
    settings = StationSettings(
        behaviour=run.behaviour,
        pan=run.pan,
        target=parse_box(run.target) if run.target is not None else None,
        duration_s=run.duration,
        max_frames=run.max_frames,
        until_there=run.until_there,
        rows=run.rows,
        target_rows=run.target_rows,
        scale=_scale_maker(run, landmark),
    )
    log = LoopLog(tracker=run.tracker, behaviour=run.behaviour, shadow=run.shadow, from_memory=landmark is not None)
    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(1))  # small matrices: more threads only wait for each other
        tracker = _tracker(run.tracker) if landmark is None else _recall_tracker(landmark)
        stack.callback(_close, tracker)
        shadow = _tracker(run.shadow) if run.shadow is not None else None
        if shadow is not None:
            stack.callback(_close, shadow)
        results = ResultsFile(run.results) if run.results is not None else None
        if results is not None:
            stack.callback(results.close)
        picture = RunPicture() if run.picture is not None else None
        link = stack.enter_context(
            Link(
                LinkSettings(
                    host=run.host,
                    port=run.port,
                    width=run.width,
                    height=run.height,
                    signed_peer=run.signed_peer,
                    rows=run.rows,
                ),
                on_telemetry=log.note_telemetry,
            )
        )
        keys = stack.enter_context(pressed_keys())
        if keys is None and run.behaviour == "teleop":
            raise StationError("teleop needs a terminal to read the keys from.", usage=True)
        line = None if not run.status else stack.enter_context(_status_line(run, console, link, keys is not None))
        observers: list[Callable[[Step], None]] = [log.note_step]
        observers += [results.write] if results is not None else []
        observers += [picture.note_step] if picture is not None else []
        observers += [line.step] if line is not None else []
        station = _station(link, tracker, settings, shadow, keys, observers, line)
        _end_on_signals(station)
        _drive(station)
        log.wait_for_truth()
        log.laps = station.laps
        log.note_survey(tracker.survey() if isinstance(tracker, Surveyor) else None)
    return _conclude(run, console, link, log, picture, station.outcome)


def _status_line(run: Run, console: Console, link: Link, has_keys: bool) -> StatusLine:
    hint = "space: emergency stop  r: release  l: learn  q: quit" if has_keys else ""
    if run.behaviour == "teleop":
        hint = f"drive: w a s d or arrows  {hint}"
    return StatusLine(console, link, run.tracker, run.behaviour, hint)


def _station(
    link: Link,
    tracker: Tracker,
    settings: StationSettings,
    shadow: Tracker | None,
    keys: queue.SimpleQueue[str] | None,
    observers: list[Callable[[Step], None]],
    line: StatusLine | None,
) -> Station:
    driving: queue.SimpleQueue[str] = queue.SimpleQueue()

    def on_step(step: Step) -> None:
        for observer in observers:
            observer(step)
        obey_keys()

    def on_wait() -> None:
        if line is not None:
            line.wait()
        obey_keys()

    station = Station(link, tracker, settings, shadow=shadow, keys=driving, on_step=on_step, on_wait=on_wait)
    actions = {
        " ": lambda: station.emergency("stop"),
        "r": lambda: station.emergency("release"),
        "l": station.learn_now,
        "q": station.stop,
    }

    def obey_keys() -> None:
        while keys is not None and not keys.empty():
            key = keys.get_nowait()
            if key in actions:
                actions[key]()
            else:
                driving.put(key)

    return station


def _end_at_once(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _end_on_signals(station: Station) -> None:
    def end(_number: int, _frame: FrameType | None) -> None:
        station.stop()

    for number in END_SIGNALS:
        signal.signal(number, end)


def _drive(station: Station) -> None:
    try:
        station.run()
    except StationError:
        raise
    except Exception as error:
        # A tracker of the user's own may fail in any way: the station has sent a stop; say where it failed.
        place = traceback.extract_tb(error.__traceback__)[-1]
        raise StationError(
            f"Stopped the robot: {type(error).__name__}: {error} ({Path(place.filename).name}, line {place.lineno})."
        ) from error


def _conclude(
    run: Run, console: Console, link: Link, log: LoopLog, picture: RunPicture | None, outcome: Outcome | None
) -> int:
    hello = link.hello
    scenario = hello.scenario if hello is not None else None
    summary: Summary = log.summary(
        scenario=scenario.name if scenario is not None else None,
        seed=scenario.seed if scenario is not None else None,
        rhythm=hello.rhythm if hello is not None else None,
    )
    if run.summary is not None:
        _write(run.summary, (json.dumps(summary.as_dict(), indent=2) + "\n").encode())
    if run.picture is not None and picture is not None:
        _write(run.picture, picture.png(log.truths(), summary))
    console.print(summary_table(summary))
    if summary.frames == 0:
        raise StationError(f"No frame came from {run.host}:{run.port} ({link.state}). Is the agent running there?")
    if run.target is not None and not log.learned:
        raise StationError(f"The target {run.target} was never learned: it must lie in the picture and have texture.")
    if run.until_there and (outcome is None or not outcome.there):
        raise StationError(f"Not there: {outcome.text if outcome is not None else 'the run ended on the way'}.")
    return EXIT_DONE


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error
