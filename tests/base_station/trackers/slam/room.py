"""A made-up room seen by a camera, for tests: six textured walls, exact poses, no graphics library.

Every pixel's ray leaves the box through one wall; where it does is a place in that wall's texture.
"""

from __future__ import annotations

import cv2
import numpy as np

from base_station.trackers.slam.camera import SlamCamera

TEXELS = 512


def small_camera() -> SlamCamera:
    return SlamCamera(width_px=320, height_px=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5)


class Room:
    """A box around the world's origin, `size` metres (x right, y down, z forwards), with seeded walls."""

    def __init__(self, camera: SlamCamera, size: tuple[float, float, float] = (5.0, 3.0, 5.0), seed: int = 0) -> None:
        self._half = np.array(size, np.float32) / 2
        self._walls = np.vstack([_texture(np.random.default_rng([seed, wall])) for wall in range(6)])
        columns, rows = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
        self._rays = np.stack(
            [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(columns.shape)], axis=-1
        ).astype(np.float32)

    def picture(self, world_from_cam: np.ndarray) -> np.ndarray:
        """What a camera there sees, uint8."""
        rays = self._rays @ world_from_cam[:3, :3].T.astype(np.float32)
        center = world_from_cam[:3, 3].astype(np.float32)
        with np.errstate(divide="ignore"):
            to_wall = (np.sign(rays) * self._half - center) / rays
        axis = np.argmin(to_wall, axis=-1)
        distance = np.take_along_axis(to_wall, axis[..., None], -1)
        hit = (center + rays * distance) / self._half * 0.5 + 0.5
        wall = 2 * axis + (np.take_along_axis(rays, axis[..., None], -1)[..., 0] > 0)
        across = np.where(axis == 0, hit[..., 2], hit[..., 0])
        down = np.where(axis == 1, hit[..., 2], hit[..., 1])
        x = np.clip(across * (TEXELS - 1), 0, TEXELS - 1)
        y = np.clip(down * (TEXELS - 1), 0, TEXELS - 1) + wall * TEXELS
        return cv2.remap(self._walls, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)


def _texture(rng: np.random.Generator) -> np.ndarray:
    """Patches of all sizes and greys, one over the other, as furniture and pictures are."""
    picture = np.full((TEXELS, TEXELS), 120, np.uint8)
    for count, largest in ((60, 150), (250, 50), (700, 20)):
        for _ in range(count):
            x, y = rng.integers(0, TEXELS, 2)
            w, h = rng.integers(4, largest, 2)
            cv2.rectangle(picture, (int(x), int(y)), (int(x + w), int(y + h)), int(rng.integers(20, 235)), -1)
    return cv2.GaussianBlur(picture, (3, 3), 0.8)


def standing(x: float, z: float, heading_rad: float, y: float = 0.0) -> np.ndarray:
    """world_from_cam of a camera held level there; heading 0 looks along z, positive turns to the right."""
    pose = np.eye(4)
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = x, y, z
    return pose
