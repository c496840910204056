"""Phase correlation, the plain reference: where has the picture moved, if nothing but a shift happened.

The patch learned is compared with the patch of the same size where the target was last (the whole view for a place);
the peak of the phase correlation is the shift between the two. It knows no zoom and no rotation.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.types import Box, Frame, TrackerResult, TrackingState


@dataclass(frozen=True, kw_only=True)
class PhaseSettings:
    """When to believe the peak."""

    least_response: float = 0.08
    """Of cv2.phaseCorrelate, 0..1: the energy under the peak. Views of other things give 0.03."""
    least_contrast: float = 2.0
    """Standard deviation of the patch, grey levels."""
    smallest_side_px: int = 8
    """Of the target."""


class PhaseTracker:
    """cv2.phaseCorrelate, at most once a frame and once more where that found the target."""

    def __init__(self, *, settings: PhaseSettings | None = None) -> None:
        self._settings = settings or PhaseSettings()
        self._learned: np.ndarray | None = None

    def learn(self, frame: Frame, target: Box | None) -> None:
        """Remember the patch. Raises ValueError as `base.Tracker.learn` does."""
        height, width = frame.image.shape
        box = (target or Box(0, 0, width, height)).clipped(width, height)
        if box is None:
            raise ValueError("the box is outside of the frame")
        columns, rows = round(box.width), round(box.height)
        if min(columns, rows) < self._settings.smallest_side_px:
            raise ValueError(f"the target is too small: {columns}x{rows} px")
        x, y = box.center_px
        patch = _cut(frame.image, x, y, columns, rows)
        if float(patch.std()) < self._settings.least_contrast:
            raise ValueError(f"featureless: the target's contrast is {patch.std():.1f} grey levels")
        self._learned, self._window = patch, cv2.createHanningWindow((columns, rows), cv2.CV_32F)
        self._learned_at = self._last_at = (x, y)
        self._frame_shape, self._is_place = frame.image.shape, target is None

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        if self._learned is None:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
        if frame.image.shape != self._frame_shape:
            now, then = frame.image.shape, self._frame_shape
            return _lost(f"the frame is {now[1]}x{now[0]}, learned in {then[1]}x{then[0]}")
        start = self._learned_at if self._is_place else self._last_at
        rows, columns = self._learned.shape
        patch = _cut(frame.image, *start, columns, rows)
        if float(patch.std()) < self._settings.least_contrast:
            return _lost(f"featureless: contrast {patch.std():.1f} grey levels")
        (dx, dy), response = cv2.phaseCorrelate(self._learned, patch, self._window)
        if response < self._settings.least_response:
            return _lost(f"the target is hidden or gone (response {response:.2f})", response)
        x, y = start[0] + dx, start[1] + dy
        if not self._is_place and not (0 <= x < frame.image.shape[1] and 0 <= y < frame.image.shape[0]):
            return _lost("the target left the frame")
        self._last_at = (x, y)
        return TrackerResult(
            state=TrackingState.TRACKING,
            shift_px=x - self._learned_at[0],
            shift_y_px=y - self._learned_at[1],
            bearing_rad=frame.camera.bearing_rad(x),
            elevation_rad=frame.camera.elevation_rad(y),
            confidence=min(max(response, 0.0), 1.0),
            box=Box.around(x, y, columns, rows),
        )

    def close(self) -> None:
        """Let go of what was learned."""
        self._learned = None


def _cut(image: np.ndarray, x: float, y: float, columns: int, rows: int) -> np.ndarray:
    """The patch about x, y with sub-pixel reads, float32 (rows, columns); outside, the border repeats."""
    return cv2.getRectSubPix(image, (columns, rows), (x, y), patchType=cv2.CV_32F)


def _lost(reason: str, response: float = 0.0) -> TrackerResult:
    return TrackerResult(state=TrackingState.LOST, reason=reason, confidence=min(max(response, 0.0), 1.0))
