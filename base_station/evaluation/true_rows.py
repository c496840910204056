"""What each frame of a simulated run showed, beside what was true when it was taken: packed, since a run may last for
hours, and bounded where nobody tells a truth: a real robot's may last for days. Measures are kept to seven digits."""

from __future__ import annotations

import math
from array import array
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

from base_station.types import TrackerResult, TrackingState
from protocol import Truth

T = TypeVar("T")
Key = tuple[str, int]
"""Of a frame: its connection and number."""

MAX_UNMATCHED = 300
"""So many frames wait for their truth, and truths for their frame: ten seconds of them."""
_STATES = tuple(TrackingState)
_NONE = math.nan


@dataclass(frozen=True, slots=True)
class Reading:
    """What the summary asks of a tracker's result; angles and range as in `TrackerResult`."""

    state: TrackingState
    reason: str
    bearing_rad: float | None
    view_angle_rad: float | None
    range_m: float | None
    compass_rad: float | None
    posed: bool
    """Whether it came with a pose."""

    @property
    def tracking(self) -> bool:
        return self.state is TrackingState.TRACKING


@dataclass(frozen=True, slots=True)
class TrueRow:
    """One frame."""

    index: int
    """In the order in which frames were noted, from 0."""
    time_s: float
    shown: Reading
    shadow: Reading | None
    pan_rad: float | None
    """None when the camera is fixed."""
    truth: Truth


class TrueRows:
    """Matches frames with their truths, which may come before or after them, and keeps both. One thread at a time."""

    def __init__(self) -> None:
        self._truths: OrderedDict[Key, Truth] = OrderedDict()
        self._frames: OrderedDict[Key, tuple[float, array[float]]] = OrderedDict()
        self._reasons: dict[str, int] = {}
        self._times_s, self._packed = array("d"), array("f")
        self._seen = 0
        self._last: Key | None = None

    @property
    def seen(self) -> int:
        """Frames noted, with and without a truth."""
        return self._seen

    @property
    def complete(self) -> bool:
        """Whether the last frame has its truth, if any frame has."""
        return not self._packed or self._last not in self._frames

    def note_truth(self, key: Key, truth: Truth) -> None:
        """The first one told of a frame counts."""
        frame = self._frames.pop(key, None)
        if frame is not None:
            self._pack(*frame, truth)
        elif key != self._last:
            _keep(self._truths, key, truth)

    def note_frame(
        self, key: Key, time_s: float, result: TrackerResult, shadow: TrackerResult | None, pan_rad: float | None
    ) -> None:
        """What a tracker, and one beside it, made of a frame."""
        frame = array("f", (self._seen, _number(pan_rad), *self._shown(result), *self._shown(shadow)))
        self._seen += 1
        self._last = key
        truth = self._truths.pop(key, None)
        if truth is not None:
            self._pack(time_s, frame, truth)
        else:
            _keep(self._frames, key, (time_s, frame))

    def rows(self, since: int = 0) -> list[TrueRow]:
        """Those with a truth, in the order in which their frames were noted, from the `since`-th frame on."""
        reasons = tuple(self._reasons)
        packed = memoryview(self._packed)
        starts = range(0, len(packed), ROW_NUMBERS)
        chosen = sorted((packed[start], start) for start in starts if packed[start] >= since)
        return [
            _row(self._times_s[start // ROW_NUMBERS], iter(packed[start : start + ROW_NUMBERS]), reasons)
            for _, start in chosen
        ]

    def _pack(self, time_s: float, frame: array[float], truth: Truth) -> None:
        self._times_s.append(time_s)
        self._packed += frame + _truth_packed(truth)

    def _shown(self, result: TrackerResult | None) -> tuple[float, ...]:
        if result is None:
            return (_NONE,) * SHOWN_NUMBERS
        reason = self._reasons.setdefault(result.reason, len(self._reasons))
        numbers = map(_number, (result.bearing_rad, result.view_angle_rad, result.range_m, result.compass_rad))
        return (_STATES.index(result.state), reason, *numbers, result.cam_from_world is not None)


SHOWN_NUMBERS = 7
ROW_NUMBERS = 2 + 2 * SHOWN_NUMBERS + 10


def _keep(waiting: OrderedDict[Key, T], key: Key, value: T) -> None:
    waiting.setdefault(key, value)
    if len(waiting) > MAX_UNMATCHED:
        waiting.popitem(last=False)


def _number(value: float | None) -> float:
    return _NONE if value is None else value


def _truth_packed(truth: Truth) -> array[float]:
    target = truth.target or (_NONE,) * 3
    measured = (_number(truth.bearing_rad), _number(truth.range_m), truth.in_view, truth.collisions)
    return array("f", (*truth.robot, *target, *measured))


def _row(time_s: float, numbers: Iterator[float], reasons: tuple[str, ...]) -> TrueRow:
    def optional() -> float | None:
        value = next(numbers)
        return None if math.isnan(value) else value

    def shown() -> Reading | None:
        state, reason = optional(), optional()
        bearing_rad, view_angle_rad, range_m, compass_rad, posed = (optional() for _ in range(5))
        if state is None or reason is None:
            return None
        told = _STATES[int(state)], reasons[int(reason)]
        return Reading(*told, bearing_rad, view_angle_rad, range_m, compass_rad, bool(posed))

    index, pan_rad = int(next(numbers)), optional()
    result, shadow = shown(), shown()
    assert result is not None
    robot = next(numbers), next(numbers), next(numbers)
    target = next(numbers), next(numbers), next(numbers)
    truth = Truth(
        robot=robot,
        target=None if math.isnan(target[0]) else target,
        bearing_rad=optional(),
        range_m=optional(),
        in_view=bool(next(numbers)),
        collisions=int(next(numbers)),
    )
    return TrueRow(index, time_s, result, shadow, pan_rad, truth)
