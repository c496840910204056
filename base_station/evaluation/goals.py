"""What the Z-transform tracker must reach, goal by goal: reached, or by how much not.

Some goals belong to other programs (the closed loop to scripts/benchmark-loop, loose targets to scripts/benchmark-otb);
here are those that this benchmark measures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from base_station.evaluation.costs import Costs
from base_station.evaluation.tracker_benchmark import BenchmarkScores, ConditionScore, TargetScore

CLEAN_FACTOR = 1.5
LIGHTS = ("gain_offset", "gamma", "gradient")


@dataclass(frozen=True, kw_only=True)
class Goal:
    """`figure` None: not measured, or nothing was tracked."""

    name: str
    figure: float | None
    bar: float
    is_largest: bool
    """The figure must not be above the bar; otherwise not below."""

    @property
    def is_reached(self) -> bool:
        if self.figure is None:
            return False
        return self.figure <= self.bar if self.is_largest else self.figure >= self.bar

    def verdict(self) -> str:
        """In words."""
        if self.figure is None:
            return "no figure: nothing was tracked"
        if self.is_reached:
            return "reached"
        return f"missed by {abs(self.figure - self.bar):.3g}"


MOST_LANDMARK_BYTES, MOST_LOOKUP_MS = 8192, 5.0


def goals_of(scores: BenchmarkScores, costs: Costs | None, tracker: str) -> list[Goal]:
    """The goals for which the conditions that were run have figures."""
    table = scores.conditions[tracker]
    goals = [*_exactness(table), *_under_light(table), *_memory_and_doubt(scores.targets[tracker])]
    return goals + (list(_speed(costs)) if costs is not None else [])


def bytes_goal(landmark_bytes: int) -> Goal:
    """What must be kept to find one target again."""
    return Goal(name="bytes to keep of a landmark", figure=landmark_bytes, bar=MOST_LANDMARK_BYTES, is_largest=True)


def lookup_goal(landmarks: int, lookup_ms: float) -> Goal:
    """One look-up among so many landmarks; the goal is for 500."""
    name = f"look-up among {landmarks} landmarks, ms a frame"
    return Goal(name=name, figure=lookup_ms, bar=MOST_LOOKUP_MS, is_largest=True)


def _exactness(table: dict[str, ConditionScore]) -> Iterator[Goal]:
    if "shift" in table:
        yield Goal(name="shift: median error, px", figure=table["shift"].median_px, bar=0.01, is_largest=True)
    if "noise" in table:
        yield Goal(name="noise: median error, px", figure=table["noise"].median_px, bar=0.03, is_largest=True)
    if "zoom" in table:
        zoom = table["zoom"]
        yield Goal(name="zoom: median error, px", figure=zoom.median_px, bar=0.15, is_largest=True)
        yield Goal(name="zoom: share within 1.5 px", figure=zoom.within_1_5, bar=0.98, is_largest=False)
        yield Goal(name="zoom: median zoom error", figure=zoom.zoom_err_median, bar=0.003, is_largest=True)
    if "all" in table:
        yield Goal(name="all: share within 1.5 px", figure=table["all"].within_1_5, bar=0.95, is_largest=False)


def _under_light(table: dict[str, ConditionScore]) -> Iterator[Goal]:
    clean = table["shift"].median_px if "shift" in table else None
    for name in LIGHTS if clean is not None else ():
        if name in table:
            median, share = table[name].median_px, table[name].within_1_5
            bar = CLEAN_FACTOR * (clean or 0.0)
            yield Goal(name=f"{name}: median error, px (1.5 x shift)", figure=median, bar=bar, is_largest=True)
            bar = 1 - CLEAN_FACTOR * (1 - table["shift"].within_1_5)
            yield Goal(name=f"{name}: share within 1.5 px (1.5 x misses)", figure=share, bar=bar, is_largest=False)


def _memory_and_doubt(target: TargetScore) -> Iterator[Goal]:
    yield bytes_goal(target.bytes_per_landmark)
    name = "false tracking where 99 % of the visible are tracked"
    yield Goal(name=name, figure=target.false_tracking_at_99, bar=0.01, is_largest=True)
    tracked = target.visible_tracked_share
    yield Goal(name="share of the visible that is tracked", figure=tracked, bar=0.99, is_largest=False)


def _speed(costs: Costs) -> Iterator[Goal]:
    us = costs.tracking_us
    yield Goal(name="tracking with a prediction, us a frame", figure=us, bar=100, is_largest=True)
    times = costs.phase_correlate_us / us
    yield Goal(name="times faster than cv2.phaseCorrelate", figure=times, bar=50, is_largest=False)
    yield Goal(name="times faster than ORB 1000", figure=costs.orb_us / us, bar=30, is_largest=False)
    yield Goal(name="finding again, us a frame", figure=costs.reacquisition_us, bar=1000, is_largest=True)
