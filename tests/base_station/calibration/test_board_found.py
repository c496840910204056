"""Boards in pictures: their corners are where the camera saw them, blur is told, a part is enough."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from base_station.calibration.board import CalibrationBoard
from base_station.calibration.detection import BoardFinder
from tests.base_station.calibration.boards import SIZE, drawn_pose, picture, seen

CHARUCO, CHESSBOARD = CalibrationBoard(), CalibrationBoard(kind="chessboard", columns=8, rows=5, square_m=0.025)
SQUARE_ON = (np.zeros(3), np.array([-0.105, -0.075, 0.5]))


@pytest.mark.parametrize("board", [CHARUCO, CHESSBOARD], ids=lambda board: board.kind)
def test_corners_are_where_the_camera_saw_them(board):
    """Within 0.15 px (RMS), through a lens that distorts."""
    rng, finder = np.random.default_rng(1), BoardFinder(board)
    pose = drawn_pose(rng, board)
    pose[1][:2] += (0.02, 0.01)
    view = finder.find(picture(board, *pose))
    assert view is not None and len(view.ids) > 0.8 * len(board.corners_m)
    expected = seen(board, *pose)[view.ids]
    if board.kind == "chessboard" and np.abs(view.points_px - expected).max() > 20:
        expected = expected[::-1]  # nobody knows which way up it is held, and nothing depends on it
    wrong = view.points_px - expected
    assert np.sqrt((wrong**2).sum(axis=1).mean()) < 0.15
    assert np.abs(wrong.mean(axis=0)).max() < 0.05
    assert view.size_px == SIZE and 1.0 < view.edge_px < 3.0


def test_a_part_of_a_charuco_board_is_enough():
    rotation, translation = SQUARE_ON[0], np.array([0.10, -0.075, 0.4])
    view = BoardFinder(CHARUCO).find(picture(CHARUCO, rotation, translation, distorted=False))
    assert view is not None and 6 <= len(view.ids) < 20
    expected = seen(CHARUCO, rotation, translation, np.zeros(4))[view.ids]
    assert view.points_px == pytest.approx(expected, abs=0.25)


def test_blur_is_told():
    """Edges get wider by as much as the blur."""
    sharp = picture(CHARUCO, np.zeros(3), np.array([-0.105, -0.075, 0.27]))
    views = [BoardFinder(CHARUCO).find(image) for image in (sharp, cv2.GaussianBlur(sharp, (0, 0), 1.6))]
    widths = [view.edge_px for view in views if view is not None]
    assert widths[1] > 1.8 * widths[0]
    assert widths[0] < 3.0 < widths[1]


@pytest.mark.parametrize("board", [CHARUCO, CHESSBOARD], ids=lambda board: board.kind)
def test_no_board_is_none(board):
    noise = np.random.default_rng(0).integers(0, 256, (480, 640), dtype=np.uint8)
    for image in (np.zeros((480, 640), np.uint8), noise, np.full((20, 20), 255, np.uint8)):
        assert BoardFinder(board).find(image) is None


def test_tilts_have_signs():
    """Right side away and upper side away are positive; what is square on is neither."""
    finder, middle = BoardFinder(CHARUCO), np.array([0.105, 0.075, 0.0])
    for rotation, turned, tipped in (
        ((0, 0, 0), 0, 0), ((0, -0.4, 0), 1, 0), ((0, 0.4, 0), -1, 0), ((-0.4, 0, 0), 0, 1), ((0.4, 0, 0), 0, -1),
    ):  # fmt: skip
        turn = np.array(rotation, float)
        translation = np.array([0.0, 0.0, 0.5]) - cv2.Rodrigues(turn)[0] @ middle
        view = finder.find(picture(CHARUCO, turn, translation, distorted=False))
        assert view is not None
        assert view.tilt_rad == pytest.approx((0.4 * turned, 0.4 * tipped), abs=0.06)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"columns": 2}, "3 to 20 squares"),
        ({"columns": 20, "rows": 20}, "too few for 20x20"),
        ({"square_m": 0.0}, "1..1000 mm"),
        ({"square_m": float("nan")}, "1..1000 mm"),
    ],
)
def test_what_is_no_board_is_said(settings, said):
    with pytest.raises(ValueError, match=said):
        CalibrationBoard(**settings)
