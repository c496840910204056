"""base-station replay: any tracker on recorded frames, and how far it agrees with what was recorded."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated, Any, Protocol

import tyro
from rich.console import Console
from rich.table import Table

from base_station.display import short_name
from base_station.errors import StationError, never_learned
from base_station.evaluation.tracking_command import check_options, plain_console
from base_station.landmarks_command import parse_box
from base_station.map_option import check_map
from base_station.output_files import write_json
from base_station.recording.agreement import Agreement, agreement
from base_station.recording.planning import kits_of, planned
from base_station.recording.plot import check_picture, plot_series
from base_station.recording.recorder import Recorder
from base_station.recording.replay import Replayed, ReplayedRobot, ReplayPlan, one_thread, replay
from base_station.recording.series import Series, TrackerFigures, figures, paired
from base_station.recording.session import told_of
from base_station.recording.sources import RecordedRun, Source, open_source
from base_station.recording.video import SeenVideo
from base_station.results import ResultsFile
from base_station.station import Step

FAST = "fast"
SLOWEST, FASTEST = 0.05, 100.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class Replay:
    """Run a tracker on a recording, a folder of pictures or a video, and compare with what was recorded."""

    source: tyro.conf.Positional[Path]
    """FILE.mcap of `base-station run --record`; a folder in TUM's, EuRoC's, KITTI's or OTB's layout or of plain
    pictures; a video, such as a phone makes."""
    tracker: Annotated[str | None, tyro.conf.arg(aliases=["-t"])] = None
    """A name that `base-station trackers` lists, or path/to/file.py:ClassName. Default: those that were recorded."""
    shadow: str | None = None
    """A second tracker on the same frames."""
    target: str | None = None
    """Box x,y,width,height in px, learned in the first frame. Default: what was ordered in the recording, the first
    true box of OTB's layout, else the whole view."""
    width: int | None = None
    """Shrink the pictures of a folder or video to so many columns; the target is counted in the shrunk picture."""
    memory: Path | None = None
    """The file that holds the landmarks, if one was followed. Default: as in the recorded run."""
    map: Path | None = None
    """slam's map: taken up from this file where it exists, and written there at the end."""
    speed: str = FAST
    """1 is the rate at which the frames were taken, 0.5 half of it; fast: as fast as it goes."""
    realtime: bool = False
    """The same as --speed 1."""
    max_frames: int | None = None
    """End after this many frames."""
    same: bool = False
    """Fail (exit code 1) unless every result is the same as the recorded one, bit for bit."""
    results: Path | None = None
    """Write a CSV row per frame to this file."""
    json: Path | None = None
    """Write all figures to this file."""
    video: Path | None = None
    """Write what was seen as a video to this file (.mp4 or .avi)."""
    picture: Path | None = None
    """Draw shift, bearing, zoom and confidence over time to this PNG file."""
    record: Path | None = None
    """Record the replay, pictures without loss, to this MCAP file."""
    console: bool = False
    """Watch it in the browser, at the rate at which the frames were taken: from when the page is opened (the terminal
    tells the address) until Ctrl-C."""
    console_host: str = "127.0.0.1"
    """Address to serve the console at; any but this machine's own asks its visitors for a token."""
    console_port: int = 8080
    """The first port to try for the console."""


class _Rows:
    """Of the steerer or its shadow, now and as recorded."""

    def __init__(self) -> None:
        self.now, self.then = Series(name=""), Series(name="recorded")

    def note(self, replayed: Replayed, shadow: bool) -> None:
        step, recorded = replayed.step, replayed.shown.recorded if replayed.shown.comparable else None
        result, name = (step.shadow, step.shadow_tracker) if shadow else (step.result, step.tracker)
        at = replayed.place, step.frame.time_s
        if result is not None:
            self.now.name = name or self.now.name
            took_s = math.nan if shadow else step.tracker_s
            self.now.add(*at, result, seconds=took_s, learned=step.learned)
        earlier = None if recorded is None else recorded.shadow if shadow else recorded.result
        if recorded is not None and earlier is not None:
            took_s = math.nan if shadow else recorded.tracker_s
            self.then.add(*at, earlier, seconds=took_s, learned=recorded.learned)


