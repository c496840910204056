"""Phase correlation, the plain reference: where has the picture moved, if nothing but a shift happened.

The patch learned is compared with the patch of the same size where the target was last (the whole view for a place);
the peak of the phase correlation is the shift between the two. It knows no zoom and no rotation. The peak's height says
little where the patch is small, so the patch that it points at is compared with the learned one as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.baselines.patch import (
    LEAST_CONTRAST,
    Found,
    Learned,
    Missed,
    PatchTracker,
    agreement,
    cut,
    gone,
)


@dataclass(frozen=True, kw_only=True)
class PhaseSettings:
    """When to believe the peak."""

    least_response: float = 0.02
    """Of cv2.phaseCorrelate, 0..1: the share of the spectrum's energy under the peak."""
    least_agreement: float = 0.5
    """Correlation of the learned patch with the one at the peak: what the response of a small patch cannot tell."""


class PhaseTracker(PatchTracker):
    """cv2.phaseCorrelate, at most once a frame."""

    def __init__(self, *, settings: PhaseSettings | None = None) -> None:
        super().__init__()
        self._settings = settings or PhaseSettings()

    def _prepare(self, image: np.ndarray, patch: np.ndarray, learned: Learned) -> None:
        self._patch = patch
        self._window = cv2.createHanningWindow(learned.shape[::-1], cv2.CV_32F)

    def _look(self, image: np.ndarray, learned: Learned) -> Found | Missed:
        last_y = learned.center_px[1] if self._last.y is None else self._last.y
        x, y = learned.center_px if learned.is_place else (self._last.x, last_y)
        rows, columns = learned.shape
        patch = cut(image, x, y, columns, rows)
        if float(patch.std()) < LEAST_CONTRAST:
            return Missed(f"featureless: contrast {patch.std():.1f} grey levels")
        (dx, dy), response = cv2.phaseCorrelate(self._patch, patch, self._window)
        if response < self._settings.least_response:
            return Missed(f"the target is hidden or gone (response {response:.2f})", response)
        x, y = x + dx, y + dy
        alike = agreement(self._patch * self._window, cut(image, x, y, columns, rows) * self._window)
        return Found(x=x, y=y, confidence=alike) if alike >= self._settings.least_agreement else gone(alike)
