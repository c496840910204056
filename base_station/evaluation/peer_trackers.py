"""OpenCV's MOSSE, KCF and CSRT in front of the benchmark's views, beside the trackers of the registry.

They run where OpenCV's contrib wheel is (`scripts/benchmark-trackers --peers` sees to it). They know neither a
confidence nor, but for CSRT and its scale filter, a zoom.
"""

from __future__ import annotations

import cv2

from base_station.evaluation.peers import PEERS, make_peer
from base_station.trackers.base import Tracker
from base_station.trackers.registry import make_tracker
from base_station.types import Box, Frame, TrackerResult, TrackingState

WITH_ZOOM = ("csrt",)


class PeerTracker:
    """One of OpenCV's trackers as a `base.Tracker`. It gets the gray picture in three channels."""

    def __init__(self, name: str) -> None:
        """Raises StationError when this OpenCV does not have it."""
        self._follower, self._knows_zoom = make_peer(name), name in WITH_ZOOM
        self._learned: Box | None = None

    def learn(self, frame: Frame, target: Box | None) -> None:
        """See `base.Tracker.learn`; of a place it learns the middle, to have room to follow."""
        rows, columns = frame.shape
        box = target if target is not None else Box(columns / 4, rows / 4, columns / 2, rows / 2)
        self._follower.start(cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR), box)
        self._learned = box

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        if self._learned is None:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
        box = self._follower.next(cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR))
        if box is None:
            return TrackerResult(state=TrackingState.LOST, reason="it says that it failed")
        (x, y), (learned_x, learned_y) = box.center_px, self._learned.center_px
        return TrackerResult(
            state=TrackingState.TRACKING,
            shift_px=x - learned_x,
            shift_y_px=y - learned_y,
            bearing_rad=frame.camera.bearing_rad(x),
            zoom=box.width / self._learned.width if self._knows_zoom else None,
            confidence=1.0,
            box=box,
        )

    def close(self) -> None:
        """Let go of the target."""
        self._learned = None


def make_any(name: str) -> Tracker:
    """A peer, or what `make_tracker` makes. Raises StationError, ValueError as these do."""
    return PeerTracker(name) if name in PEERS else make_tracker(name)
