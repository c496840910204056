"""Flat pictures to look at, and views of them whose displacement is known exactly.

A world is a gray picture with two samples per view pixel. A view is what a camera with a Gaussian pixel (sigma half a
pixel) sees of it: every view pixel is its own weighted mean of samples about its own place, so that the truth holds to
a thousandth of a pixel (cv2.warpAffine rounds places to 1/32 px, which is more than the best trackers err).

Generated worlds are "dead leaves" (Lee, Mumford and Huang, IJCV 2001): opaque shapes that hide one another, their
sizes distributed as 1/r^3, each with a texture of 1/f noise. They share edges, occlusion and scale invariance with
photographs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numba
import numpy as np

from base_station.errors import StationError
from base_station.geometry import PinholeCamera

VIEW_COLUMNS, VIEW_ROWS = 640, 480
SAMPLES_PER_PX = 2
COLUMNS, ROWS = 2240, 1600
"""Of a world: it holds views at zoom 0.7 that are displaced by 50 px, with room to choose the middle."""
ROOM_PX = (45.0, 40.0)
"""The middle of the reference view lies within so many view pixels of the world's."""
PIXEL_SIGMA = 0.5
"""Of the camera's pixel and lens, in view pixels."""
REACH_SIGMAS = 4.0
LEAVES, SMALLEST_LEAF, LARGEST_LEAF = 3500, 16.0, 420.0
"""How many shapes, and their radii in samples."""
PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm")
MOST_PICTURES = 100
SMALLEST_PICTURE_PX = 64


@dataclass(frozen=True)
class World:
    """`picture`: uint8 (rows, columns). `origin`: the sample (x, y) that the reference view has in its middle."""

    name: str
    picture: np.ndarray
    origin: tuple[float, float] = ((COLUMNS - 1) / 2, (ROWS - 1) / 2)

    def view(self, dx: float = 0.0, dy: float = 0.0, zoom: float = 1.0) -> np.ndarray:
        """float32 (480, 640): what was in the middle is displaced by dx, dy px (right, down) and enlarged by zoom.

        Beyond its border the world goes on as its mirror image.
        """
        rows = _taps(VIEW_ROWS, dy, zoom, self.origin[1])
        columns = _taps(VIEW_COLUMNS, dx, zoom, self.origin[0])
        return _resample(self.picture, *rows, *columns)

    def turned_view(self, shift_px: float, dy: float, zoom: float, camera: PinholeCamera) -> np.ndarray:
        """The same when the camera turns about its vertical axis until the middle lies `shift_px` aside (a world far
        away, as a place is seen). Places are rounded to 1/64 px, differently all over the picture."""
        angle = math.atan2(shift_px, camera.fx)
        x, y = np.meshgrid(np.arange(VIEW_COLUMNS, dtype=np.float32), np.arange(VIEW_ROWS, dtype=np.float32))
        across, down = (x - (VIEW_COLUMNS - 1) / 2) / camera.fx, (y - (VIEW_ROWS - 1) / 2 - dy) / camera.fx
        ahead = math.cos(angle) + across * math.sin(angle)
        scale = SAMPLES_PER_PX * camera.fx / zoom
        at_x = self.origin[0] + scale * (across * math.cos(angle) - math.sin(angle)) / ahead
        at_y = self.origin[1] + scale * down / ahead
        seen = cv2.GaussianBlur(self.picture.astype(np.float32), (0, 0), PIXEL_SIGMA * SAMPLES_PER_PX / zoom)
        return np.asarray(cv2.remap(seen, at_x, at_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101))


def _taps(pixels: int, shift: float, zoom: float, origin: float) -> tuple[np.ndarray, np.ndarray]:
    """Along one axis, per view pixel: the first sample that it sees (it may lie outside), and the samples' weights."""
    pitch = SAMPLES_PER_PX / zoom
    at = origin + (np.arange(pixels) - (pixels - 1) / 2 - shift) * pitch
    sigma = PIXEL_SIGMA * pitch
    reach = math.ceil(REACH_SIGMAS * sigma)
    first = np.floor(at).astype(np.int64) - reach + 1
    off = first[:, None] + np.arange(2 * reach) - at[:, None]
    weights = np.exp(-0.5 * (off / sigma) ** 2)
    return first, (weights / weights.sum(1, keepdims=True)).astype(np.float32)


@numba.njit(cache=True)
def _mirrored(index: int, size: int) -> int:
    """An index beyond the border, mirrored into it (the border sample itself is not repeated)."""
    index = abs(index) % (2 * size - 2)
    return 2 * size - 2 - index if index >= size else index


@numba.njit(cache=True, fastmath=True)
def _resample(picture, first_row, row_weights, first_column, column_weights):
    """First down the columns that are needed, then along the rows."""
    rows, columns = len(first_row), len(first_column)
    begin, end = first_column[0], first_column[-1] + column_weights.shape[1]
    source = np.empty(end - begin, np.int64)
    for n in range(end - begin):
        source[n] = _mirrored(begin + n, picture.shape[1])
    inside = begin >= 0 and end <= picture.shape[1]
    line = np.empty(end - begin, np.float32)
    view = np.empty((rows, columns), np.float32)
    for r in range(rows):
        line[:] = 0
        for tap in range(row_weights.shape[1]):
            samples, weight = picture[_mirrored(first_row[r] + tap, picture.shape[0])], row_weights[r, tap]
            if inside:
                for n in range(end - begin):
                    line[n] += weight * np.float32(samples[begin + n])
            else:
                for n in range(end - begin):
                    line[n] += weight * np.float32(samples[source[n]])
        for c in range(columns):
            total = np.float32(0)
            for tap in range(column_weights.shape[1]):
                total += column_weights[c, tap] * line[first_column[c] - begin + tap]
            view[r, c] = total
    return view


