"""scripts/compare-slam: ORB-SLAM3 and our SLAM on the same pictures in real time, several times each, side by side.

Both run as programs of their own, turn by turn, so that a machine that gets busier does so for both. ORB-SLAM3 is not
deterministic, and ours not in real time: the table has every run, and the medians.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from base_station.errors import StationError
from base_station.evaluation.benchmark_report import machine, machine_line
from base_station.evaluation.slam.orbslam_files import write_settings, write_vocabulary
from base_station.evaluation.slam.sequence import SlamSequence, read_sequence
from base_station.evaluation.tool import run_tool
from base_station.evaluation.tracking_command import check_options, plain_console
from base_station.output_files import write_json
from base_station.trackers.slam.vocabulary import Vocabulary

PROG = "compare-slam"
ROOT = Path(__file__).resolve().parents[3]
PEER = ROOT / "scripts" / "peers" / "orbslam3.py"
PEER_PYTHON = ROOT / ".venv-orbslam3" / "bin" / "python"
OURS, THEIRS = "zservo", "ORB-SLAM3"
LOCAL_VOCABULARY = "import pyorbslam3; print(pyorbslam3.vocabulary_path(download=False))"
COLUMNS = (
    ("tracked", "tracked_share", "{:.1%}"),
    ("ATE RMSE", "ate_rmse", "{:.4f}"),
    ("ATE at once", "ate_online_rmse", "{:.4f}"),
    ("RPE, 1 s", "rpe_1s_trans_rmse", "{:.4f}"),
    ("ms p50", "ms_p50", "{:.1f}"),
    ("ms p95", "ms_p95", "{:.1f}"),
    ("ms max", "ms_max", "{:.0f}"),
    ("dropped", "dropped_frames", "{:.0f}"),
    ("keyframes", "keyframes", "{:.0f}"),
    ("MiB", "memory_mib", "{:.0f}"),
)
"""Heading, figure, format."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Run ORB-SLAM3 and zservo's SLAM on a sequence in real time, and print both. Without ORB-SLAM3, ours alone."""

    folder: tyro.conf.Positional[Path]
    """A sequence in TUM, EuRoC or KITTI layout."""
    runs: int = 3
    """Of each."""
    camera: str | None = None
    """ORB-SLAM's YAML file, instead of the folder's own calibration."""
    vocabulary: Path | None = None
    """For ORB-SLAM3: its ORBvoc.txt. Default: the copy that pyorbslam3 has fetched, else ours in its format."""
    max_frames: int | None = None
    """At the most."""
    json: Path | None = None
    """Write all figures of all runs to this file."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 done, 1 failed, 2 wrong usage."""
    return run_tool(Comparison, PROG, arguments, _run)


def _run(command: Comparison, arguments: Sequence[str]) -> None:
    check_options(command.max_frames, command.json)
    if not 1 <= command.runs <= 100:
        raise StationError(f"--runs must be 1..100, not {command.runs}.", usage=True)
    sequence = read_sequence(command.folder, camera=command.camera, max_frames=command.max_frames)
    systems = [OURS, THEIRS] if PEER_PYTHON.is_file() else [OURS]
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in systems}
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as at:
        folder = Path(at)
        programs, vocabulary = {OURS: _ours(command)}, ""
        if THEIRS in systems:
            programs[THEIRS], vocabulary = _theirs(command, sequence, folder)
        for number in range(1, command.runs + 1):
            for name in systems:
                print(f"{PROG}: {name}, run {number} of {command.runs}", file=sys.stderr)
                try:
                    found[name].append(run_program(programs[name], folder / "figures.json"))
                except StationError as error:  # the other runs still tell something
                    print(f"{PROG}: {error}", file=sys.stderr)
                    found[name].append({"failed": str(error)})
    console = plain_console()
    console.print(f"machine: {machine_line().removesuffix('; one thread')}", highlight=False, soft_wrap=True)
    console.print(f"load before the runs: {load:.1f}", highlight=False)
    console.print(f"camera: {sequence.camera_source}", highlight=False, soft_wrap=True, markup=False)
    if vocabulary:
        console.print(f"vocabulary of ORB-SLAM3: {vocabulary}", highlight=False, soft_wrap=True, markup=False)
    console.print(comparison_table(f"{sequence.name}, {len(sequence)} pictures, real time", found))
    if THEIRS not in systems:
        print(f"ORB-SLAM3 is not installed: scripts/{PROG} tells in its first lines how to get it.", file=sys.stderr)
    if command.json is not None:
        write_json(command.json, found | {"_machine": machine(), "_run": {"command": [PROG, *arguments]}})
    for name, runs in found.items():
        if all("failed" in figures for figures in runs):
            raise StationError(f"{name} failed in every run.")


