"""Features matched: ORB corners of the target looked for among those of the whole picture, wherever it is.

Rublee et al., "ORB: an efficient alternative to SIFT or SURF" (ICCV 2011). Pairs whose descriptors are clearly each
other's nearest vote for a similarity. It needs no prediction, and a good many corners.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.baselines.patch import Found, Learned, Missed, PatchTracker
from base_station.trackers.baselines.similarity import LEAST_INLIERS, fit_similarity


@dataclass(frozen=True, kw_only=True)
class OrbSettings:
    """Of features and belief."""

    features: int = 1000
    """In a picture, at the most."""
    fast_threshold: int = 10
    """Grey levels by which a corner differs from its surroundings."""
    nearest_share: float = 0.8
    """The second nearest descriptor must be farther by this factor (Lowe's ratio)."""
    least_share: float = 0.25
    """Of the matches that must agree on one similarity."""


class OrbTracker(PatchTracker):
    """Detect, describe, match, fit: all in OpenCV."""

    def __init__(self, *, settings: OrbSettings | None = None) -> None:
        super().__init__()
        self._settings = settings or OrbSettings()
        self._orb = cv2.ORB.create(nfeatures=self._settings.features, fastThreshold=self._settings.fast_threshold)
        self._matcher = cv2.BFMatcher(cv2.NORM_HAMMING)

    @property
    def landmark_bytes(self) -> int:
        """What must be kept to find it again: the corners and their descriptors."""
        return int(self._points.nbytes + self._descriptors.nbytes)

    def _prepare(self, image: np.ndarray, patch: np.ndarray, learned: Learned) -> None:
        x, y = learned.center_px
        rows, columns = learned.shape
        points, descriptors = self._features(image)
        inside = (np.abs(points - (x, y)) <= (columns / 2, rows / 2)).all(1)
        if int(inside.sum()) < LEAST_INLIERS:
            raise ValueError(f"featureless: fewer than {LEAST_INLIERS} ORB corners")
        self._points, self._descriptors = points[inside], descriptors[inside]

    def _features(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places, float32 (n, 2), and descriptors, uint8 (n, 32)."""
        corners, descriptors = self._orb.detectAndCompute(image, None)
        if descriptors is None:
            return np.empty((0, 2), np.float32), np.empty((0, 32), np.uint8)
        return np.array([corner.pt for corner in corners], np.float32).reshape(-1, 2), np.asarray(descriptors)

    def _look(self, image: np.ndarray, learned: Learned) -> Found | Missed:
        points, descriptors = self._features(image)
        if len(points) < 2:
            return Missed(f"the target is hidden or gone ({len(points)} corners in the picture)")
        pairs = self._matcher.knnMatch(self._descriptors, descriptors, k=2)
        clear = [a for a, b in pairs if a.distance < self._settings.nearest_share * b.distance]
        motion = fit_similarity(
            self._points[[match.queryIdx for match in clear]], points[[match.trainIdx for match in clear]]
        )
        if motion is None or motion.inliers < self._settings.least_share * len(clear):
            return Missed(f"the target is hidden or gone ({len(clear)} of {len(self._points)} corners matched)")
        x, y = motion.moved(*learned.center_px)
        return Found(x=x, y=y, zoom=motion.zoom, confidence=motion.inliers / len(clear))
