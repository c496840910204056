"""What a bundle adjustment is given: keyframes, points, and which keyframe sees which point where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class BundleProblem:
    """K keyframes, P points, N observations.

    `poses` (K, 4, 4) cam_from_world, `fixed` (K,) bool: those that must not move; `points` (P, 3). Observation i is
    keyframe `keyframe[i]` seeing point `point[i]` at `uv_px[i]` on pyramid level `octave[i]`.
    """

    poses: np.ndarray
    fixed: np.ndarray
    points: np.ndarray
    keyframe: np.ndarray
    point: np.ndarray
    uv_px: np.ndarray
    octave: np.ndarray