def _ours(command: Comparison) -> list[str]:
    options = ["--camera", command.camera] if command.camera is not None else []
    program = [sys.executable, "-m", "base_station", "evaluate", "slam", str(command.folder.resolve()), "--realtime"]
    return program + options + _limit(command)


def _theirs(command: Comparison, sequence: SlamSequence, folder: Path) -> tuple[list[str], str]:
    """The program, and what its vocabulary is."""
    settings = folder / "settings.yaml"
    seconds = float(sequence.times_s[-1] - sequence.times_s[0])
    write_settings(settings, sequence.camera, (len(sequence) - 1) / seconds)
    vocabulary, words = command.vocabulary or _fetched_vocabulary(), ""
    if vocabulary is None:
        vocabulary, words = folder / "vocabulary.txt", "zservo's own"
        write_vocabulary(vocabulary, Vocabulary.load())
    elif not vocabulary.is_file():
        raise StationError(f"--vocabulary: there is no file {vocabulary}.", usage=True)
    program = [str(PEER_PYTHON), str(PEER), str(command.folder.resolve()), "--realtime"]
    program += ["--vocabulary", str(vocabulary), "--settings", str(settings)]
    return program + _limit(command), words or vocabulary.name


def _fetched_vocabulary() -> Path | None:
    asked = subprocess.run([str(PEER_PYTHON), "-c", LOCAL_VOCABULARY], capture_output=True, text=True, check=False)
    return Path(asked.stdout.strip()) if asked.returncode == 0 and asked.stdout.strip() else None


def _limit(command: Comparison) -> list[str]:
    return ["--max-frames", str(command.max_frames)] if command.max_frames is not None else []


def run_program(program: Sequence[str], file: Path) -> dict[str, Any]:
    """The figures that it writes with --json, which is the last thing that it does: a crash afterwards
    (ORB-SLAM3's threads) loses nothing. Raises StationError with the program's last words when there are none."""
    with contextlib.suppress(FileNotFoundError):
        file.unlink()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [*program, "--json", str(file)], env=environment, capture_output=True, text=True, errors="replace", check=False
    )
    try:
        figures: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        said = (done.stderr or done.stdout).strip().splitlines() or ["it said nothing"]
        text = f"{' '.join(program[:3])} failed with exit code {done.returncode}: {said[-1]}"
        raise StationError(text) from None
    return figures


def comparison_table(title: str, found: dict[str, list[dict[str, Any]]]) -> Table:
    """A row per run, and per system the medians of those runs that have the figure."""
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    table.add_column("system", min_width=16)
    for heading, _, _ in COLUMNS:
        table.add_column(heading, justify="right")
    for name, runs in found.items():
        for number, figures in enumerate(runs, 1):
            table.add_row(f"{name} {number}", *(_cell(form, figures.get(key)) for _, key, form in COLUMNS))
        medians = []
        for _, key, form in COLUMNS:
            values = [figures[key] for figures in runs if figures.get(key) is not None]
            medians.append(_cell(form, median(values) if values else None))
        table.add_row(f"{name} median", *medians, style="bold", end_section=True)
    return table


def _cell(form: str, value: float | None) -> str:
    return "-" if value is None else form.format(value)


if __name__ == "__main__":
    sys.exit(main())
