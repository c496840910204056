"""The boards that cameras are calibrated with: their measures, the drawing of one, and where its corners are.

A chessboard has corners where four squares meet. A ChArUco board is one with ArUco markers in its white squares: every
corner has a name, so a part of the board is enough, and it may reach to the picture's rim where lenses distort most.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import cv2
import numpy as np

from base_station.errors import StationError

MARKERS = cv2.aruco.DICT_5X5_100
MARKER_SHARE = 0.7
"""Of a square's side. The same board is in the simulation's scenario `calibration`."""
LEAST_SQUARES, MOST_SQUARES = 3, 20
MOST_MARKERS = 100
CELLS_A_SQUARE = 20


@dataclass(frozen=True, kw_only=True)
class BoardOptions:
    """Which board it is."""

    board: Literal["charuco", "chessboard"] = "charuco"
    """charuco may be seen in part, also at the picture's rim; chessboard is the classic, to be seen whole."""
    squares: str = "7x5"
    """How many squares it has, COLUMNSxROWS (a chessboard's inner corners are one fewer each way)."""
    square_mm: float = 30.0
    """Side of a square. Measure it on the paper: printers scale."""


@dataclass(frozen=True, kw_only=True)
class CalibrationBoard:
    """`columns` x `rows` squares. Raises ValueError for what cannot be a board."""

    kind: str = "charuco"
    columns: int = 7
    rows: int = 5
    square_m: float = 0.030

    def __post_init__(self) -> None:
        if not all(LEAST_SQUARES <= side <= MOST_SQUARES for side in (self.columns, self.rows)):
            raise ValueError(f"a board has {LEAST_SQUARES} to {MOST_SQUARES} squares a side")
        if self.kind == "charuco" and self.columns * self.rows // 2 > MOST_MARKERS:
            raise ValueError(f"there are {MOST_MARKERS} markers, which is too few for {self.columns}x{self.rows}")
        if not 0.001 <= self.square_m <= 1.0:
            raise ValueError("a square measures 1..1000 mm")

    @classmethod
    def of(cls, options: BoardOptions) -> CalibrationBoard:
        """Raises StationError for options that make no board."""
        columns, separator, rows = options.squares.lower().partition("x")
        if not separator or not columns.isdecimal() or not rows.isdecimal() or len(columns + rows) > 6:
            raise StationError(f"--squares {options.squares}: write COLUMNSxROWS, such as 7x5.", usage=True)
        try:
            return cls(kind=options.board, columns=int(columns), rows=int(rows), square_m=options.square_mm / 1000)
        except ValueError as error:
            text = f"--board {options.board} --squares {options.squares} --square-mm {options.square_mm:g}"
            raise StationError(f"{text}: {error}.", usage=True) from error

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height."""
        return self.columns * self.square_m, self.rows * self.square_m

    @cached_property
    def corners_m(self) -> np.ndarray:
        """(n, 3) float32: the inner corners row by row from the upper left; x to the right, y down, z 0."""
        x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
        flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
        return (flat * self.square_m).astype(np.float32)

    @cached_property
    def outline_m(self) -> np.ndarray:
        """(4, 2) float64: the outer corners, clockwise from the upper left."""
        width, height = self.size_m
        return np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])

    @cached_property
    def aruco(self) -> Any:
        """The board as OpenCV has it; for a ChArUco board only."""
        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows),
            self.square_m,
            self.square_m * MARKER_SHARE,
            cv2.aruco.getPredefinedDictionary(MARKERS),
        )

    def draw(self, square_px: int) -> np.ndarray:
        """uint8 (rows * square_px, columns * square_px): 0 black, 255 white, without a margin."""
        if self.kind == "charuco":
            size = (self.columns * square_px, self.rows * square_px)
            return np.asarray(self.aruco.generateImage(size, marginSize=0, borderBits=1))
        row, column = np.indices((self.rows, self.columns))
        light = np.where((row + column) % 2 == 0, 0, 255).astype(np.uint8)
        return np.kron(light, np.ones((square_px, square_px), np.uint8))

    def cells(self) -> np.ndarray:
        """bool (rows * CELLS_A_SQUARE, columns * CELLS_A_SQUARE), black where true: the drawing without any loss.

        Markers of 5 bits with a rim of 1 are 7 bits wide, and 70 % of a square: with 20 cells all edges fall on cells.
        """
        return self.draw(CELLS_A_SQUARE) == 0

    def described(self) -> str:
        return f"{self.kind} {self.columns}x{self.rows}, squares of {self.square_m * 1000:g} mm"
