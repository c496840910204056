"""From where learned points went to where the patch's middle is and how large it is now.

KLT and ORB both end with point pairs, some of them wrong: a similarity (shift, rotation, zoom) is fitted by RANSAC.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

LEAST_INLIERS = 8
"""Pairs that must agree with the similarity."""
TOLERANCE_PX = 3.0
ZOOMS = (0.2, 5.0)
"""What lies outside is no sighting but a coincidence."""


@dataclass(frozen=True, kw_only=True)
class Similarity:
    """`matrix`: 2x3, float64, learned to present coordinates."""

    matrix: np.ndarray
    zoom: float
    inliers: int

    def moved(self, x: float, y: float) -> tuple[float, float]:
        """Where a learned point is now."""
        there = self.matrix @ (x, y, 1.0)
        return float(there[0]), float(there[1])


def fit_similarity(learned: np.ndarray, seen: np.ndarray) -> Similarity | None:
    """`learned`, `seen`: float32 (n, 2), pairs in px. None when too few pairs agree on anything sensible."""
    if len(learned) < LEAST_INLIERS:
        return None
    matrix, inliers = cv2.estimateAffinePartial2D(learned, seen, ransacReprojThreshold=TOLERANCE_PX)
    if matrix is None or not np.isfinite(matrix).all():
        return None
    zoom, agreeing = math.hypot(matrix[0, 0], matrix[1, 0]), int(inliers.sum())
    if agreeing < LEAST_INLIERS or not ZOOMS[0] <= zoom <= ZOOMS[1]:
        return None
    return Similarity(matrix=matrix, zoom=zoom, inliers=agreeing)
