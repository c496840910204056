"""scripts/benchmark-otb: our trackers, and if asked for OpenCV's, side by side on sequences in OTB layout."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from base_station.errors import StationError
from base_station.evaluation.benchmark_report import machine, machine_line
from base_station.evaluation.sequences import SequenceScore, find_sequences, mean_score
from base_station.evaluation.tool import run_tool
from base_station.evaluation.tracking_command import (
    check_options,
    plain_console,
    progress_over,
    score_table,
    score_tracker,
)
from base_station.output_files import write_json
from base_station.trackers.own import close_tracker
from base_station.trackers.registry import DEFAULT_TRACKER, make_tracker

PROG = "benchmark-otb"
ROOT = Path(__file__).resolve().parents[2]
PEER_PYTHON = ROOT / ".venv-peers" / "bin" / "python"
RIVAL = "csrt"
WORST_BELOW_RIVAL = 0.10
MOST_MS = 0.5


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Compare trackers on every sequence of a folder: success AUC, precision, time per frame."""

    folder: tyro.conf.Positional[Path]
    """A sequence (img/*.jpg, groundtruth_rect.txt) or a folder of them."""
    trackers: str = DEFAULT_TRACKER
    """Ours, apart by commas."""
    peers: bool = False
    """Also run OpenCV's MOSSE, KCF and CSRT (installs OpenCV's contrib wheel into .venv-peers)."""
    max_frames: int | None = None
    """Of each sequence, at the most."""
    json: Path | None = None
    """Write all figures to this file: {tracker: [score, ...]}."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 done, 1 failed, 2 wrong usage."""
    return run_tool(Benchmark, PROG, arguments, _run)


def _run(command: Benchmark, arguments: Sequence[str]) -> None:
    check_options(command.max_frames, command.json)
    names = [name.strip() for name in command.trackers.split(",") if name.strip()]
    for name in names:
        try:
            close_tracker(make_tracker(name))
        except ValueError as error:
            raise StationError(str(error), usage=True) from error
    recordings = find_sequences(command.folder, command.max_frames)
    scores: dict[str, list[SequenceScore]] = {}
    with progress_over(recordings, Console(stderr=True), rounds=len(names)) as on_frame:
        for name in names:
            scores[name] = score_tracker(name, recordings, on_frame)
    if command.peers:
        scores |= _peer_scores(command.folder, command.max_frames)
    console = plain_console()
    console.print(f"machine: {machine_line()}", highlight=False, soft_wrap=True)
    line = shlex.join([f"scripts/{PROG}", *arguments])
    console.print(f"command: {line}", highlight=False, soft_wrap=True, markup=False)
    for name, rows in scores.items():
        console.print(score_table(name, rows))
    if RIVAL in scores:
        for name in names:
            console.print(duel_table(name, scores))
    if command.json is not None:
        figures = {name: [asdict(row) for row in rows] for name, rows in scores.items()}
        write_json(command.json, figures | {"_machine": machine(), "_run": {"command": line}})


def _peer_scores(folder: Path, max_frames: int | None) -> dict[str, list[SequenceScore]]:
    if not PEER_PYTHON.is_file():
        raise StationError(f"{PEER_PYTHON} is not there: scripts/{PROG} --peers makes it.")
    with tempfile.TemporaryDirectory() as at:
        path = Path(at) / "peers.json"
        command = [str(PEER_PYTHON), "-m", "base_station.evaluation.peers", str(folder.resolve()), "--json", str(path)]
        command += ["--max-frames", str(max_frames)] if max_frames is not None else []
        finished = subprocess.run(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=False)
        if finished.returncode:
            raise StationError("The peers could not be run (see above).")
        found = json.loads(path.read_text(encoding="utf-8"))
    return {name: [SequenceScore(**row) for row in rows] for name, rows in found.items()}


def duel_table(name: str, scores: Mapping[str, Sequence[SequenceScore]]) -> Table:
    """Sequence by sequence against CSRT, and whether the goals are reached: mean AUC above CSRT's, no sequence more
    than 0.10 below it, at most 0.5 ms a picture."""
    ours, theirs = scores[name], scores[RIVAL]
    table = Table(title=f"{name} against {RIVAL}", title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    table.add_column("sequence", min_width=10)
    for heading in ("AUC", f"AUC of {RIVAL}", "difference", "ms", f"ms of {RIVAL}"):
        table.add_column(heading, justify="right")
    pairs = list(zip(ours, theirs, strict=True))
    for one, other in [*pairs, (mean_score(ours), mean_score(theirs))]:
        gain = one.auc - other.auc
        style = "red" if gain < (0 if one.sequence == "mean" else -WORST_BELOW_RIVAL) else ""
        cells = (f"{one.auc:.3f}", f"{other.auc:.3f}", f"{gain:+.3f}", f"{one.ms_p50:.2f}", f"{other.ms_p50:.2f}")
        table.add_row(one.sequence, *cells, style=style)
    worst = min(one.auc - other.auc for one, other in pairs)
    gain, slowest = mean_score(ours).auc - mean_score(theirs).auc, mean_score(ours).ms_p50
    goals = (
        ("mean AUC above", gain > 0, f"{gain:+.3f}"),
        ("no sequence more than 0.10 below", worst >= -WORST_BELOW_RIVAL, f"worst {worst:+.3f}"),
        ("at most 0.5 ms a picture", slowest <= MOST_MS, f"{slowest:.2f} ms"),
    )
    table.caption = "; ".join(f"{goal}: {'reached' if good else 'missed'} ({figure})" for goal, good, figure in goals)
    table.caption_justify = "left"
    return table


if __name__ == "__main__":
    sys.exit(main())
