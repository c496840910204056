"""A board found in a picture: which corners are seen and where, how sharp they are, and how the board is held."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from base_station.calibration.board import CalibrationBoard
from base_station.geometry import DEFAULT_FOV_RAD

LEAST_CORNERS = 6
"""Of a ChArUco board; fewer say little about the camera."""
REFINED = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 0.001)
LEAST_WINDOW_PX, MOST_WINDOW_PX = 2, 11
EDGE_WINDOW_PX = 14


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardView:
    """A board in a picture of `size_px` (width, height). `ids`: (n,) which corners of `CalibrationBoard.corners_m`;
    `points_px`: (n, 2) float32, where they are; `edge_px`: how wide an edge of the board is, 2 is sharp."""

    board: CalibrationBoard
    size_px: tuple[int, int]
    ids: np.ndarray
    points_px: np.ndarray
    edge_px: float

    @cached_property
    def board_m(self) -> np.ndarray:
        """(n, 3) float32: the same corners on the board."""
        return self.board.corners_m[self.ids]

    @cached_property
    def homography(self) -> np.ndarray | None:
        """3x3, from metres on the board to px. None when the corners lie on a line."""
        found, _ = cv2.findHomography(self.board_m[:, :2], self.points_px, 0)
        return None if found is None else np.asarray(found)

    @cached_property
    def outline_px(self) -> np.ndarray:
        """(4, 2): the board's outer corners, which may lie outside of the picture; clockwise from the upper left."""
        assert self.homography is not None
        outline = self.board.outline_m.reshape(-1, 1, 2).astype(np.float64)
        return np.asarray(cv2.perspectiveTransform(outline, self.homography))[:, 0]

    @cached_property
    def held(self) -> np.ndarray:
        """(5,) how the board is held: its centre's column and row and the root of its area as shares of the picture,
        and how far it is tilted about the vertical (its right side away: positive) and the horizontal (its upper side
        away: positive), in half radians, as seen by a usual camera."""
        width, height = self.size_px
        centre = self.outline_px.mean(axis=0)
        size = math.sqrt(max(cv2.contourArea(self.outline_px.astype(np.float32)), 0.0) / (width * height))
        turned, tipped = self.tilt_rad
        return np.array([centre[0] / width, centre[1] / height, size, turned / 2, tipped / 2])

    @cached_property
    def tilt_rad(self) -> tuple[float, float]:
        """About the vertical and the horizontal, as in `held`."""
        assert self.homography is not None
        width, height = self.size_px
        focal_px = width / 2 / math.tan(DEFAULT_FOV_RAD / 2)
        rays_from_px = np.linalg.inv(np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1.0]]))
        across, down, _ = (rays_from_px @ self.homography).T
        away = np.cross(across, down)  # the board's z axis, away from whoever looks at it squarely
        away /= np.linalg.norm(away) * (1 if away[2] > 0 else -1)
        return math.atan2(-away[0], away[2]), math.atan2(away[1], away[2])


class BoardFinder:
    """Finds a board. `find` may be called with pictures of any size."""

    def __init__(self, board: CalibrationBoard) -> None:
        self.board = board
        self._charuco: Any = cv2.aruco.CharucoDetector(board.aruco) if board.kind == "charuco" else None

    def find(self, image: np.ndarray) -> BoardView | None:
        """`image`: uint8 (height, width), gray. None when too little of a board is seen."""
        found = self._charuco_corners(image) if self._charuco is not None else self._chessboard_corners(image)
        if found is None:
            return None
        ids, points = found
        height, width = image.shape
        view = BoardView(
            board=self.board, size_px=(width, height), ids=ids, points_px=points, edge_px=edge_width_px(image, points)
        )
        return view if view.homography is not None and _upright(view.outline_px) else None

    def _charuco_corners(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        corners, ids, _, _ = self._charuco.detectBoard(image)
        if ids is None or len(ids) < LEAST_CORNERS:
            return None
        ids, points = np.asarray(ids).ravel(), np.asarray(corners, np.float32).reshape(-1, 2)
        rows, columns = np.divmod(ids, self.board.columns - 1)
        if min(np.unique(rows).size, np.unique(columns).size) < 2:
            return None  # on a line
        window = _window_px(self.board, ids, points)
        refined = cv2.cornerSubPix(image, points[:, None].copy(), (window, window), (-1, -1), REFINED)
        return ids, np.asarray(refined)[:, 0]

    def _chessboard_corners(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        inner = (self.board.columns - 1, self.board.rows - 1)
        good, corners = cv2.findChessboardCornersSB(image, inner, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if not good:
            return None
        points = np.asarray(corners, np.float32).reshape(-1, 2)
        return np.arange(len(points)), points


def edge_width_px(image: np.ndarray, points: np.ndarray) -> float:
    """How many px the board's edges take from dark to light, near the corners: contrast over the steepest slope.

    The median over the corners: 1 to 2 for a sharp picture, twice the standard deviation and more of a blur.
    """
    widths = []
    for x, y in np.round(points).astype(int):
        patch = image[max(y - EDGE_WINDOW_PX, 0) : y + EDGE_WINDOW_PX, max(x - EDGE_WINDOW_PX, 0) : x + EDGE_WINDOW_PX]
        if min(patch.shape) < 4:
            continue
        dark, light = np.percentile(patch, (5, 95))
        slope_x, slope_y = cv2.Sobel(patch, cv2.CV_32F, 1, 0), cv2.Sobel(patch, cv2.CV_32F, 0, 1)
        steepest = float(np.percentile(cv2.magnitude(slope_x, slope_y), 99)) / 8
        widths.append((light - dark) / max(steepest, 1e-3))
    return float(np.median(widths)) if widths else math.inf


def _window_px(board: CalibrationBoard, ids: np.ndarray, points: np.ndarray) -> int:
    """Half of the window that a corner is sought in: well inside its four squares, and off their markers' edges."""
    spots = dict(zip(ids.tolist(), points, strict=True))
    steps = [
        float(np.linalg.norm(spots[one + step] - spots[one]))
        for one in spots
        for step in (1, board.columns - 1)
        if one + step in spots and (step != 1 or (one + 1) % (board.columns - 1))
    ]
    # A marker begins 15 % of a square away from the corner; the weights fall off towards the window's rim.
    square_px = min(steps, default=4.0 * LEAST_WINDOW_PX)
    return int(np.clip(square_px * 0.2, LEAST_WINDOW_PX, MOST_WINDOW_PX))


def _upright(outline: np.ndarray) -> bool:
    """Whether it is a convex quadrilateral: no view of a board from behind or across the horizon."""
    return bool(cv2.isContourConvex(outline.astype(np.float32))) and bool(np.isfinite(outline).all())
