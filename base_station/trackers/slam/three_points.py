"""Where a camera is when some of its points are wrong: the pose by three of them that most agree with (AP3P).

It is a first guess: `pose_optimization.py` makes it exact.
"""

from __future__ import annotations

import cv2
import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.se3 import pose_of


def pose_from_three(
    points: np.ndarray, seen_px: np.ndarray, camera: SlamCamera, *, error_px: float, tries: int, confidence: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """cam_from_world 4x4 by points (n, 3) seen at (n, 2), undistorted, and the rows that agree to `error_px`. None when
    no pose is found. `confidence`: tries end when the best one is so surely found."""
    solved, rotation, translation, inliers = cv2.solvePnPRansac(
        points, np.asarray(seen_px, np.float64), camera.matrix, None, iterationsCount=tries,
        reprojectionError=error_px, confidence=confidence, flags=cv2.SOLVEPNP_AP3P,
    )  # fmt: skip
    if not solved or inliers is None:
        return None
    pose = pose_of(cv2.Rodrigues(rotation)[0], translation)
    return (pose, inliers[:, 0]) if np.isfinite(pose).all() else None
