"""What the benchmark found, as tables for people and as JSON for programs."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from base_station.evaluation.costs import Costs
from base_station.evaluation.goals import Goal
from base_station.evaluation.tracker_benchmark import BenchmarkScores, ConditionScore

PLAIN_WIDTH = 140
"""Of tables that go into a file: there is no terminal's to keep to."""
PACKAGES = ("numpy", "opencv-python-headless", "opencv-contrib-python-headless", "numba")


def machine() -> dict[str, Any]:
    """What the figures were measured with."""
    return {
        "cores": os.cpu_count(),
        "architecture": platform.machine(),
        "python": platform.python_version(),
        "packages": {name: found for name in PACKAGES if (found := _version(name)) is not None},
    }


def machine_line() -> str:
    """The same in one line."""
    it = machine()
    packages = ", ".join(f"{name} {number}" for name, number in it["packages"].items())
    return f"{it['cores']} cores, {it['architecture']}, Python {it['python']}, {packages}; one thread"


def _bytes(count: int) -> str:
    """Of a tracker whose memory is not Python's nothing is known."""
    return str(count) if count else "-"


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def as_json(
    scores: BenchmarkScores, costs: Costs | None, goals: Mapping[str, Sequence[Goal]], run: dict[str, Any]
) -> dict[str, Any]:
    """{tracker: {condition: {median_px, within_1_5, ...}}}, and beside the trackers keys with an underscore."""
    tables: dict[str, Any] = {
        name: {condition: asdict(score) for condition, score in table.items()}
        for name, table in scores.conditions.items()
    }
    return tables | {
        "_trackers": {name: asdict(score) for name, score in scores.targets.items()},
        "_costs": asdict(costs) if costs is not None else None,
        "_goals": {name: [_goal_as_json(goal) for goal in list_of] for name, list_of in goals.items()},
        "_machine": machine(),
        "_run": run,
    }


def _goal_as_json(goal: Goal) -> dict[str, Any]:
    """The bar is the largest or the smallest figure that reaches the goal."""
    bar = "at_most" if goal.is_largest else "at_least"
    return {"goal": goal.name, bar: goal.bar, "figure": goal.figure, "reached": goal.is_reached}


def _table(title: str, first: str, *numbers: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD)
    table.add_column(first, min_width=14)
    for heading in numbers:
        table.add_column(heading, justify="right")
    return table


def condition_table(scores: BenchmarkScores, condition: str) -> Table:
    """A row per tracker."""
    table = _table(condition, "tracker", "median px", "within 1.5 px", "zoom error", "tracked", "us a frame")
    for name, by_condition in scores.conditions.items():
        table.add_row(name.rpartition("/")[2], *_cells(by_condition[condition]))
    return table


def _cells(score: ConditionScore) -> tuple[str, ...]:
    return (
        "-" if score.median_px is None else f"{score.median_px:.3f}",
        f"{score.within_1_5:.1%}",
        "-" if score.zoom_err_median is None else f"{score.zoom_err_median:.2%}",
        f"{score.tracked_share:.1%}",
        f"{score.us_p50:.0f}",
    )


def target_table(scores: BenchmarkScores) -> Table:
    """A row per tracker: memory, and how often it saw what was not there."""
    kinds = list(next(iter(scores.targets.values())).false_by_kind)
    numbers = ("bytes to keep", "bytes running", "visible tracked", "false tracking", *kinds, "at 99 %", "false there")
    table = _table("memory, and frames without the target", "tracker", *numbers)
    for name, score in scores.targets.items():
        at_99 = "LOST" if score.threshold_at_99 is None else f"{score.threshold_at_99:.2f}"
        table.add_row(
            name.rpartition("/")[2],
            _bytes(score.bytes_per_landmark),
            _bytes(score.running_bytes),
            f"{score.visible_tracked_share:.1%}",
            f"{score.false_tracking_rate:.1%}",
            *(f"{score.false_by_kind[kind]:.0%}" for kind in kinds),
            at_99,
            f"{score.false_tracking_at_99:.1%}",
        )
    return table


def cost_table(costs: Costs) -> Table:
    """Times at 640x480, and how many times that of tracking each is."""
    table = _table(f"cost of a 640x480 frame, {costs.tracker}", "what", "us (median)", "times tracking")
    share = f"{costs.reacquired_share:.0%} found in that one frame"
    rows = (
        ("tracking with a prediction", costs.tracking_us),
        (f"finding again after LOST, zoom 0.45 to 2.2 ({share})", costs.reacquisition_us),
        ("cv2.phaseCorrelate of the whole frame", costs.phase_correlate_us),
        ("cv2.ORB, 1000 features", costs.orb_us),
    )
    for what, us in rows:
        table.add_row(what, f"{us:.0f}", f"{us / costs.tracking_us:.1f}")
    return table


def goal_table(goals: Sequence[Goal], tracker: str) -> Table:
    """A row per goal: reached, or by how much not."""
    table = _table(f"goals, {tracker}", "goal", "bar", "figure", "verdict")
    for goal in goals:
        bar = f"{'<=' if goal.is_largest else '>='} {goal.bar:.4g}"
        figure = "-" if goal.figure is None else f"{goal.figure:.4g}"
        table.add_row(goal.name, bar, figure, goal.verdict(), style="green" if goal.is_reached else "red")
    return table
