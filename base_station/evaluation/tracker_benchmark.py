"""Every tracker on the same disturbed views: how exact, how often, how sure of itself, how costly, how much kept.

For each world a tracker learns the reference view once. Then come the disturbed views, each a sudden change from the
learned view: before each the clock goes on by ten seconds and the reference view is shown again, not counted, so that
no tracker's motion model helps or hinders. A tracker that does not find the reference view itself learns it anew.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from base_station.evaluation.conditions import (
    CAMERA,
    CONDITIONS,
    TARGET,
    Disturbance,
    disturbed_view,
    looks_without_target,
    reference_view,
)
from base_station.evaluation.footprint import array_bytes, landmark_bytes
from base_station.evaluation.peer_trackers import make_any
from base_station.evaluation.worlds import World
from base_station.trackers.base import Tracker
from base_station.types import Frame, TrackerResult, TrackingState

WITHIN_PX = 1.5
VISIBLE_SHARE = 0.99
"""False tracking is also told at the confidence that this share of the visible targets reach."""
PAUSE_S, PERIOD_S = 10.0, 1 / 30
SETTLED_PX = 2.0
WARM_UPS = 5


@dataclass(frozen=True, kw_only=True)
class BenchmarkSettings:
    """What to run."""

    trackers: Sequence[str]
    conditions: Sequence[str] = tuple(CONDITIONS)
    frames: int = 200
    """Per tracker and condition, spread over the worlds."""
    seed: int = 0
    is_place: bool = False
    """The trackers learn the whole view, and the camera turns."""


@dataclass(frozen=True, kw_only=True)
class ConditionScore:
    """One tracker under one condition. None: it never tracked, or cannot tell."""

    frames: int
    median_px: float | None
    """Of the absolute error of shift_px, over the frames in which it was TRACKING."""
    within_1_5: float
    """Share of all frames, those LOST included, in which it was TRACKING with an error of at most 1.5 px."""
    zoom_err_median: float | None
    """Of |zoom / true zoom - 1|."""
    tracked_share: float
    us_p50: float
    """Median time of `update`, microseconds."""


@dataclass(frozen=True, kw_only=True)
class TargetScore:
    """One tracker over all conditions that were run."""

    bytes_per_landmark: int
    """What must be kept to find one learned target again, see `footprint`."""
    running_bytes: int
    """All arrays of the tracker while it follows that target."""
    visible_tracked_share: float
    """Of all frames that show the target."""
    frames_without_target: int
    false_tracking_rate: float
    """Share of frames without the target in which it was TRACKING all the same."""
    false_by_kind: dict[str, float]
    """The same, for each kind of frame without the target."""
    threshold_at_99: float | None
    """The confidence that 99 % of the visible targets reach; None when more than 1 % of them are LOST."""
    false_tracking_at_99: float
    """Share of frames without the target with at least that confidence; without one, the rate as it is."""


@dataclass
class _Tally:
    """What is noted of one tracker while the benchmark runs. One row a frame: error px, zoom error, confidence, us;
    LOST is NaN in the first three."""

    rows: dict[str, list[tuple[float, float, float, float]]] = field(default_factory=dict)
    false: dict[str, list[float]] = field(default_factory=dict)
    kept_bytes: list[tuple[int, int]] = field(default_factory=list)
    """To be kept, and of the running tracker."""


@dataclass(frozen=True)
class BenchmarkScores:
    """By tracker, then by condition."""

    conditions: dict[str, dict[str, ConditionScore]]
    targets: dict[str, TargetScore]
    errors_px: dict[str, dict[str, np.ndarray]]
    """Absolute errors of all frames, NaN where LOST: for plots."""


class Sitting:
    """One tracker in front of one world's reference view."""

    def __init__(self, name: str, reference: np.ndarray, *, is_place: bool = False) -> None:
        self._reference, self._target = reference, None if is_place else TARGET
        self._time_s, self._number = 0.0, 0
        self._tracker: Tracker = make_any(name)
        self.kept_bytes = landmark_bytes(self._tracker, self._learn)
        """None when the tracker refuses to learn this: it is LOST in all of this world then."""
        for _ in range(WARM_UPS if self.kept_bytes is not None else 0):
            self._tracker.update(self._frame(reference))
        self.running_bytes = array_bytes(self._tracker)

    def __enter__(self) -> Sitting:
        return self

    def __exit__(self, *_: object) -> None:
        self._tracker.close()

    def _learn(self) -> bool:
        try:
            self._tracker.learn(self._frame(self._reference), self._target)
        except ValueError:
            return False
        return True

    def _frame(self, image: np.ndarray) -> Frame:
        self._time_s += PERIOD_S
        self._number += 1
        return Frame(image=image, number=self._number, time_s=self._time_s, camera=CAMERA)

    def surprise(self, image: np.ndarray) -> tuple[TrackerResult, float]:
        """Show the reference, then this image; what the tracker says of it, and how long that took it in us."""
        if self.kept_bytes is None:
            return TrackerResult(state=TrackingState.LOST, reason="it would not learn this target"), float("nan")
        self.wait()
        for _ in range(3):
            settled = self._tracker.update(self._frame(self._reference))
            if settled.state is TrackingState.TRACKING and abs(settled.shift_px or 0) < SETTLED_PX:
                break
        else:
            self._learn()
        return self.show(image)

    def wait(self) -> None:
        """Let ten seconds go by."""
        self._time_s += PAUSE_S

    def show(self, image: np.ndarray) -> tuple[TrackerResult, float]:
        """The next frame, without more ado."""
        frame = self._frame(image)
        begin = time.perf_counter_ns()
        result = self._tracker.update(frame)
        return result, (time.perf_counter_ns() - begin) / 1000


