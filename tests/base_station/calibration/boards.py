"""Boards as a known camera sees them: their corners, and whole pictures of them with a lens's distortion."""

from __future__ import annotations

import functools

import cv2
import numpy as np

from base_station.calibration.board import CalibrationBoard
from base_station.calibration.detection import BoardView

MATRIX = np.array([[530.0, 0.0, 322.0], [0.0, 528.0, 236.0], [0.0, 0.0, 1.0]])
DISTORTION = np.array([-0.28, 0.09, 0.001, -0.0008])
SIZE = (640, 480)
FINER = 2


def drawn_pose(rng: np.random.Generator, board: CalibrationBoard) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation of a board somewhere in view, tilted up to 30 degrees."""
    rotation = rng.uniform(-0.5, 0.5, 3) * (1.0, 1.0, 0.3)
    depth_m = float(rng.uniform(1.6, 2.4)) * board.size_m[0]
    middle = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.25, 0.25), 1.0]) * depth_m
    centre = np.array([*board.size_m, 0.0]) / 2
    return rotation, middle - cv2.Rodrigues(rotation)[0] @ centre


def seen(
    board: CalibrationBoard, rotation: np.ndarray, translation: np.ndarray, distortion: np.ndarray = DISTORTION
) -> np.ndarray:
    """(n, 2) where the camera sees the board's corners."""
    points, _ = cv2.projectPoints(board.corners_m, rotation, translation, MATRIX, distortion)
    return points[:, 0]


def drawn_view(rng: np.random.Generator, board: CalibrationBoard, *, noise_px: float = 0.1, edge_px=2.0) -> BoardView:
    """Corners with noise; those outside of the picture are missing."""
    while True:
        points = seen(board, *drawn_pose(rng, board))
        inside = np.flatnonzero(((points >= 0) & (points < SIZE)).all(axis=1))
        if len(inside) >= 12:
            noisy = points[inside] + rng.normal(0.0, noise_px, (len(inside), 2))
            return BoardView(board=board, size_px=SIZE, ids=inside, points_px=noisy.astype(np.float32), edge_px=edge_px)


@functools.cache
def ideal_pixels(distorted: bool) -> np.ndarray:
    """(n, 1, 2) where an ideal pinhole sees what falls on each fine pixel, row by row."""
    columns, rows = np.meshgrid(np.arange(SIZE[0] * FINER), np.arange(SIZE[1] * FINER))
    pixels = (np.stack([columns.ravel(), rows.ravel()], axis=1)[:, None] + 0.5) / FINER - 0.5
    return cv2.undistortPoints(pixels, MATRIX, DISTORTION, None, MATRIX) if distorted else pixels


def picture(board: CalibrationBoard, rotation: np.ndarray, translation: np.ndarray, *, distorted=True) -> np.ndarray:
    """uint8 (480, 640), what the camera sees of the board on gray paper."""
    square_px = 60
    sheet = cv2.copyMakeBorder(board.draw(square_px), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    px_from_m = np.array([[square_px / board.square_m, 0, 39.5], [0, square_px / board.square_m, 39.5], [0, 0, 1]])
    turned = cv2.Rodrigues(rotation)[0]
    view_from_px = MATRIX @ np.column_stack([turned[:, 0], turned[:, 1], translation]) @ np.linalg.inv(px_from_m)
    width, height = SIZE
    on_sheet = cv2.perspectiveTransform(ideal_pixels(distorted), np.linalg.inv(view_from_px))
    map_x, map_y = on_sheet[:, 0].astype(np.float32).T.reshape(2, height * FINER, width * FINER)
    fine = cv2.remap(sheet, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=150)
    return cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA)
