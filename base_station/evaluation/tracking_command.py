"""base-station evaluate tracking: a tracker on recorded sequences with true boxes."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from threadpoolctl import threadpool_limits

from base_station.errors import StationError
from base_station.evaluation.sequences import (
    Recording,
    SequenceScore,
    TrackerFollower,
    find_sequences,
    mean_score,
    run_sequence,
)
from base_station.output_files import check_output, write_json
from base_station.trackers.own import close_tracker
from base_station.trackers.registry import DEFAULT_TRACKER, make_tracker

PLAIN_WIDTH = 120


@dataclass(frozen=True, kw_only=True)
class EvaluateTracking:
    """Score a tracker on recorded sequences in OTB layout: success AUC, precision, time per frame.

    It learns the first true box. A picture in which it is LOST counts with the box that it gave last.
    """

    folder: tyro.conf.Positional[Path]
    """A sequence, or a folder of sequences."""
    tracker: Annotated[str, tyro.conf.arg(aliases=["-t"])] = DEFAULT_TRACKER
    """A name that `base-station trackers` lists, or path/to/file.py:ClassName."""
    max_frames: int | None = None
    """Of each sequence, at the most."""
    json: Path | None = None
    """Write the scores to this file."""


def evaluate_tracking(command: EvaluateTracking) -> None:
    """Measure, print, write. Raises StationError."""
    check_options(command.max_frames, command.json)
    recordings = find_sequences(command.folder, command.max_frames)
    console = Console(stderr=True)
    with progress_over(recordings, console) as on_frame:
        scores = score_tracker(command.tracker, recordings, on_frame)
    plain_console().print(score_table(command.tracker, scores))
    if command.json is not None:
        write_json(command.json, as_json(scores))


def plain_console() -> Console:
    """For tables: of a file there is no width to keep to."""
    console = Console()
    if not console.is_terminal:
        console.width = PLAIN_WIDTH
    return console


def check_options(max_frames: int | None, path: Path | None) -> None:
    """Find mistakes of usage before anything is measured."""
    if max_frames is not None and max_frames < 2:
        raise StationError(f"--max-frames must be at least 2, not {max_frames}.", usage=True)
    check_output("--json", path)


@contextlib.contextmanager
def progress_over(recordings: Sequence[Recording], console: Console, rounds: int = 1) -> Iterator[Callable[[], None]]:
    """A progress bar on a terminal, over all pictures; the context gives what to call after each."""
    columns = (TextColumn("pictures"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("pictures", total=rounds * sum(len(recording.pictures) for recording in recordings))
        yield lambda: progress.advance(task)


def score_tracker(name: str, recordings: Sequence[Recording], on_frame: Callable[[], None]) -> list[SequenceScore]:
    """A new tracker for each sequence, one thread. Raises StationError."""
    scores, threads = [], cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        with threadpool_limits(1):
            for recording in recordings:
                try:
                    tracker = make_tracker(name)
                except ValueError as error:
                    raise StationError(str(error), usage=True) from error
                try:
                    scores.append(run_sequence(recording, TrackerFollower(tracker), on_frame))
                finally:
                    close_tracker(tracker)
                if recording.note:
                    print(f"{recording.name}: {recording.note}", file=sys.stderr)
    finally:
        cv2.setNumThreads(threads)
    return scores


def as_json(scores: Sequence[SequenceScore]) -> dict[str, Any]:
    """One sequence: its scores. Several: their mean, and `sequences` with those of each."""
    if len(scores) == 1:
        return asdict(scores[0])
    return asdict(mean_score(scores)) | {"sequences": [asdict(score) for score in scores]}


def score_table(title: str, scores: Sequence[SequenceScore]) -> Table:
    """A row per sequence, and the mean of several."""
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    table.add_column("sequence", min_width=10)
    for heading in ("frames", "AUC", "within 20 px", "mean IoU", "ms p50", "ms p95", "LOST"):
        table.add_column(heading, justify="right")
    for score in [*scores, *([mean_score(scores)] if len(scores) > 1 else [])]:
        figures = (score.auc, score.precision20, score.mean_iou)
        times = (score.ms_p50, score.ms_p95)
        cells = (*(f"{figure:.3f}" for figure in figures), *(f"{ms:.2f}" for ms in times))
        table.add_row(score.sequence, str(score.frames), *cells, str(score.lost_frames))
    return table
