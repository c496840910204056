"""base-station run: connect to a robot, watch its pictures with a tracker and drive it."""

from __future__ import annotations

import dataclasses
import functools
import logging
import math
import queue
import signal
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import Annotated

from rich.console import Console
from rich.logging import RichHandler
from threadpoolctl import threadpool_limits
from tyro.conf import arg

from base_station.behaviours.base import Outcome
from base_station.behaviours.registry import check_behaviour
from base_station.calibration.camera_file import named_camera
from base_station.configuration import as_toml
from base_station.console.launcher import ConsoleSettings
from base_station.console_option import check_console, open_console
from base_station.display import StatusLine, summary_table
from base_station.errors import StationError, never_learned
from base_station.evaluation.closed_loop import LoopLog, Summary
from base_station.evaluation.picture import RunPicture
from base_station.geometry import PinholeCamera
from base_station.kits import KitMaker
from base_station.landmark_shelf import LandmarkShelf
from base_station.landmarks_command import DEFAULT_MEMORY, parse_box, scale_of
from base_station.link import Link
from base_station.map_option import check_map, keep_maps, trackers_with_map
from base_station.orders import LANDMARK
from base_station.output_files import check_output, write_bytes, write_json
from base_station.publication.service import Publication
from base_station.recording.session import recording_of
from base_station.results import ResultsFile
from base_station.session import LinkSettings
from base_station.station import Station, StationSettings, Step
from base_station.terminal import pressed_keys
from base_station.trackers.base import Surveyor
from base_station.trackers.own import FAILURES, close_tracker, told
from base_station.trackers.registry import DEFAULT_TRACKER
from base_station.types import Box
from base_station.watcher import Kit
from protocol import FRAME_PORT, Telemetry

ANY_CAMERA = PinholeCamera.with_fov(640, 480)
END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """Connect to a robot, watch its pictures with a tracker and drive it."""

    config: Path | None = None
    """A TOML file with these settings (tracker = "slam"); flags override what it says."""
    print_config: bool = False
    """Print the settings as such a file, and end."""
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
    map: Path | None = None
    """slam's map: taken up from this file where it exists, and written there when the run ends."""
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
    camera: Path | None = None
    """The camera's calibration, as base-station calibrate wrote it. Default: what the robot says of its camera."""
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
    record: Path | None = None
    """Record the run to this MCAP file: for `base-station replay`, Foxglove and Lichtblick."""
    record_raw: bool = False
    """Record the pictures without loss (five times the size), so that a replay gives the very same results."""
    status: bool = True
    """Show the live status line."""
    console: bool = False
    """Open the console: a page for the browser, to watch and to drive. The terminal tells its address."""
    console_host: str = "127.0.0.1"
    """Address to serve the console at; any but this machine's own asks its visitors for a token."""
    console_port: int = 8080
    """The first port to try for the console."""


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
    if run.console:
        check_console(_console_settings(run))
    check_map(run.map, (run.tracker if run.landmark is None else None, run.shadow))
    check_output("--summary", run.summary)
    check_output("--picture", run.picture, (".png",))
    if run.record_raw and run.record is None:
        raise StationError("--record-raw goes with --record FILE.mcap.", usage=True)


def run(run: Run, console: Console) -> None:
    """Raises StationError."""
    _check(run)
    if run.print_config:
        print(as_toml(run, "run"), end="")
        return
    for number in END_SIGNALS:  # until the loop runs, a signal simply ends the program
        signal.signal(number, _end_at_once)
    handler = RichHandler(console=console, show_path=False)
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[handler])
    log = LoopLog(tracker=run.tracker, behaviour=run.behaviour, shadow=run.shadow, from_memory=run.landmark is not None)
    with ExitStack() as stack:
        stack.enter_context(threadpool_limits(1))  # small matrices: more threads only wait for each other
        watching: list[Callable[[Step], None]] = [log.note_step]
        waiting: list[Callable[[], None]] = []
        if run.results is not None:
            results = ResultsFile(run.results)
            stack.callback(results.close)
            watching.append(results.write)
        picture = RunPicture() if run.picture is not None else None
        if picture is not None:
            watching.append(picture.note_step)
        hearing: list[Callable[[Telemetry], None]] = [log.note_telemetry]
        link = Link(_link_settings(run), on_telemetry=functools.partial(_tell, hearing))
        driving: queue.SimpleQueue[str] = queue.SimpleQueue()
        shelf = LandmarkShelf(run.memory)
        say = functools.partial(console.print, soft_wrap=True, markup=False)  # what is long stays in one line
        station = _station(run, link, driving, shelf, watching, waiting, say)
        stack.callback(station.close)
        stack.callback(lambda: keep_maps(station.trackers))  # however the run ends
        if run.record is not None:
            recorder = stack.enter_context(recording_of(run, run.record, link, raw=run.record_raw))
            watching.append(recorder.note_step)
            hearing.append(recorder.note_telemetry)
        stack.enter_context(link)  # now that the trackers are made: the robot does not wait for them
        if run.console:
            publication = _open_console(run, stack, link, station, shelf, say)
            watching.append(publication.step)
            waiting.append(publication.wait)
        keys = stack.enter_context(pressed_keys())
        if keys is not None:
            obey = functools.partial(_obey_keys, keys, station, driving)
            watching.append(lambda step: obey())
            waiting.append(obey)
        elif run.behaviour == "teleop" and not run.console:
            raise StationError("teleop needs a terminal to read the keys from, or --console.", usage=True)
        if run.status:
            line = stack.enter_context(_status_line(run, console, link, keys is not None))
            watching.append(line.step)
            waiting.append(line.wait)
        _end_on_signals(station)
        _drive(station)
        log.wait_for_truth()
        log.laps = station.laps
        log.note_survey(station.tracker.survey() if isinstance(station.tracker, Surveyor) else None)
    _conclude(run, console, link, log, picture, station.outcome)