def run_benchmark(
    settings: BenchmarkSettings, worlds: Sequence[World], on_step: Callable[[], None] = lambda: None
) -> BenchmarkScores:
    """`on_step` is called `benchmark_steps` times. Needs two worlds at least. Raises UnknownTracker, KeyError (a
    condition's name), ValueError (a tracker's file)."""
    worlds = worlds[: max(settings.frames, 2)]
    tallies = {name: _Tally() for name in settings.trackers}
    references = [reference_view(world, is_place=settings.is_place) for world in worlds]
    looks = max(settings.frames // (2 * len(worlds)), 1)
    for index, world in enumerate(worlds):
        other = worlds[(index + 1) % len(worlds)]
        reference = references[index]
        shown = list(_views(settings, index, world, other, len(worlds)))
        others, rng = references[index + 1 :] + references[:index], np.random.default_rng([settings.seed, index])
        strange = list(looks_without_target(reference, others, looks, rng, is_place=settings.is_place))
        for name, tally in tallies.items():
            with Sitting(name, reference, is_place=settings.is_place) as sitting:
                if sitting.kept_bytes is not None:
                    tally.kept_bytes.append((sitting.kept_bytes, sitting.running_bytes))
                for condition, disturbance, image in shown:
                    result, us = sitting.surprise(image)
                    tally.rows.setdefault(condition, []).append(_row(result, disturbance, us))
                    on_step()
                for kind, image in strange:
                    result, _ = sitting.surprise(image)
                    tracked = result.state is TrackingState.TRACKING
                    tally.false.setdefault(kind, []).append(result.confidence if tracked else float("nan"))
    return _scores(settings, tallies)


def benchmark_steps(settings: BenchmarkSettings) -> int:
    """How often `run_benchmark` calls `on_step`."""
    return settings.frames * len(settings.conditions) * len(settings.trackers)


def _views(
    settings: BenchmarkSettings, index: int, world: World, other: World, worlds: int
) -> Iterator[tuple[str, Disturbance, np.ndarray]]:
    """This world's part of the frames. A condition's views do not depend on which other conditions are run."""
    cover = other.view()
    for condition in settings.conditions:
        rng = np.random.default_rng([settings.seed, index, list(CONDITIONS).index(condition)])
        for _ in range(index, settings.frames, worlds):
            disturbance = CONDITIONS[condition](rng)
            yield (
                condition,
                disturbance,
                disturbed_view(world, disturbance, rng, cover=cover, is_place=settings.is_place),
            )


def _row(result: TrackerResult, truth: Disturbance, us: float) -> tuple[float, float, float, float]:
    nothing = float("nan")
    if result.state is not TrackingState.TRACKING:
        return nothing, nothing, nothing, us
    error_px = abs(result.shift_px - truth.dx) if result.shift_px is not None else nothing
    zoom_error = abs(result.zoom / truth.zoom - 1) if result.zoom is not None else nothing
    return error_px, zoom_error, result.confidence, us


def _scores(settings: BenchmarkSettings, tallies: dict[str, _Tally]) -> BenchmarkScores:
    tables = {name: {c: np.array(tally.rows[c]) for c in settings.conditions} for name, tally in tallies.items()}
    return BenchmarkScores(
        conditions={
            name: {condition: score_condition(rows) for condition, rows in table.items()}
            for name, table in tables.items()
        },
        targets={
            name: score_target(
                np.concatenate([rows[:, 2] for rows in tables[name].values()]),
                {kind: np.array(confidences) for kind, confidences in tally.false.items()},
                tally.kept_bytes,
            )
            for name, tally in tallies.items()
        },
        errors_px={name: {c: rows[:, 0] for c, rows in table.items()} for name, table in tables.items()},
    )


def score_condition(rows: np.ndarray) -> ConditionScore:
    """`rows`: shape (n, 4), a frame each: |error| px, |zoom error|, confidence (NaN when LOST), us."""
    error_px, zoom_error, confidence, us = rows.T
    return ConditionScore(
        frames=len(rows),
        median_px=_median(error_px),
        within_1_5=float((error_px <= WITHIN_PX).mean()),
        zoom_err_median=_median(zoom_error),
        tracked_share=float(np.isfinite(confidence).mean()),
        us_p50=_median(us) or 0.0,
    )


def score_target(
    visible: np.ndarray, strange: dict[str, np.ndarray], kept_bytes: Sequence[tuple[int, int]]
) -> TargetScore:
    """`visible`: confidences of all frames that show the target, `strange`: of those that do not; NaN when LOST.

    `kept_bytes`: of each target learned, what is to be kept, and what the running tracker holds.
    """
    without = np.concatenate(list(strange.values()))
    # The (1 % of n)-th lowest confidence, LOST counting as lowest of all.
    ordered = np.sort(np.nan_to_num(visible, nan=-1.0))
    lowest = float(ordered[int((1 - VISIBLE_SHARE) * len(ordered) + 1e-9)])
    threshold = lowest if lowest >= 0 else None
    return TargetScore(
        bytes_per_landmark=int(np.median([kept for kept, _ in kept_bytes])) if kept_bytes else 0,
        running_bytes=int(np.median([running for _, running in kept_bytes])) if kept_bytes else 0,
        visible_tracked_share=float(np.isfinite(visible).mean()),
        frames_without_target=len(without),
        false_tracking_rate=float(np.isfinite(without).mean()),
        false_by_kind={kind: float(np.isfinite(values).mean()) for kind, values in strange.items()},
        threshold_at_99=threshold,
        false_tracking_at_99=float((without >= (threshold or 0.0)).mean()),
    )


def _median(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else None
