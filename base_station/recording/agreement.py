"""How far two rows of results on the same frames agree: bit for bit, or in numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from base_station.types import TrackerResult, TrackingState


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Of results now against earlier ones. Differences are over the frames in which both are TRACKING; None: no such
    frame, or a tracker that does not tell it."""

    frames: int
    same: int
    """Frames in which every bit is the same."""
    first_difference: int | None
    """The first frame that differs, from 0."""
    difference: str
    """What differs there, in words."""
    same_state: int
    tracked_now: int
    tracked_then: int
    bearing_deg_rms: float | None
    bearing_deg_max: float | None
    shift_px_rms: float | None
    zoom_percent_rms: float | None

    @property
    def identical(self) -> bool:
        """There are frames, and every result is the same, bit for bit."""
        return self.frames == self.same > 0


def agreement(pairs: Sequence[tuple[TrackerResult, TrackerResult]]) -> Agreement:
    """`pairs`: now and then, frame by frame."""
    differ = [(place, text) for place, (now, then) in enumerate(pairs) if (text := difference(now, then))]
    bearings = np.degrees(_differences(pairs, "bearing_rad"))
    zooms = [
        100 * (now.zoom / then.zoom - 1)
        for now, then in pairs
        if now.zoom is not None and then.zoom is not None and _both_track(now, then)
    ]
    return Agreement(
        frames=len(pairs),
        same=len(pairs) - len(differ),
        first_difference=differ[0][0] if differ else None,
        difference=differ[0][1] if differ else "",
        same_state=sum(now.state is then.state for now, then in pairs),
        tracked_now=sum(now.state is TrackingState.TRACKING for now, _ in pairs),
        tracked_then=sum(then.state is TrackingState.TRACKING for _, then in pairs),
        bearing_deg_rms=rms(bearings),
        bearing_deg_max=float(np.abs(bearings).max()) if len(bearings) else None,
        shift_px_rms=rms(_differences(pairs, "shift_px")),
        zoom_percent_rms=rms(np.array(zooms)),
    )


def difference(now: TrackerResult, then: TrackerResult) -> str:
    """The first field that is not the same, in words; empty when all are."""
    for field in fields(TrackerResult):
        one, other = getattr(now, field.name), getattr(then, field.name)
        if not _same(one, other):
            return f"{field.name} {_text(one)} instead of {_text(other)}"
    return ""


def rms(values: np.ndarray) -> float | None:
    """Root mean square; None of nothing."""
    return math.sqrt(float(np.mean(np.square(values)))) if len(values) else None


def _same(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return one is not None and other is not None and bool(np.array_equal(np.asarray(one), np.asarray(other)))
    return bool(one == other)


def _text(value: object) -> str:
    return " ".join(str(value).split())[:60]


def _both_track(now: TrackerResult, then: TrackerResult) -> bool:
    return now.state is TrackingState.TRACKING and then.state is TrackingState.TRACKING


def _differences(pairs: Sequence[tuple[TrackerResult, TrackerResult]], name: str) -> np.ndarray:
    values = [(getattr(now, name), getattr(then, name)) for now, then in pairs if _both_track(now, then)]
    return np.array([float(one) - float(other) for one, other in values if one is not None and other is not None])
