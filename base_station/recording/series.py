"""What one tracker told over a whole source, and the figures made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from base_station.recording.agreement import rms
from base_station.recording.sources import TargetTruth
from base_station.types import TrackerResult, TrackingState

WARM_UP_FRAMES = 10
"""Not in the times: what is compiled or loaded when it is first needed."""


@dataclass(kw_only=True)
class Series:
    """Row by row: the frame's place in its source, its time, the result, and what the tracker took (NaN: unknown)."""

    name: str
    places: list[int] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    results: list[TrackerResult] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)
    learned_row: int | None = None
    """The first row with a target."""

    def add(self, place: int, time_s: float, result: TrackerResult, *, seconds: float, learned: bool) -> None:
        """One frame."""
        if learned and self.learned_row is None:
            self.learned_row = len(self.places)
        self.places.append(place)
        self.times_s.append(time_s)
        self.results.append(result)
        self.ms.append(seconds * 1e3)

    def values(self, name: str) -> np.ndarray:
        """(n,) of a measure of the results; NaN where it is not told."""
        told = (getattr(result, name) for result in self.results)
        return np.array([math.nan if value is None else float(value) for value in told])

    def truths(self) -> dict[int, TargetTruth]:
        """What it told, as something to compare others with."""
        rows = zip(self.places, self.results, strict=True)
        return {
            place: TargetTruth(bearing_rad=result.bearing_rad, zoom=result.zoom, shift_px=result.shift_px)
            for place, result in rows
            if result.state is TrackingState.TRACKING
        }


@dataclass(frozen=True, kw_only=True)
class TrackerFigures:
    """`against`: what the errors are measured against. None where it cannot be told."""

    tracker: str
    frames: int
    tracked_share: float
    """In state TRACKING, of all frames since the target was learned."""
    ms_p50: float | None
    ms_p95: float | None
    lost_frames: int
    lost_spans: int
    longest_lost_s: float
    against: str
    bearing_error_deg_rms: float | None
    zoom_error_percent_rms: float | None
    compared_frames: int
    """With a bearing on both sides."""


def figures(series: Series, reference: Mapping[int, TargetTruth], against: str) -> TrackerFigures:
    """Of one tracker, measured against the reference."""
    since = series.learned_row
    states = [result.state for result in series.results[since:]] if since is not None else []
    took = np.array(series.ms)
    took = took[WARM_UP_FRAMES:] if len(took) > 2 * WARM_UP_FRAMES else took
    took = took[np.isfinite(took)]
    spans = _lost_spans(series)
    bearings, zooms = _errors(series, reference)
    return TrackerFigures(
        tracker=series.name,
        frames=len(series.places),
        tracked_share=states.count(TrackingState.TRACKING) / len(states) if states else 0.0,
        ms_p50=float(np.median(took)) if len(took) else None,
        ms_p95=float(np.percentile(took, 95)) if len(took) else None,
        lost_frames=states.count(TrackingState.LOST),
        lost_spans=len(spans),
        longest_lost_s=max((end - begin for begin, end in spans), default=0.0),
        against=against,
        bearing_error_deg_rms=rms(np.degrees(bearings)),
        zoom_error_percent_rms=rms(100 * zooms),
        compared_frames=len(bearings),
    )


def _lost_spans(series: Series) -> list[tuple[float, float]]:
    """From the first LOST frame to the first that is not (or the last)."""
    rows = list(zip(series.times_s, series.results, strict=True))[series.learned_row or 0 :]
    spans, begin = [], None
    for lost, group in groupby(rows, key=lambda row: row[1].state is TrackingState.LOST):
        first_s = next(group)[0]
        if begin is not None:
            spans.append((begin, first_s))
        begin = first_s if lost else None
    return spans + ([(begin, rows[-1][0])] if begin is not None else [])


def _errors(series: Series, reference: Mapping[int, TargetTruth]) -> tuple[np.ndarray, np.ndarray]:
    bearings, zooms = [], []
    for place, result in zip(series.places, series.results, strict=True):
        known = reference.get(place)
        if known is None or result.state is not TrackingState.TRACKING:
            continue
        if known.bearing_rad is not None and result.bearing_rad is not None:
            bearings.append(math.remainder(result.bearing_rad - known.bearing_rad, 2 * math.pi))
        if known.zoom and result.zoom is not None:
            zooms.append(result.zoom / known.zoom - 1)
    return np.array(bearings), np.array(zooms)


def paired(now: Series, then: Series) -> Sequence[tuple[TrackerResult, TrackerResult]]:
    """The results of the frames that both have."""
    earlier = dict(zip(then.places, then.results, strict=True))
    rows = zip(now.places, now.results, strict=True)
    return [(result, earlier[place]) for place, result in rows if place in earlier]
