"""Synthetic truth for trackers: a seeded picture, and views of it that are shifted, enlarged, darkened, noisy."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from base_station.geometry import PinholeCamera
from base_station.types import Frame

COLUMNS, ROWS = 640, 480


class World:
    """A flat picture, twice as wide and high as a view of it."""

    def __init__(self, seed: int, columns: int = COLUMNS, rows: int = ROWS) -> None:
        rng = np.random.default_rng(seed)
        noise = cv2.GaussianBlur(rng.normal(size=(2 * rows, 2 * columns)).astype(np.float32), (0, 0), 5)
        picture = 128 + 30 * noise / noise.std()
        for _ in range(120):
            x, y, r = rng.integers(0, 2 * columns), rng.integers(0, 2 * rows), rng.integers(6, 40)
            cv2.circle(picture, (int(x), int(y)), int(r), float(rng.integers(10, 245)), -1, cv2.LINE_AA)
        self._picture = cv2.GaussianBlur(picture, (0, 0), 1.0).clip(0, 255)
        self._rng = rng
        self.columns, self.rows = columns, rows
        self.camera = PinholeCamera.with_fov(columns, rows)

    def view(
        self,
        dx: float = 0.0,
        dy: float = 0.0,
        zoom: float = 1.0,
        *,
        gain: float = 1.0,
        offset: float = 0.0,
        noise: float = 0.0,
        aspect: float = 1.0,
    ) -> np.ndarray:
        """Its middle moved by dx, dy px and enlarged; uint8 (rows, columns), read-only."""
        x, y = (self.columns - 1) / 2, (self.rows - 1) / 2
        across = zoom * aspect
        matrix = np.array(
            [
                [across, 0, x - across * (self.columns - 0.5) + dx],
                [0, zoom, y - zoom * (self.rows - 0.5) + dy],
            ]
        )
        size = (self.columns, self.rows)
        flat = cv2.warpAffine(self._picture, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
        lit = gain * flat + offset + (self._rng.normal(0, noise, flat.shape) if noise else 0)
        image = np.clip(np.round(lit), 0, 255).astype(np.uint8)
        image.flags.writeable = False
        return image

    def frame(self, image: np.ndarray, number: int = 1) -> Frame:
        """The image as frame of this number at 30 per second."""
        camera = self.camera
        if image.shape != (self.rows, self.columns):
            camera = PinholeCamera.with_fov(image.shape[1], image.shape[0])
        return Frame(image=image, number=number, time_s=number / 30, camera=camera)


@pytest.fixture
def make_world():
    """World(seed, columns, rows)."""
    return World


@pytest.fixture
def world() -> World:
    """A new world of seed 0."""
    return World(0)
