"""Which points of the map a camera should see, where, and how large.

A point is expected in the picture when it lies before the camera, projects into it, and is as far and from about such
a direction as it was when it was seen (Mur-Artal et al. 2015, section V-D). Its distance gives the pyramid level.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import Map

WIDEST_VIEW_COS = 0.5
"""A point is not expected to look the same from more than 60 degrees aside."""
HEAD_ON_COS = 0.998
SURE_RADIUS_PX, USUAL_RADIUS_PX = 2.5, 4.0


@dataclass(frozen=True)
class Expected:
    """Points expected in a picture, m of them: their rows in the map, `uv_px` (m, 2), the pyramid level (m,), and how
    far around to look (m,), in px of the picture."""

    rows: np.ndarray
    uv_px: np.ndarray
    octave: np.ndarray
    radius_px: np.ndarray

    @property
    def octave_range(self) -> np.ndarray:
        """(m, 2): levels that the keypoint may have."""
        return np.stack([self.octave - 1, self.octave + 1], axis=1)


def expect(world: Map, rows: np.ndarray, cam_from_world: np.ndarray, camera: SlamCamera) -> Expected:
    """Of the points in these rows, those that the camera should see."""
    kept, uv, octave, radius = _expect(
        world.xyz, world.normals, world.nearest, world.farthest, np.asarray(rows, np.int64),
        np.ascontiguousarray(cam_from_world), camera.intrinsics, camera.bounds_px, world.scales,
    )  # fmt: skip
    return Expected(kept, uv, octave, radius)


@njit(cache=True, nogil=True)
def _expect(xyz, normals, nearest, farthest, rows, pose, intrinsics, bounds, scales):
    kept = np.empty(len(rows), np.int64)
    uv = np.empty((len(rows), 2))
    octave = np.empty(len(rows), np.int64)
    radius = np.empty(len(rows))
    log_scale = np.log(scales[1])
    n = 0
    for row in rows:
        p = xyz[row]
        z = pose[2, 0] * p[0] + pose[2, 1] * p[1] + pose[2, 2] * p[2] + pose[2, 3]
        if z <= 1e-6:
            continue
        x = pose[0, 0] * p[0] + pose[0, 1] * p[1] + pose[0, 2] * p[2] + pose[0, 3]
        y = pose[1, 0] * p[0] + pose[1, 1] * p[1] + pose[1, 2] * p[2] + pose[1, 3]
        u, v = intrinsics[0] * x / z + intrinsics[2], intrinsics[1] * y / z + intrinsics[3]
        if u < bounds[0] or v < bounds[1] or u > bounds[2] or v > bounds[3]:
            continue
        distance = np.sqrt(x * x + y * y + z * z)
        if distance < 0.8 * nearest[row] or distance > 1.2 * farthest[row]:
            continue
        # the direction from the camera to the point, turned into the world
        normal = normals[row]
        wx = pose[0, 0] * x + pose[1, 0] * y + pose[2, 0] * z
        wy = pose[0, 1] * x + pose[1, 1] * y + pose[2, 1] * z
        wz = pose[0, 2] * x + pose[1, 2] * y + pose[2, 2] * z
        cosine = (wx * normal[0] + wy * normal[1] + wz * normal[2]) / distance
        if cosine < WIDEST_VIEW_COS:
            continue
        level = int(np.ceil(np.log(max(farthest[row] / distance, 1e-6)) / log_scale))
        level = min(max(level, 0), len(scales) - 1)
        kept[n], uv[n, 0], uv[n, 1], octave[n] = row, u, v, level
        radius[n] = (SURE_RADIUS_PX if cosine > HEAD_ON_COS else USUAL_RADIUS_PX) * scales[level]
        n += 1
    return kept[:n], uv[:n], octave[:n], radius[:n]
