"""Phase correlation, the plain reference: where has the picture moved, if nothing but a shift happened.

The patch learned is compared with the patch of the same size where the target was last (the whole view for a place);
the peak of the phase correlation is the shift between the two. It knows no zoom and no rotation. The peak's height says
little where the patch is small, so the patch that it points at is compared with the learned one as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.types import Box, Frame, TrackerResult, TrackingState


@dataclass(frozen=True, kw_only=True)
class PhaseSettings:
    """When to believe the peak."""

    least_response: float = 0.02
    """Of cv2.phaseCorrelate, 0..1: the share of the spectrum's energy under the peak."""
    least_agreement: float = 0.5
    """Correlation of the learned patch with the one at the peak: what the response of a small patch cannot tell."""
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
        agreement = self._agreement(_cut(frame.image, x, y, columns, rows))
        if agreement < self._settings.least_agreement:
            return _lost(f"the target is hidden or gone (agreement {agreement:.2f})", agreement)
        if not self._is_place and not (0 <= x < frame.image.shape[1] and 0 <= y < frame.image.shape[0]):
            return _lost("the target left the frame")
        self._last_at = (x, y)
        return TrackerResult(
            state=TrackingState.TRACKING,
            shift_px=x - self._learned_at[0],
            shift_y_px=y - self._learned_at[1],
            bearing_rad=frame.camera.bearing_rad(x),
            elevation_rad=frame.camera.elevation_rad(y),
            confidence=min(agreement, 1.0),
            box=Box.around(x, y, columns, rows),
        )

    def _agreement(self, patch: np.ndarray) -> float:
        """Normalised correlation under the window, -1..1."""
        assert self._learned is not None
        one, other = self._learned * self._window, patch * self._window
        return float((one * other).sum() / max(float(np.sqrt((one**2).sum() * (other**2).sum())), 1e-6))

    def close(self) -> None:
        """Let go of what was learned."""
        self._learned = None


def _cut(image: np.ndarray, x: float, y: float, columns: int, rows: int) -> np.ndarray:
    """The patch about x, y less its mean, float32 (rows, columns); outside of the frame, the border repeats.

    Without its mean, because the window's own spectrum about 0 would otherwise agree with itself: a peak at no shift.
    """
    patch = cv2.getRectSubPix(image, (columns, rows), (x, y), patchType=cv2.CV_32F)
    return patch - patch.mean()


def _lost(reason: str, confidence: float = 0.0) -> TrackerResult:
    return TrackerResult(state=TrackingState.LOST, reason=reason, confidence=min(max(confidence, 0.0), 1.0))
