"""The pictures that the thesis's experiments are repeated on: seeded ones, or the user's own.

A *picture* is larger than a *view* of it by a margin all round, so that a moved view shows real pixels at its border,
as a camera's does. What a view moved by dx shows lies dx px farther to the right.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from base_station.errors import StationError
from base_station.geometry import PinholeCamera
from base_station.types import Frame

COLUMNS, ROWS, MARGIN = 640, 480, 120
"""Of a view, and what a picture has more on each side, px."""
CAMERA = PinholeCamera.with_fov(COLUMNS, ROWS)
SUFFIXES = {".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".tif", ".tiff", ".webp"}
MOST_PICTURES, LARGEST_FILE_BYTES = 24, 64 * 2**20
_WIDE, _HIGH = COLUMNS + 2 * MARGIN, ROWS + 2 * MARGIN


def _noise(rng: np.random.Generator, scale_px: float) -> np.ndarray:
    """Smooth noise of deviation 1: coarse grey clouds of this size."""
    clouds = cv2.GaussianBlur(rng.normal(size=(_HIGH, _WIDE)).astype(np.float32), (0, 0), scale_px)
    return (clouds - clouds.mean()) / clouds.std()


def room(seed: int) -> np.ndarray:
    """Things of all sizes before clouds of all sizes: plenty to see."""
    rng = np.random.default_rng(seed)
    picture = 125 + 14 * _noise(rng, 40) + 10 * _noise(rng, 12) + 6 * _noise(rng, 3) + 5 * _noise(rng, 0.7)
    for _ in range(60):
        x, y = int(rng.integers(0, _WIDE)), int(rng.integers(0, _HIGH))
        wide, high = int(rng.integers(10, 90)), int(rng.integers(10, 90))
        grey = float(rng.integers(20, 240))
        if rng.random() < 0.5:
            cv2.rectangle(picture, (x, y), (x + wide, y + high), grey, -1, cv2.LINE_AA)
        else:
            cv2.circle(picture, (x, y), wide // 2, grey, -1, cv2.LINE_AA)
    return cv2.GaussianBlur(picture, (0, 0), 0.5) + 2 * _noise(rng, 0.6)


def wall(seed: int) -> np.ndarray:
    """A plastered wall in an even light that falls off to one side."""
    rng = np.random.default_rng(seed)
    return np.tile(np.linspace(190, 160, _WIDE, dtype=np.float32), (_HIGH, 1)) + 0.2 * _noise(rng, 2)


def mine(seed: int) -> np.ndarray:
    """A gallery by a lamp: dark rock, the same timber every 76 px, light in the middle only."""
    rng = np.random.default_rng(seed)
    picture = 95 + 13 * _noise(rng, 14) + 9 * _noise(rng, 4) + 9 * _noise(rng, 0.8)
    for x in range(int(rng.integers(0, 76)), _WIDE, 76):
        picture[:, x : x + 16] = 150 + 5 * _noise(rng, 3)[:, x : x + 16]
    y, x = np.mgrid[:_HIGH, :_WIDE].astype(np.float32)
    lamp = np.exp(-(((x - _WIDE / 2) / 330) ** 2) - ((y - _HIGH / 2) / 260) ** 2)
    return cv2.GaussianBlur(12 + picture * (0.1 + 0.55 * lamp), (0, 0), 0.6)


def desert(seed: int) -> np.ndarray:
    """Sand ripples, some 28 px apart and nearly the same everywhere, under a few soft dunes."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:_HIGH, :_WIDE].astype(np.float32)
    bent = 2 * np.pi * (x + 0.15 * y) / 28 + 0.8 * _noise(rng, 60)
    return 165 + 20 * np.sin(bent) + 5 * np.sin(2 * bent) + 6 * _noise(rng, 70) + 5 * _noise(rng, 0.8)


SCENES: dict[str, tuple[Callable[[int], np.ndarray], str]] = {
    "room": (room, "many things, good light"),
    "wall": (wall, "an even wall: nothing to see"),
    "mine": (mine, "dark rock, the same timber again and again"),
    "desert": (desert, "sand ripples that look alike everywhere"),
}
"""Name -> maker of a picture from a seed, and what it shows."""


def view(
    picture: np.ndarray,
    dx: float = 0.0,
    dy: float = 0.0,
    *,
    gain: float = 1.0,
    offset: float = 0.0,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> np.ndarray:
    """The middle of the picture, what it shows moved by dx, dy px (to the right, down); uint8 (ROWS, COLUMNS)."""
    high, wide = picture.shape
    left, top = (wide - COLUMNS) / 2 - dx, (high - ROWS) / 2 - dy
    if left == int(left) and top == int(top):
        cut = picture[int(top) : int(top) + ROWS, int(left) : int(left) + COLUMNS]
    else:
        matrix = np.array([[1, 0, -left], [0, 1, -top]])
        cut = cv2.warpAffine(picture, matrix, (COLUMNS, ROWS), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    lit = gain * cut + offset
    if noise:
        lit = lit + (rng or np.random.default_rng(0)).normal(0, noise, lit.shape)
    image = np.clip(np.round(lit), 0, 255).astype(np.uint8)
    image.flags.writeable = False
    return image


def blacked(image: np.ndarray, dx: int) -> np.ndarray:
    """MATLAB's imtranslate: the image moved by dx, zeros where nothing is known."""
    moved = np.zeros_like(image)
    if dx >= 0:
        moved[:, dx:] = image[:, : image.shape[1] - dx]
    else:
        moved[:, :dx] = image[:, -dx:]
    return moved


def frame(image: np.ndarray, number: int) -> Frame:
    """The view as frame of this number, at 30 per second."""
    return Frame(image=image, number=number, time_s=number / 30, camera=CAMERA)


def read_pictures(folder: Path) -> list[np.ndarray]:
    """The user's own, by name, the first MOST_PICTURES, brought to the size of a picture; float32.

    Raises StationError (a wrong usage) when there are none, or one cannot be read.
    """
    if not folder.is_dir():
        raise StationError(f"--images {folder}: there is no such folder", usage=True)
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)[:MOST_PICTURES]
    if not paths:
        raise StationError(f"--images {folder}: no pictures in it ({', '.join(sorted(SUFFIXES))})", usage=True)
    return [_read(path) for path in paths]


def _read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) if path.stat().st_size <= LARGEST_FILE_BYTES else None
    if image is None or min(image.shape) < 16:
        raise StationError(f"--images: {path} is no picture that can be read, or larger than 64 MiB", usage=True)
    factor = max(_WIDE / image.shape[1], _HIGH / image.shape[0])
    way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    size = max(_WIDE, round(image.shape[1] * factor)), max(_HIGH, round(image.shape[0] * factor))
    image = cv2.resize(image, size, interpolation=way)
    top, left = (image.shape[0] - _HIGH) // 2, (image.shape[1] - _WIDE) // 2
    return image[top : top + _HIGH, left : left + _WIDE].astype(np.float32)
