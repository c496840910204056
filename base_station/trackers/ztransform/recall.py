"""A tracker that knows its target from a landmark: found by the look-up, then followed as if learned a moment ago.

Until the landmark is recognised every frame is looked up; from then on the Z-transform tracker, which has learned the
landmark's small picture, goes on from where it was found. When that one has lost it for a while, it is looked up again.
"""

from __future__ import annotations

import contextlib

from base_station.geometry import PinholeCamera
from base_station.trackers.base import Shown, SignatureView
from base_station.trackers.ztransform.landmark import Landmark
from base_station.trackers.ztransform.lookup import LandmarkMemory
from base_station.trackers.ztransform.tracker import ZTransformTracker
from base_station.types import Box, Frame, TrackerResult, TrackingState

PATIENCE_S = 1.0
"""Lost by the tracker for so long: look it up again."""


class RecallTracker:
    """Follows one landmark. `learn` takes the landmark up; what the frame shows at that moment does not count."""

    def __init__(self, landmark: Landmark) -> None:
        self._landmark = landmark
        self._memory = LandmarkMemory()
        self._memory.add(landmark)
        self._warm_up()
        self._tracker = ZTransformTracker()
        self._learned = False
        self._seen_s: float | None = None

    def _warm_up(self) -> None:
        """Compile (or load) the look-up's kernels now, so that the first frames are not late."""
        with contextlib.suppress(ValueError):
            shown, _ = self._landmark.frame(PinholeCamera.with_fov(640, 480))
            shown.image.flags.writeable = False  # as a robot's pictures are: another type to compiled code
            self._memory.find(shown)

    def learn(self, frame: Frame, target: Box | None) -> None:
        """See `base.Tracker.learn`; the target is not needed. Raises ValueError when this camera makes it too small."""
        self._tracker.learn(*self._landmark.frame(frame.camera))
        self._learned, self._seen_s = True, None

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        if not self._learned:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="the landmark was not taken up yet")
        if self._seen_s is None:
            if not frame.is_whole:
                return TrackerResult(state=TrackingState.LOST, reason="looked for in whole frames only")
            sighting = next(iter(self._memory.find(frame)), None)
            if sighting is None:
                name = self._landmark.name
                return TrackerResult(state=TrackingState.LOST, reason=f"landmark {name!r} is not in view")
            self._tracker.expect(sighting.placement, frame.time_s)
            self._seen_s = frame.time_s
        result = self._tracker.update(frame)
        if result.state is TrackingState.TRACKING:
            self._seen_s = frame.time_s
        elif frame.time_s - self._seen_s > PATIENCE_S:
            self._seen_s = None
        return result

    def wanted_rows(self) -> tuple[int, int] | None:
        """See `base.WantsRows`. All while it is looked up."""
        return None if self._seen_s is None else self._tracker.wanted_rows()

    def show(self) -> Shown:
        """See `base.Shows`."""
        return self._tracker.show() if self._seen_s is not None else Shown()

    def show_signature(self) -> SignatureView | None:
        """See `base.Signs`."""
        return self._tracker.show_signature() if self._seen_s is not None else None

    def close(self) -> None:
        """Let go of the landmark."""
        self._tracker.close()
        self._learned = False
