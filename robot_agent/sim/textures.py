"""Seeded gray pictures for the room and the targets.

Natural pictures have about the same contrast at every scale (their spectrum falls as 1/f). Sums of noise with one
equally strong layer per octave have that too, at little cost. Hard-edged shapes on top give corners to look at.
All functions return uint8 arrays of shape (height, width) and draw only from the generator they are given.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from robot_agent.sim import calibration_board as board


@dataclass(frozen=True, kw_only=True)
class TextureStyle:
    """How busy a texture is. Sizes are fractions of the shorter side."""

    shapes: int
    """Number of shapes drawn."""
    smallest: float
    largest: float
    """Range of the shapes' sizes; small ones are more frequent (uniform in the logarithm)."""
    contrast: float = 40.0
    """Standard deviation of the 1/f layer in gray levels."""


FLOOR = TextureStyle(shapes=700, smallest=0.004, largest=0.05, contrast=28.0)
WALL = TextureStyle(shapes=260, smallest=0.02, largest=0.22)
BUSY_WALL = TextureStyle(shapes=1500, smallest=0.012, largest=0.20, contrast=55.0)
BOARD = TextureStyle(shapes=60, smallest=0.05, largest=0.30, contrast=50.0)
PICTURE = TextureStyle(shapes=26, smallest=0.06, largest=0.30, contrast=45.0)

_SHEET_PX_A_M = 8000
_DARKEST, _LIGHTEST = 14, 241
"""Noise must not saturate at the ends of the scale."""


def pink_noise(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """1/f noise: float32, shape (height, width), mean 0, standard deviation 1."""
    total = np.zeros((height, width), np.float32)
    shorter = min(height, width)
    cells = 2
    while cells <= shorter:
        grid = (max(2, height * cells // shorter), max(2, width * cells // shorter))
        layer = rng.standard_normal(grid, dtype=np.float32)
        total += cv2.resize(layer, (width, height), interpolation=cv2.INTER_CUBIC)
        cells *= 2
    return (total - total.mean()) / total.std()


def texture(rng: np.random.Generator, height: int, width: int, style: TextureStyle) -> np.ndarray:
    """A picture in the given style: shapes on 1/f noise, with a trace of the noise on the shapes too."""
    noise = pink_noise(rng, height, width) * style.contrast
    image = np.clip(128.0 + noise, _DARKEST, _LIGHTEST).astype(np.uint8)
    for _ in range(style.shapes):
        _draw_shape(rng, image, style)
    grain = np.clip(128.0 + noise, 0, 255).astype(np.uint8)
    mixed = cv2.addWeighted(image, 0.85, grain, 0.15, 0.0)
    return np.clip(mixed, _DARKEST, _LIGHTEST)


def calibration_sheet() -> np.ndarray:
    """The printed sheet of the simulated calibration board, black and white as far as noise leaves room."""
    square_px, rim_px = (round(side * _SHEET_PX_A_M) for side in (board.SQUARE_M, board.RIM_M))
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    size = (board.COLUMNS, board.ROWS)
    printed = cv2.aruco.CharucoBoard(size, board.SQUARE_M, board.SQUARE_M * board.MARKER_SHARE, markers)
    drawn = printed.generateImage((board.COLUMNS * square_px, board.ROWS * square_px), marginSize=0, borderBits=1)
    whole = cv2.copyMakeBorder(drawn, rim_px, rim_px, rim_px, rim_px, cv2.BORDER_CONSTANT, value=255)
    return np.where(whole > 127, _LIGHTEST, _DARKEST).astype(np.uint8)


def plain(gray: int) -> np.ndarray:
    """A small picture of one gray level."""
    return np.full((8, 8), gray, np.uint8)


def _draw_shape(rng: np.random.Generator, image: np.ndarray, style: TextureStyle) -> None:
    height, width = image.shape
    size = float(np.exp(rng.uniform(np.log(style.smallest), np.log(style.largest)))) * min(height, width)
    gray = int(rng.integers(_DARKEST, _LIGHTEST + 1))
    x, y = float(rng.uniform(0, width)), float(rng.uniform(0, height))
    kind = int(rng.integers(3))
    if kind == 0:
        cv2.circle(image, (round(x), round(y)), max(1, round(size / 2)), gray, -1, cv2.LINE_AA)
        return
    if kind == 1:
        corners = cv2.boxPoints(((x, y), (size, size * rng.uniform(0.4, 1.6)), float(rng.uniform(0, 180))))
    else:
        corners = np.array([x, y]) + rng.normal(size=(3, 2)) * size * 0.6
    cv2.fillPoly(image, [np.round(corners).astype(np.int32)], gray, cv2.LINE_AA)
