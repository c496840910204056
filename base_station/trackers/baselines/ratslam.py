"""RatSLAM's visual odometry: the column sums of the picture, shifted until they fit best.

Milford and Wyeth, "Mapping a suburb with a single camera using a biologically inspired SLAM system" (IEEE T-RO 24,
2008): the intensity profile of the rows, normalised by its mean, is compared at every whole shift by its mean absolute
difference. Here the learned profile is the earlier one. It knows neither height nor distance, and whole pixels only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from base_station.trackers.baselines.patch import Found, Learned, Missed, RowsOfPatch, agreement, gone


@dataclass(frozen=True, kw_only=True)
class RatSlamSettings:
    """How far to look, and when to believe."""

    place_share: float = 0.5
    """Of the view's width that is the profile of a place: the rest is room for shifts."""
    least_agreement: float = 0.6
    """Correlation of the profiles at the best shift: the difference itself has no natural bar."""


class RatSlamTracker(RowsOfPatch):
    """The learned profile against every stretch of the same rows' profile."""

    def __init__(self, *, settings: RatSlamSettings | None = None) -> None:
        super().__init__()
        self._settings = settings or RatSlamSettings()

    @property
    def landmark_bytes(self) -> int:
        """What must be kept to find it again: the profile."""
        return int(self._profile.nbytes)

    def _prepare(self, image: np.ndarray, patch: np.ndarray, learned: Learned) -> None:
        rows, columns = learned.shape
        if learned.is_place:
            columns = max(round(columns * self._settings.place_share), 1)
        x, y = learned.center_px
        self._left = min(max(round(x - (columns - 1) / 2), 0), image.shape[1] - columns)
        top = min(max(round(y - (rows - 1) / 2), 0), image.shape[0] - rows)
        self._above = y - top
        self._profile = _normalised(self._read(image, learned)[self._left : self._left + columns])
        if float(self._profile.std()) < 1e-3:
            raise ValueError("featureless: all columns of the target are equally bright")

    def _read(self, image: np.ndarray, learned: Learned) -> np.ndarray:
        """The mean of the target's rows, float32 (frame columns,)."""
        top = round(learned.center_px[1] - self._above)
        return np.asarray(image[top : top + learned.shape[0]].mean(0, dtype=np.float32))

    def _look(self, image: np.ndarray, learned: Learned) -> Found | Missed:
        stretches = _normalised(
            np.lib.stride_tricks.sliding_window_view(self._read(image, learned), len(self._profile))
        )
        best = int(np.argmin(np.abs(stretches - self._profile).mean(1)))
        alike = agreement(self._profile - 1, stretches[best] - 1)
        if alike < self._settings.least_agreement:
            return gone(alike)
        return Found(x=learned.center_px[0] + best - self._left, confidence=alike)


def _normalised(profiles: np.ndarray) -> np.ndarray:
    """Divided by the mean along the last axis."""
    return np.asarray(profiles / np.maximum(profiles.mean(-1, keepdims=True), 1e-3))
