"""Corners followed by optical flow (Kanade, Lucas, Tomasi), their common motion a similarity.

Corners of the learned picture are sought in the present one by cv2.calcOpticalFlowPyrLK, starting where the last
sighting suggests, and from there back; a corner that does not come back to itself is dropped. Always against the
learned picture, never from frame to frame: so nothing drifts.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.baselines.patch import Found, Learned, Missed, PatchTracker, agreement, gone
from base_station.trackers.baselines.similarity import LEAST_INLIERS, fit_similarity


@dataclass(frozen=True, kw_only=True)
class KltSettings:
    """Of corners, flow and belief."""

    corners: int = 100
    corner_quality: float = 0.01
    """Of the best corner's."""
    corner_distance_px: float = 7.0
    window_px: int = 21
    levels: int = 4
    """Of the pyramid, besides the picture itself."""
    return_px: float = 1.0
    """A corner must come back to within this of where it was learned."""
    least_agreement: float = 0.5
    """Correlation of the learned patch with the one found."""


class KltTracker(PatchTracker):
    """Two flows a frame, a similarity, a comparison."""

    def __init__(self, *, settings: KltSettings | None = None) -> None:
        super().__init__()
        self._settings = settings or KltSettings()

    def _prepare(self, image: np.ndarray, patch: np.ndarray, learned: Learned) -> None:
        s = self._settings
        x, y = learned.center_px
        rows, columns = learned.shape
        mask = np.zeros(image.shape, np.uint8)
        left, top = round(x - (columns - 1) / 2), round(y - (rows - 1) / 2)
        mask[max(top, 0) : top + rows, max(left, 0) : left + columns] = 255
        corners = cv2.goodFeaturesToTrack(image, s.corners, s.corner_quality, s.corner_distance_px, mask=mask)
        if corners is None or len(corners) < LEAST_INLIERS:
            raise ValueError(f"featureless: fewer than {LEAST_INLIERS} corners")
        self._image, self._patch, self._corners = image, patch, corners.reshape(-1, 2)

    def _look(self, image: np.ndarray, learned: Learned) -> Found | Missed:
        x, y = learned.center_px
        last_y = y if self._last.y is None else self._last.y
        guess = (self._corners - (x, y)) * (self._last.zoom or 1.0) + (self._last.x, last_y)
        learned_corners, seen = self._follow(image, guess.astype(np.float32))
        motion = fit_similarity(learned_corners, seen)
        if motion is None:
            return Missed(f"the target is hidden or gone ({len(seen)} of {len(self._corners)} corners found)")
        alike = agreement(self._patch, _straightened(image, motion.matrix, learned))
        if alike < self._settings.least_agreement:
            return gone(alike)
        now_x, now_y = motion.moved(x, y)
        return Found(x=now_x, y=now_y, zoom=motion.zoom, confidence=alike)

    def _follow(self, image: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corners that were found and came back: learned and present places, float32 (n, 2)."""
        s = self._settings
        size = (s.window_px, s.window_px)
        flags = cv2.OPTFLOW_USE_INITIAL_FLOW
        seen, there, _ = cv2.calcOpticalFlowPyrLK(
            self._image, image, self._corners, guess.copy(), winSize=size, maxLevel=s.levels, flags=flags
        )
        back, home, _ = cv2.calcOpticalFlowPyrLK(
            image, self._image, seen, self._corners.copy(), winSize=size, maxLevel=s.levels, flags=flags
        )
        off_px = np.abs(back - self._corners).max(1)
        good = (there.ravel() > 0) & (home.ravel() > 0) & (off_px <= s.return_px)
        return self._corners[good], seen[good]


def _straightened(image: np.ndarray, matrix: np.ndarray, learned: Learned) -> np.ndarray:
    """The present picture as the learned patch would show it, less its mean."""
    rows, columns = learned.shape
    corner = np.array([[1, 0, learned.center_px[0] - (columns - 1) / 2], [0, 1, learned.center_px[1] - (rows - 1) / 2]])
    to_present = matrix @ np.vstack([corner, (0, 0, 1)])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    patch = cv2.warpAffine(image, to_present, (columns, rows), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return patch.astype(np.float32) - np.float32(patch.mean())
