"""The learned target found again in a picture itself, without a map: where its middle is, and how near it is now.

A target that is seen from aside is no longer similar to what was learned: 20 degrees at an arm's length move its sides
by several pixels, a similarity then fits one half of it in one picture and the other half in the next, and a robot that
is steered by it trembles. A plane is explained by a homography from wherever it is seen, and that tells the distance
without an ambiguity: H = R + t n'/d, scaled so that its middle singular value is 1, takes a ray of length 1/depth to
the point itself (Malis and Vargas, "Deeper understanding of the homography decomposition", 2007).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.baselines.similarity import LEAST_INLIERS, TOLERANCE_PX, ZOOMS, fit_similarity
from base_station.trackers.slam.camera import SlamCamera

LEAST_OF_PLANE = 15
"""Pairs that must agree with a homography: it has twice the freedom of a similarity."""
LEAST_AGREEING = 0.25
"""Of the pairs, that must agree on one motion."""
TRIES = 500


@dataclass(frozen=True)
class Sighting:
    """`middle_px` (2,): of the target, in the undistorted picture; `zoom`: how many times nearer it is than it was
    learned; `inliers`: pairs that agree."""

    middle_px: np.ndarray
    zoom: float
    inliers: int


def sight(
    learned_px: np.ndarray, seen_px: np.ndarray, middle_px: np.ndarray, camera: SlamCamera, *, flat: bool
) -> Sighting | None:
    """From pairs (n, 2) of undistorted keypoints, wrong ones among them, and the target's middle as it was learned.

    `flat`: the target may be a plane; a whole view is none. None when too few agree on anything sensible.
    """
    similar = fit_similarity(learned_px, seen_px)
    plane = _by_plane(learned_px, seen_px, middle_px, camera) if flat else None
    best = None
    if similar is not None:
        best = Sighting(np.array(similar.moved(*middle_px)), similar.zoom, similar.inliers)
    if plane is not None and (best is None or plane.inliers >= best.inliers):
        best = plane
    return None if best is None or best.inliers < LEAST_AGREEING * len(learned_px) else best


def _by_plane(
    learned_px: np.ndarray, seen_px: np.ndarray, middle_px: np.ndarray, camera: SlamCamera
) -> Sighting | None:
    if len(learned_px) < max(LEAST_OF_PLANE, LEAST_INLIERS):
        return None
    homography, inliers = cv2.findHomography(
        learned_px, seen_px, cv2.USAC_MAGSAC, TOLERANCE_PX, maxIters=TRIES, confidence=0.999
    )
    if homography is None or not np.isfinite(homography).all() or int(inliers.sum()) < LEAST_OF_PLANE:
        return None
    motion = np.linalg.inv(camera.matrix) @ homography @ camera.matrix
    unit = float(np.linalg.svd(motion, compute_uv=False)[1])
    if unit <= 0 or np.linalg.det(motion) <= 0:  # mirrored: no plane is seen from behind
        return None
    ray = np.append((middle_px - camera.intrinsics[2:]) / camera.intrinsics[:2], 1.0)
    x, y, depth = motion @ ray / unit
    if not 1.0 / ZOOMS[1] <= depth <= 1.0 / ZOOMS[0]:
        return None
    there = np.array([x, y]) / depth * camera.intrinsics[:2] + camera.intrinsics[2:]
    return Sighting(there, float(1.0 / depth), int(inliers.sum()))
