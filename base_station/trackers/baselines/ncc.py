"""Template matching: the learned patch is laid on every place of the picture, and the likeliest is taken.

cv2.matchTemplate with the normalised correlation coefficient (Lewis, Vision Interface 1995) is indifferent to gain and
offset and needs no prediction. It knows neither zoom nor rotation. Of a place the middle is the template, so that there
is room to lay it elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.baselines.patch import Found, Learned, Missed, PatchTracker, gone, peak_offset


@dataclass(frozen=True, kw_only=True)
class NccSettings:
    """When to believe the peak."""

    least_correlation: float = 0.5
    place_share: float = 0.5
    """Of the view's width and height that is the template of a place."""


class NccTracker(PatchTracker):
    """cv2.matchTemplate over the whole frame, a parabola through the peak along each axis."""

    def __init__(self, *, settings: NccSettings | None = None) -> None:
        super().__init__()
        self._settings = settings or NccSettings()

    def _prepare(self, image: np.ndarray, patch: np.ndarray, learned: Learned) -> None:
        rows, columns = learned.shape
        if learned.is_place or rows > image.shape[0] - 2 or columns > image.shape[1] - 2:
            share = self._settings.place_share
            rows, columns = max(round(rows * share), 1), max(round(columns * share), 1)
        x, y = learned.center_px
        left, top = round(x - (columns - 1) / 2), round(y - (rows - 1) / 2)
        left, top = min(max(left, 0), image.shape[1] - columns), min(max(top, 0), image.shape[0] - rows)
        self._template = image[top : top + rows, left : left + columns].copy()
        self._corner = (left, top)

    def _look(self, image: np.ndarray, learned: Learned) -> Found | Missed:
        likeness = cv2.matchTemplate(image, self._template, cv2.TM_CCOEFF_NORMED)
        _, best, _, (left, top) = cv2.minMaxLoc(likeness)
        if not np.isfinite(best) or best < self._settings.least_correlation:
            return gone(best if np.isfinite(best) else 0.0)
        dx = left + _top_of(likeness[top], left) - self._corner[0]
        dy = top + _top_of(likeness[:, left], top) - self._corner[1]
        return Found(x=learned.center_px[0] + dx, y=learned.center_px[1] + dy, confidence=best)


def _top_of(line: np.ndarray, peak: int) -> float:
    """The peak's offset between samples; at an end of the line none."""
    return peak_offset(*line[peak - 1 : peak + 2].tolist()) if 0 < peak < len(line) - 1 else 0.0
