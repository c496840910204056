"""Looks at frames with a tracker, and with a second one in its shadow: what is learned when, and who looks.

Pure: frames and wishes in, results out, no socket and no clock but the stop-watch. The station drives by it, and a
replay runs it again on recorded frames.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from base_station.errors import StationError
from base_station.geometry import PinholeCamera
from base_station.rows import Rows, united
from base_station.scale import Scale
from base_station.trackers.base import Tracker, WantsRows
from base_station.trackers.own import checked, close_tracker
from base_station.types import Box, Frame, TrackerResult, TrackingState

ScaleMaker = Callable[[Box | None, PinholeCamera], Scale | None]
"""From the box that is learned (None: the whole view) and the camera to the scale."""


@dataclass(frozen=True, kw_only=True)
class Kit:
    """A tracker and what belongs to it."""

    name: str
    tracker: Tracker
    scale: ScaleMaker | None = None
    """Results then carry metres."""
    knows_target: bool = False
    """It follows something learned earlier: `learn` takes that up, whatever the frame shows."""


@dataclass(frozen=True, kw_only=True)
class Sighting:
    """What was seen in one frame."""

    result: TrackerResult
    learned: bool
    """The target was learned in this frame."""
    tracker_s: float
    """What the tracker took (learning not included)."""


class Watcher:
    """`retire` gets each tracker that is no longer used."""

    def __init__(
        self,
        kit: Kit,
        *,
        shadow: Kit | None = None,
        target_rows: int | None = None,
        retire: Callable[[Tracker], None] = close_tracker,
    ) -> None:
        self._kit, self._shadow, self._target_rows, self._retire = kit, shadow, target_rows, retire
        self._next: Kit | None = None
        self._asked = False
        self._shadow_learned = False
        self._scale: Scale | None = None
        self.learned = False
        """Something was learned, and the tracker looks for it."""
        self.target: Box | None = None
        """What was learned last, or is to be: the whole view, when there is no box."""
        self.complaint = ""
        """Why the target cannot be learned; it is tried again in every frame. Empty when it can."""

    @property
    def tracker(self) -> Tracker:
        return self._kit.tracker

    @property
    def trackers(self) -> list[Tracker]:
        """Those that look: the first one, and its shadow."""
        return [self.tracker] + ([self._shadow.tracker] if self._shadow is not None else [])

    @property
    def name(self) -> str:
        return self._kit.name

    @property
    def shadow_name(self) -> str | None:
        return self._shadow.name if self._shadow is not None else None

    def choose(self, target: Box | None) -> None:
        """Learn this in the next whole frame; None: the whole view."""
        if target is not None and self._target_rows is not None:
            target = target.with_rows(self._target_rows)
        self.target, self._asked = target, True

    def exchange(self, kit: Kit) -> None:
        """From the next whole frame on look with this one. It learns the target where the present one sees it there;
        does it not see it, there is nothing to learn until the target is chosen anew."""
        if self._next is not None:
            self._retire(self._next.tracker)
        self._next = kit

    def exchange_shadow(self, kit: Kit | None) -> None:
        """Look with this one besides. It learns the target as soon as the first tracker sees it."""
        if self._shadow is not None:
            self._retire(self._shadow.tracker)
        self._shadow, self._shadow_learned = kit, False

    def look(self, frame: Frame) -> Sighting:
        """Learn what is to be learned, and look. Raises StationError when a user's tracker gives no result."""
        if self._next is not None and frame.is_whole:
            self._take_next(self._next, frame)
        learned = self._learn(frame)
        begun_s = time.perf_counter()
        result = self._result(frame)
        return Sighting(result=result, learned=learned, tracker_s=time.perf_counter() - begun_s)

    def look_in_shadow(self, frame: Frame, seen: Sighting) -> TrackerResult | None:
        """What the second tracker sees in the frame that was just looked at; None without one."""
        if self._shadow is None:
            return None
        tracker = self._shadow.tracker
        target, learn = self.target, seen.learned
        if not self._shadow_learned and not learn and frame.is_whole and self._sees_target(seen.result):
            target, learn = self._target_in(seen.result), True
        if learn:
            try:
                tracker.learn(frame, target)
            except ValueError as error:
                return TrackerResult(state=TrackingState.INITIALIZING, reason=str(error))
            self._shadow_learned = True
        return checked(tracker, tracker.update(frame))

    def wanted_rows(self) -> Rows | None:
        """What serves both trackers; to learn, the whole frame is needed (None)."""
        if self._asked or not self.learned or self._next is not None:
            return None
        trackers = [self.tracker]
        if self._shadow is not None:
            if not self._shadow_learned:
                return None
            trackers.append(self._shadow.tracker)
        return united([_rows_of(tracker) for tracker in trackers])

    def close(self) -> None:
        """Retire both trackers."""
        for kit in (self._kit, self._next, self._shadow):
            if kit is not None:
                self._retire(kit.tracker)

    def _take_next(self, kit: Kit, frame: Frame) -> None:
        self._next = None
        seen = self._result(frame) if self.learned else None
        self._retire(self.tracker)
        self._kit, self._scale, self.learned, self.complaint = kit, None, False, ""
        if kit.knows_target:
            self.target, self._asked = None, True
        elif seen is not None and self._sees_target(seen):
            self.target, self._asked = self._target_in(seen), True

    def _sees_target(self, result: TrackerResult) -> bool:
        """Another tracker can learn it from this frame: where there is a box, it is known where it went."""
        return result.state is TrackingState.TRACKING and (self.target is None or result.box is not None)

    def _target_in(self, result: TrackerResult) -> Box | None:
        return None if self.target is None else result.box

    def _learn(self, frame: Frame) -> bool:
        """Learn when it is asked for; a view that cannot be learned (a camera that is still dark) is tried again."""
        if not self._asked or not frame.is_whole:
            return False
        try:
            self.tracker.learn(frame, self.target)
        except ValueError as error:
            self.complaint = str(error)
            return False
        self._asked, self.learned, self.complaint = False, True, ""
        if self._kit.scale is not None:
            self._scale = self._kit.scale(self.target, frame.camera)
        return True

    def _result(self, frame: Frame) -> TrackerResult:
        if self.complaint and not self.learned:
            return TrackerResult(state=TrackingState.INITIALIZING, reason=self.complaint)
        result = checked(self.tracker, self.tracker.update(frame))
        return self._scale.measured(result) if self._scale is not None else result


def _rows_of(tracker: Tracker) -> Rows | None:
    """The rows that this tracker wants."""
    rows: object = tracker.wanted_rows() if isinstance(tracker, WantsRows) else None
    if rows is None:
        return None
    if not isinstance(rows, tuple) or len(rows) != 2 or not all(isinstance(row, int) for row in rows):
        kind = type(tracker).__name__
        raise StationError(f"{kind}.wanted_rows returned {rows!r:.60}, not two whole rows or None: the run ends here.")
    return rows