def pink_noise(rng: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    """float32 (rows, columns) whose amplitude falls as 1/f; mean 0, standard deviation 1."""
    spectrum = np.fft.rfft2(rng.standard_normal((rows, columns), dtype=np.float32))
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)[None])
    frequency[0, 0] = np.inf
    noise = np.fft.irfft2(spectrum / frequency, (rows, columns))
    return np.asarray(noise / noise.std(), np.float32)


def generated_world(seed: int) -> World:
    """Dead leaves with texture, in uneven light. The same seed gives the same world."""
    rng = np.random.default_rng([seed, 0xDEAD])
    texture = pink_noise(rng, ROWS, COLUMNS)
    picture = 125 + 40 * texture
    for _ in range(LEAVES):
        _draw_leaf(rng, picture, texture)
    picture *= 1 + 0.15 * cv2.resize(pink_noise(rng, 64, 64), (COLUMNS, ROWS), interpolation=cv2.INTER_CUBIC)
    return World(f"generated {seed}", np.clip(np.round(picture), 4, 251).astype(np.uint8), _middle(rng))


def _draw_leaf(rng: np.random.Generator, picture: np.ndarray, texture: np.ndarray) -> None:
    """One opaque shape in front of what is there already."""
    low, high = SMALLEST_LEAF**-2, LARGEST_LEAF**-2
    radius = float((low - rng.random() * (low - high)) ** -0.5)  # density 1/r^3
    reach = math.ceil(1.5 * radius)
    x, y = int(rng.integers(0, COLUMNS)), int(rng.integers(0, ROWS))
    left, top = max(x - reach, 0), max(y - reach, 0)
    patch = picture[top : y + reach + 1, left : x + reach + 1]
    mask = np.zeros(patch.shape, np.uint8)
    middle = np.array([x - left, y - top])
    cv2.fillPoly(mask, [np.round(middle + _outline(rng, radius)).astype(np.int32)], 1)
    rows, columns = patch.shape
    from_y, from_x = int(rng.integers(0, ROWS - rows + 1)), int(rng.integers(0, COLUMNS - columns + 1))
    grain = texture[from_y : from_y + rows, from_x : from_x + columns]
    filling = rng.uniform(25, 230) + rng.uniform(4, 22) * grain
    np.copyto(patch, filling.astype(np.float32), where=mask.astype(bool))


def _outline(rng: np.random.Generator, radius: float) -> np.ndarray:
    """Corners (n, 2) of an ellipse, a rectangle or another polygon about (0, 0)."""
    kind, turn = int(rng.integers(3)), rng.uniform(0, 2 * np.pi)
    if kind == 0:
        angles = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        corners = np.stack([np.cos(angles), rng.uniform(0.4, 1) * np.sin(angles)], 1)
    elif kind == 1:
        corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * (0.8, rng.uniform(0.2, 0.8))
    else:
        angles = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(3, 8))))
        corners = np.stack([np.cos(angles), np.sin(angles)], 1) * rng.uniform(0.6, 1.2, (len(angles), 1))
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    return np.asarray(radius * corners @ rotation)


def _middle(rng: np.random.Generator) -> tuple[float, float]:
    room = np.array(ROOM_PX) * SAMPLES_PER_PX
    x, y = (np.array([COLUMNS - 1, ROWS - 1]) / 2 + rng.uniform(-room, room)).tolist()
    return x, y


def photographed_worlds(folder: Path, seed: int) -> list[World]:
    """The pictures of a folder (the first hundred), scaled to cover a world and cropped in the middle.

    A view shows the same part of the picture whatever its size, so a small picture gives smooth views. Raises
    StationError when there is no picture, or one cannot be read.
    """
    paths = picture_files(folder)
    if not paths:
        raise StationError(f"{folder} has no picture ({', '.join(PICTURE_SUFFIXES)}).", usage=True)
    return [_photographed(path, seed) for path in paths[:MOST_PICTURES]]


def picture_files(folder: Path) -> Sequence[Path]:
    """The files with a picture's suffix, by name. Raises StationError when there is no such folder."""
    if not folder.is_dir():
        raise StationError(f"There is no folder {folder}.", usage=True)
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES and path.is_file())


def read_gray(path: Path) -> np.ndarray:
    """uint8 (rows, columns). Raises StationError when it is no picture."""
    return read_picture(path, cv2.IMREAD_GRAYSCALE)


def read_picture(path: Path, flags: int) -> np.ndarray:
    """What cv2.imread gives. Raises StationError when it is no picture."""
    try:
        picture = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), flags)
    except (OSError, cv2.error):
        picture = None
    if picture is None:
        raise StationError(f"{path} cannot be read as a picture: mend or remove it.", usage=True)
    return np.asarray(picture)


def _photographed(path: Path, seed: int) -> World:
    photo = read_gray(path)
    if min(photo.shape) < SMALLEST_PICTURE_PX:
        rows, columns = photo.shape
        raise StationError(f"{path} is too small: {columns}x{rows} px, at least 64 a side are needed.", usage=True)
    scale = max(COLUMNS / photo.shape[1], ROWS / photo.shape[0])
    size = (max(round(photo.shape[1] * scale), COLUMNS), max(round(photo.shape[0] * scale), ROWS))
    large = cv2.resize(photo, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    left, top = (size[0] - COLUMNS) // 2, (size[1] - ROWS) // 2
    picture = np.ascontiguousarray(large[top : top + ROWS, left : left + COLUMNS])
    return World(path.name, picture, _middle(np.random.default_rng([seed, *path.name.encode()])))
