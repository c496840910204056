"""scripts/benchmark-trackers: every tracker on the same views, side by side; see `tracker_benchmark` for how."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from threadpoolctl import threadpool_limits

from base_station.errors import StationError
from base_station.evaluation.benchmark_plots import cost_against_exactness, error_curves
from base_station.evaluation.benchmark_report import (
    PLAIN_WIDTH,
    as_json,
    condition_table,
    cost_table,
    goal_table,
    machine_line,
    target_table,
)
from base_station.evaluation.conditions import CONDITIONS
from base_station.evaluation.costs import Costs, measure_costs
from base_station.evaluation.goals import Goal, goals_of, lookup_goal
from base_station.evaluation.landmark_benchmark import measure_lookup_ms
from base_station.evaluation.peer_trackers import make_any
from base_station.evaluation.peers import PEERS
from base_station.evaluation.tool import run_tool
from base_station.evaluation.tracker_benchmark import (
    BenchmarkScores,
    BenchmarkSettings,
    benchmark_steps,
    run_benchmark,
)
from base_station.evaluation.worlds import World, generated_world, photographed_worlds
from base_station.output_files import check_output
from base_station.trackers.registry import DEFAULT_TRACKER, tracker_names

PROG = "benchmark-trackers"
MOST_FRAMES = 10_000
QUICK_FRAMES, QUICK_WORLDS = 12, 2
LANDMARKS, QUICK_LANDMARKS, LOOKUP_VIEWS = 500, 20, 60


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """Compare trackers on disturbed views whose truth is known: exactness, share, zoom, cost, memory, false tracking.

    median px is over the frames in which the tracker was TRACKING; within 1.5 px over all, LOST ones among them.
    """

    trackers: str = ",".join(tracker_names())
    """Which, apart by commas; also path/to/file.py:ClassName."""
    peers: bool = False
    """OpenCV's MOSSE, KCF and CSRT as well (an environment of their own is made for them, once)."""
    conditions: str = ",".join(CONDITIONS)
    """Which, apart by commas."""
    images: Path | None = None
    """A folder of photographs of any size to use as worlds, instead of generated ones."""
    worlds: int | None = None
    """Generated worlds: 10 by default, none with --images."""
    frames: int = 200
    """Per tracker and condition, spread over the worlds."""
    seed: int = 0
    """Of the worlds and of every disturbance."""
    place: bool = False
    """Learn the whole view instead of a box, and turn the camera instead of displacing the target."""
    quick: bool = False
    """12 frames of 2 worlds, few timings: to see that it works, not for figures."""
    json: Path | None = None
    """Write all figures to this file."""
    plots: Path | None = None
    """Draw errors.png and cost.png into this folder."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 done, 1 failed, 2 wrong usage."""
    return run_tool(Benchmark, PROG, arguments, _run)


def _run(command: Benchmark, arguments: Sequence[str]) -> None:
    console = Console()
    if not console.is_terminal:
        console.width = PLAIN_WIDTH  # of a file there is no width to keep to
    settings = _checked(command)
    worlds = _worlds(command, console)
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        with threadpool_limits(1):
            scores = _measure(settings, worlds, console)
            costed = DEFAULT_TRACKER in settings.trackers and not settings.is_place
            rounds = 1 if command.quick else 5
            costs = measure_costs(DEFAULT_TRACKER, worlds[0], rounds=rounds, seed=command.seed) if costed else None
            lookup = _measure_lookup(command, worlds, console) if costed else []
    finally:
        cv2.setNumThreads(threads)
    goals = (
        {DEFAULT_TRACKER: goals_of(scores, costs, DEFAULT_TRACKER) + lookup}
        if DEFAULT_TRACKER in settings.trackers
        else {}
    )
    line = shlex.join([f"scripts/{PROG}", *arguments])
    _print(console, settings, scores, costs, goals, worlds, line)
    if command.json is not None:
        run = {"command": line, "worlds": [world.name for world in worlds], "frames": settings.frames,
               "seed": settings.seed, "place": settings.is_place}  # fmt: skip
        _write(command.json, (json.dumps(as_json(scores, costs, goals, run), indent=2) + "\n").encode())
    if command.plots is not None:
        for name, picture in (("errors", error_curves(scores)), ("cost", cost_against_exactness(scores))):
            _write(command.plots / f"{name}.png", bytes(cv2.imencode(".png", picture)[1]))