def _tell(hearing: list[Callable[[Telemetry], None]], telemetry: Telemetry) -> None:
    for hear in hearing:
        hear(telemetry)


def _link_settings(run: Run) -> LinkSettings:
    return LinkSettings(
        host=run.host,
        port=run.port,
        width=run.width,
        height=run.height,
        signed_peer=run.signed_peer,
        rows=run.rows,
        camera=named_camera(run.camera) if run.camera is not None else None,
    )


def _console_settings(run: Run) -> ConsoleSettings:
    return ConsoleSettings(host=run.console_host, port=run.console_port)


def _open_console(
    run: Run,
    stack: ExitStack,
    link: Link,
    station: Station,
    shelf: LandmarkShelf,
    say: Callable[[str], None],
) -> Publication:
    """For as long as the stack lasts. Raises StationError."""
    return open_console(
        stack,
        _console_settings(run),
        link,
        orders=station,
        shelf=shelf,
        tracker=lambda: station.tracker,
        outcome=lambda: station.outcome.text if station.outcome is not None else "",
        own_trackers=tuple(name for name in (run.tracker, run.shadow) if name is not None),
        begins=station.names,
        say=say,
    )


def _status_line(run: Run, console: Console, link: Link, has_keys: bool) -> StatusLine:
    hint = "space: emergency stop  r: release  l: learn  q: quit" if has_keys else ""
    if run.behaviour == "teleop":
        hint = f"drive: w a s d or arrows  {hint}"
    return StatusLine(console, link, run.tracker, run.behaviour, hint)


def _station(
    run: Run,
    link: Link,
    driving: queue.SimpleQueue[str],
    shelf: LandmarkShelf,
    watching: list[Callable[[Step], None]],
    waiting: list[Callable[[], None]],
    say: Callable[[str], None],
) -> Station:
    """With trackers of its own; tells those who are `watching` of each step, and those who are `waiting` that no frame
    comes. Raises StationError."""

    def on_step(step: Step) -> None:
        for observer in watching:
            observer(step)

    def on_wait() -> None:
        for observer in waiting:
            observer()

    settings = StationSettings(
        behaviour=run.behaviour,
        pan=run.pan,
        target=parse_box(run.target) if run.target is not None else None,
        duration_s=run.duration,
        max_frames=run.max_frames,
        until_there=run.until_there,
        rows=run.rows,
        target_rows=run.target_rows,
    )
    make = KitMaker(
        memory=run.memory, target_width_m=run.target_width_m, learned_distance_m=run.learned_distance_m,
        trackers=trackers_with_map(run.map, say),
    )  # fmt: skip
    with ExitStack() as making:
        kit = _kit(make, run.tracker if run.landmark is None else LANDMARK + run.landmark)
        making.callback(close_tracker, kit.tracker)
        shadow = _kit(make, run.shadow) if run.shadow is not None else None
        station = Station(
            link,
            kit,
            settings,
            shadow=shadow,
            keys=driving,
            make=make.beside_a_run,
            remember=shelf.remember,
            on_step=on_step,
            on_wait=on_wait,
        )
        making.pop_all()  # they are the station's now
    return station


def _obey_keys(keys: queue.SimpleQueue[str], station: Station, driving: queue.SimpleQueue[str]) -> None:
    actions = {
        " ": lambda: station.emergency("stop"),
        "r": lambda: station.emergency("release"),
        "l": station.learn_now,
        "q": station.stop,
    }
    while not keys.empty():
        key = keys.get_nowait()
        if key in actions:
            actions[key]()
        else:
            driving.put(key)


def _kit(make: KitMaker, name: str) -> Kit:
    try:
        return make(name)
    except ValueError as error:
        raise StationError(str(error), usage=True) from error


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
    except FAILURES as error:
        # A tracker of the user's own may fail in any way: the station has sent a stop; say where it failed.
        raise StationError(f"Stopped the robot: {told(error)}.") from error


def _conclude(
    run: Run, console: Console, link: Link, log: LoopLog, picture: RunPicture | None, outcome: Outcome | None
) -> None:
    hello = link.hello
    scenario = hello.scenario if hello is not None else None
    summary: Summary = log.summary(
        scenario=scenario.name if scenario is not None else None,
        seed=scenario.seed if scenario is not None else None,
        rhythm=hello.rhythm if hello is not None else None,
    )
    if run.summary is not None:
        write_json(run.summary, summary.as_dict())
    if run.picture is not None and picture is not None:
        write_bytes(run.picture, picture.png(log.truths(), summary))
    console.print(summary_table(summary))
    if summary.frames == 0:
        raise StationError(f"No frame came from {run.host}:{run.port} ({link.state}). Is the agent running there?")
    if run.target is not None and not log.learned:
        raise never_learned(run.target)
    if run.until_there and (outcome is None or not outcome.there):
        raise StationError(f"Not there: {outcome.text if outcome is not None else 'the run ended on the way'}.")
