"""base-station compare: several trackers on the same recorded frames, as one table and one plot."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from base_station.display import short_name
from base_station.errors import StationError, never_learned
from base_station.evaluation.tracking_command import check_options, plain_console
from base_station.kits import KitMaker
from base_station.landmarks_command import parse_box
from base_station.output_files import write_json
from base_station.recording.agreement import agreement
from base_station.recording.planning import kits_of, planned
from base_station.recording.plot import check_picture, plot_series
from base_station.recording.replay import one_thread, replay
from base_station.recording.series import Series, TrackerFigures, figures, paired
from base_station.recording.sources import Source, TargetTruth, open_source
from base_station.trackers.own import close_tracker

MOST_TRACKERS = 16
RECORDED = "recorded"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Compare:
    """Run several trackers on the same recorded frames: one table and one plot."""

    source: tyro.conf.Positional[Path]
    """A recording, a folder of pictures or a video, as base-station replay has it."""
    trackers: str
    """Names with commas between them, as `base-station trackers` lists them, or path/to/file.py:ClassName."""
    target: str | None = None
    """Box x,y,width,height in px, learned in the first frame. Default: what was ordered in the recording, the first
    true box of OTB's layout, else the whole view."""
    width: int | None = None
    """Shrink the pictures of a folder or video to so many columns; the target is counted in the shrunk picture."""
    memory: Path | None = None
    """The file that holds the landmarks, if one is followed. Default: as in the recorded run."""
    max_frames: int | None = None
    """End after this many frames."""
    json: Path | None = None
    """Write all figures to this file."""
    picture: Path | None = None
    """Draw shift, bearing, zoom and confidence over time to this PNG file."""


def compare(command: Compare, console: Console) -> None:
    """Do it, print, write. Raises StationError."""
    names = _check(command)
    target = parse_box(command.target) if command.target is not None else None
    source = open_source(command.source, target=target, width=command.width)
    kits = kits_of(source, command.memory)
    _try(names, kits)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed} frames"),
        TimeElapsedColumn(),
    )
    rows: list[Series] = []
    recorded = Series(name=RECORDED)
    with one_thread(), Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        for name in names:
            task = progress.add_task(short_name(name), total=None)
            rows.append(_run(source, name, kits, command.max_frames, recorded if not rows else None, progress, task))
    known = source.known()
    for note in known.notes:
        console.print(f"base-station: {note}", style="yellow", highlight=False, markup=False, soft_wrap=True)
    shown = rows + ([recorded] if recorded.places else [])
    reference, against = _reference(known.truth, recorded, rows)
    told = [figures(series, reference, against) for series in shown]
    plain_console().print(_table(source, told, against))
    if command.json is not None:
        agrees = [agreement(paired(series, recorded)) for series in rows] if recorded.places else []
        write_json(
            command.json,
            {
                "source": source.name,
                "against": against,
                "trackers": [dataclasses.asdict(one) for one in told],
                "against_recorded": {
                    series.name: dataclasses.asdict(one) for series, one in zip(rows, agrees, strict=False)
                },
            },
        )
    if command.picture is not None:
        plot_series(command.picture, source.name, shown, known.truth)
    if target is not None and all(series.learned_row is None for series in rows):
        raise never_learned(command.target)


def _check(command: Compare) -> list[str]:
    """The trackers' names. Finds mistakes of usage before anything is done."""
    check_options(None, command.json)
    check_picture(command.picture)
    names = list(dict.fromkeys(name.strip() for name in command.trackers.split(",") if name.strip()))
    if not 1 <= len(names) <= MOST_TRACKERS:
        raise StationError(f"--trackers: name 1 to {MOST_TRACKERS} with commas between them.", usage=True)
    if command.max_frames is not None and command.max_frames < 1:
        raise StationError(f"--max-frames must be at least 1, not {command.max_frames}.", usage=True)
    return names


def _try(names: Sequence[str], kits: KitMaker) -> None:
    """An unknown tracker is known before the others have run for minutes."""
    for name in names:
        try:
            close_tracker(kits(name).tracker)
        except ValueError as error:
            raise StationError(str(error), usage=True) from error


def _run(
    source: Source,
    name: str,
    kits: KitMaker,
    max_frames: int | None,
    recorded: Series | None,
    progress: Progress,
    task: TaskID,
) -> Series:
    """One tracker over the source; with the first also what was `recorded`."""
    series = Series(name=name)
    for replayed in islice(replay(source, planned(source, name, None), kits), max_frames):
        step, earlier = replayed.step, replayed.shown.recorded
        at = replayed.place, step.frame.time_s
        series.add(*at, step.result, seconds=step.tracker_s, learned=step.learned)
        if recorded is not None and earlier is not None and replayed.shown.comparable:
            recorded.add(*at, earlier.result, seconds=earlier.tracker_s, learned=earlier.learned)
        for text in step.notices:
            progress.console.print(f"base-station: {short_name(name)}: {text}", markup=False, soft_wrap=True)
        progress.advance(task)
    return series


def _reference(
    truth: Mapping[int, TargetTruth], recorded: Series, rows: Sequence[Series]
) -> tuple[Mapping[int, TargetTruth], str]:
    """The best that there is to measure against: the truth, else the recorded results, else the first tracker."""
    if truth:
        return truth, "truth"
    first = recorded if recorded.places else rows[0]
    return first.truths(), short_name(first.name)


def _table(source: Source, told: Sequence[TrackerFigures], against: str) -> Table:
    table = Table(title=f"{source.name}, errors against {against}", title_justify="left", box=SIMPLE_HEAD)
    table.add_column("tracker", min_width=10)
    for heading in ("frames", "tracked", "ms p50", "ms p95", "LOST", "longest", "bearing RMS", "zoom RMS"):
        table.add_column(heading, justify="right")
    for one in told:
        table.add_row(
            short_name(one.tracker),
            str(one.frames),
            f"{100 * one.tracked_share:.1f} %",
            _shown(one.ms_p50, "{:.2f}"),
            _shown(one.ms_p95, "{:.2f}"),
            f"{one.lost_spans}x",
            f"{one.longest_lost_s:.2f} s",
            _shown(one.bearing_error_deg_rms, "{:.2f}°"),
            _shown(one.zoom_error_percent_rms, "{:.2f} %"),
        )
    return table


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