class Audience(Protocol):
    """Who watches a replay."""

    def step(self, step: Step) -> None:
        """A frame was dealt with."""
        ...

    def stay(self) -> None:
        """There are no more frames: returns when nobody watches any more."""
        ...


Watch = Callable[[ExitStack, ReplayedRobot], Audience | None]
"""Opens what watches a replay, for as long as the stack lasts; None: nobody does."""


def replay_run(command: Replay, console: Console, watch: Watch = lambda stack, robot: None) -> None:
    """Do it, print, write. Raises StationError."""
    speed = _check(command)
    target = parse_box(command.target) if command.target is not None else None
    source = open_source(command.source, target=target, width=command.width)
    if command.same and (not isinstance(source, RecordedRun) or target is not None):
        raise StationError("--same needs a recording (FILE.mcap) and its own target to compare with.", usage=True)
    plan = planned(source, command.tracker, command.shadow)
    check_map(command.map, (plan.tracker, plan.shadow))
    with ExitStack() as stack:
        robot = ReplayedRobot(source)
        audience = watch(stack, robot)
        rows = _played(command, console, source, plan, speed, robot, audience)
        same = _told(command, console, source, plan, rows)
        if audience is not None:
            audience.stay()
    if target is not None and rows[0].now.learned_row is None:
        raise never_learned(command.target)
    if command.same and not same:
        raise StationError(f"The results are not those that were recorded{_why(source)}.")


def _played(
    command: Replay,
    console: Console,
    source: Source,
    plan: ReplayPlan,
    speed: float | None,
    robot: ReplayedRobot,
    audience: Audience | None,
) -> tuple[_Rows, _Rows]:
    """All frames, once. What the steering tracker saw, and its shadow."""
    steering, shadowing = _Rows(), _Rows()
    with ExitStack() as stack:
        stack.enter_context(one_thread())
        observers = _observers(command, plan, source, stack)
        if audience is not None:
            observers.append(audience.step)
        kits = kits_of(source, command.memory, command.map, functools.partial(_say, console))
        for replayed in stack.enter_context(closing(replay(source, plan, kits, speed=speed))):
            robot.tracker = replayed.tracker
            steering.note(replayed, shadow=False)
            shadowing.note(replayed, shadow=True)
            for observer in observers:
                observer(replayed.step)
            for text in replayed.step.notices:
                _say(console, text)
            if len(steering.now.places) == command.max_frames:
                break
    return steering, shadowing


def _told(command: Replay, console: Console, source: Source, plan: ReplayPlan, rows: tuple[_Rows, _Rows]) -> bool:
    """Print and write what came of it. Whether it is what was recorded, bit for bit."""
    known = source.known()
    for note in known.notes:
        _say(console, note)
    told = [figures(one.now, known.truth, "truth") for one in rows if one.now.places]
    against = [agreement(paired(one.now, one.then)) if one.then.places else None for one in rows]
    _print(source, told, against)
    if command.json is not None:
        write_json(command.json, _as_json(source, plan, told, against))
    if command.picture is not None:
        steering, shadowing = rows
        shown = [series for series in (steering.now, shadowing.now, steering.then) if series.places]
        plot_series(command.picture, source.name, shown, known.truth)
    return against[0] is not None and all(one is None or one.identical for one in against)


def _say(console: Console, text: str) -> None:
    console.print(f"base-station: {text}", style="yellow", highlight=False, markup=False, soft_wrap=True)


def _check(command: Replay) -> float | None:
    """The speed, None for as fast as it goes. Finds mistakes of usage before anything is done."""
    check_options(None, command.json)
    check_picture(command.picture)
    if command.max_frames is not None and command.max_frames < 1:
        raise StationError(f"--max-frames must be at least 1, not {command.max_frames}.", usage=True)
    if command.console and command.speed == FAST:
        return 1.0
    if command.realtime:
        if command.speed not in (FAST, "1"):
            raise StationError("--realtime is --speed 1: give one of both.", usage=True)
        return 1.0
    if command.speed == FAST:
        return None
    try:
        speed = float(command.speed)
    except ValueError:
        speed = math.nan
    if not SLOWEST <= speed <= FASTEST:
        raise StationError(f"--speed is {FAST} or {SLOWEST:g}..{FASTEST:g}, not {command.speed}.", usage=True)
    return speed