def _checked(command: Benchmark) -> BenchmarkSettings:
    """Find mistakes of usage before anything is measured."""
    trackers, conditions = _listed(command.trackers, "--trackers"), _listed(command.conditions, "--conditions")
    trackers += PEERS if command.peers else ()
    for name in trackers:
        try:
            make_any(name).close()
        except ValueError as error:
            raise StationError(str(error), usage=True) from error
    for name in conditions:
        if name not in CONDITIONS:
            raise StationError(f"no condition {name!r}. There are: {', '.join(CONDITIONS)}", usage=True)
    frames = QUICK_FRAMES if command.quick else command.frames
    for option, value, most in (("--frames", frames, MOST_FRAMES), ("--worlds", command.worlds or 2, 100)):
        if not 1 <= value <= most:
            raise StationError(f"{option} must be 1..{most}, not {value}.", usage=True)
    if not 0 <= command.seed < 2**32:
        raise StationError(f"--seed must be 0..{2**32 - 1}, not {command.seed}.", usage=True)
    check_output("--json", command.json)
    if command.plots is not None:
        try:
            command.plots.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StationError(f"--plots: {command.plots} cannot be made ({error.strerror}).", usage=True) from error
    return BenchmarkSettings(
        trackers=trackers, conditions=conditions, frames=frames, seed=command.seed, is_place=command.place
    )


def _listed(text: str, option: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise StationError(f"{option} {text!r} names none.", usage=True)
    return list(dict.fromkeys(names))


def _worlds(command: Benchmark, console: Console) -> list[World]:
    """Photographs first; one generated world besides where there is only one, as what hides the target."""
    default = QUICK_WORLDS if command.quick else 10
    generated = command.worlds if command.worlds is not None else 0 if command.images is not None else default
    with console.status("drawing worlds"):
        worlds = photographed_worlds(command.images, command.seed) if command.images is not None else []
        worlds += [generated_world(command.seed + number) for number in range(generated)]
        if len(worlds) < 2:
            worlds.append(generated_world(command.seed + generated))
    return worlds


def _measure(settings: BenchmarkSettings, worlds: list[World], console: Console) -> BenchmarkScores:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task("updates", total=benchmark_steps(settings))
        return run_benchmark(settings, worlds, lambda: progress.advance(task))


def _measure_lookup(command: Benchmark, worlds: list[World], console: Console) -> list[Goal]:
    """Its landmarks are the default tracker's."""
    landmarks = QUICK_LANDMARKS if command.quick else LANDMARKS
    with console.status("learning landmarks"):
        ms = measure_lookup_ms(worlds, landmarks=landmarks, views=LOOKUP_VIEWS, seed=command.seed)
    return [lookup_goal(landmarks, ms)]


def _print(
    console: Console,
    settings: BenchmarkSettings,
    scores: BenchmarkScores,
    costs: Costs | None,
    goals: dict[str, list[Goal]],
    worlds: list[World],
    line: str,
) -> None:
    console.print(f"machine: {machine_line()}", highlight=False, soft_wrap=True)
    console.print(f"command: {line}", highlight=False, soft_wrap=True, markup=False)
    names = ", ".join(world.name for world in worlds)
    console.print(
        f"{settings.frames} frames a condition; worlds: {names}", highlight=False, soft_wrap=True, markup=False
    )
    for condition in settings.conditions:
        console.print(condition_table(scores, condition))
    console.print("at 99 %: the confidence that 99 % of the visible targets reach; LOST: there is none, more are LOST")
    console.print("median px and zoom error are over the frames tracked; within 1.5 px counts LOST frames as misses")
    console.print(target_table(scores))
    if costs is not None:
        console.print(cost_table(costs))
    for tracker, list_of in goals.items():
        console.print(goal_table(list_of, tracker))


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error


if __name__ == "__main__":
    sys.exit(main())