def _observers(
    command: Replay, plan: ReplayPlan, source: Source, stack: ExitStack
) -> list[Callable[[Step], None]]:  # fmt: skip
    found: list[Callable[[Step], None]] = []
    if command.results is not None:
        results = ResultsFile(command.results)
        stack.callback(results.close)
        found.append(results.write)
    if command.video is not None:
        found.append(stack.enter_context(SeenVideo(command.video)).note_step)
    if command.record is not None:
        recorded = source.recording.options if isinstance(source, RecordedRun) else {}
        named = {"tracker": plan.tracker, "shadow": plan.shadow, "landmark": None, "target_rows": plan.target_rows}
        run = told_of(command) | {"options": {**recorded, **named}}
        recorder = Recorder(command.record, raw=True, patient=True, run=run)
        stack.callback(recorder.close)
        found.append(recorder.note_step)
    return found


def _print(source: Source, told: Sequence[TrackerFigures], against: Sequence[Agreement | None]) -> None:
    console = plain_console()
    for one, agrees in zip(told, against, strict=False):
        table = Table(title=f"{short_name(one.tracker)} on {source.name}", title_justify="left", show_header=False)
        for name, text in _lines(one, agrees):
            table.add_row(name, text)
        console.print(table)


def _lines(one: TrackerFigures, agrees: Agreement | None) -> list[tuple[str, str]]:
    lines = [("frames", f"{one.frames}"), ("tracked", f"{100 * one.tracked_share:.1f} %")]
    if one.ms_p50 is not None:
        lines.append(("tracker, median and 95 %", f"{one.ms_p50:.2f}, {one.ms_p95:.2f} ms"))
    lines.append(("LOST", f"{one.lost_spans} times, at the longest {one.longest_lost_s:.2f} s"))
    lines += _measured("bearing error, RMS", one.bearing_error_deg_rms, "{:.2f}°")
    lines += _measured("zoom error, RMS", one.zoom_error_percent_rms, "{:.2f} %")
    if agrees is None:
        return lines
    if agrees.identical:
        return [*lines, ("against the recorded", "the same, bit for bit")]
    lines.append(("against the recorded: same", f"{agrees.same} of {agrees.frames} frames"))
    lines.append(("  first difference", f"frame {agrees.first_difference}: {agrees.difference}"))
    lines.append(("  same state", f"{agrees.same_state} frames"))
    lines.append(("  TRACKING", f"{agrees.tracked_now} frames now, {agrees.tracked_then} then"))
    lines += _measured("  bearing, RMS", agrees.bearing_deg_rms, "{:.3f}°")
    lines += _measured("  shift, RMS", agrees.shift_px_rms, "{:.3f} px")
    return lines + _measured("  zoom, RMS", agrees.zoom_percent_rms, "{:.3f} %")


def _measured(name: str, value: float | None, form: str) -> list[tuple[str, str]]:
    return [] if value is None else [(name, form.format(value))]


def _why(source: Source) -> str:
    recording = source.recording if isinstance(source, RecordedRun) else None
    lossy = recording is not None and not recording.raw
    return ": its pictures are JPEGs, record with --record-raw" if lossy else ""


def _as_json(
    source: Source, plan: ReplayPlan, told: Sequence[TrackerFigures], against: Sequence[Agreement | None]
) -> dict[str, Any]:
    return {
        "source": source.name,
        "plan": dataclasses.asdict(plan),
        "trackers": [dataclasses.asdict(one) for one in told],
        "against_recorded": [
            None if one is None else dataclasses.asdict(one) | {"identical": one.identical} for one in against
        ],
    }
