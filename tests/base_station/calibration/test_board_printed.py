"""The printed board is true to scale and is the board that is sought: read back from the PDF's own numbers."""

from __future__ import annotations

import re
import struct

import cv2
import numpy as np
import pytest

from base_station.calibration.board import CalibrationBoard
from base_station.calibration.detection import BoardFinder
from base_station.calibration.printing import write_board
from base_station.errors import StationError

BOARDS = (CalibrationBoard(), CalibrationBoard(kind="chessboard", columns=8, rows=6, square_m=0.02))
MM = 72 / 25.4


def numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def drawn(data: bytes, px_a_mm: float) -> tuple[np.ndarray, list[float]]:
    """The page's rectangles as a picture, and the page's size in mm. It knows no more of PDF than what is needed."""
    (box,) = re.findall(rb"/MediaBox \[([^\]]*)\]", data)
    width, height = (side / MM for side in numbers(box.decode())[2:])
    content = data.split(b"stream\n")[1].split(b"endstream")[0].decode()
    (origin,) = re.findall(r"1 0 0 1 (.*) cm", content)
    left, bottom = (value / MM for value in numbers(origin))
    page = np.full((round(height * px_a_mm), round(width * px_a_mm)), 255, np.uint8)
    for line in re.findall(r"^(.*) re$", content, re.MULTILINE):
        x, y, across, up = (value / MM for value in numbers(line))
        rows = [round((height - bottom - edge) * px_a_mm) for edge in (y + up, y)]
        columns = [round((left + edge) * px_a_mm) for edge in (x, x + across)]
        assert (page[slice(*rows), slice(*columns)] == 255).all(), "drawn twice"
        page[slice(*rows), slice(*columns)] = 0
    return page, [width, height]


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.kind)
def test_the_pdf_shows_the_board_true_to_scale(tmp_path, board):
    file = tmp_path / "board.pdf"
    write_board(board, "A4", file)
    data = file.read_bytes()
    page, size = drawn(data, 4.0)
    assert sorted(size) == pytest.approx([210.0, 297.0], abs=1e-3)

    view = BoardFinder(board).find(cv2.GaussianBlur(page, (0, 0), 1.0))
    assert view is not None and len(view.ids) == len(board.corners_m)
    apart_px = np.linalg.norm(view.points_px[-1] - view.points_px[0])
    apart_mm = 1000 * np.linalg.norm(board.corners_m[-1] - board.corners_m[0])
    assert apart_px / 4.0 == pytest.approx(apart_mm, abs=0.1)

    for number, offset in enumerate(re.findall(rb"^(\d{10}) 00000 n", data, re.MULTILINE), 1):
        assert data[int(offset) :].startswith(b"%d 0 obj" % number)
    (start,) = re.findall(rb"startxref\n(\d+)", data)
    assert data[int(start) :].startswith(b"xref")


def test_the_png_tells_its_resolution(tmp_path):
    board, file = BOARDS[0], tmp_path / "board.png"
    assert "A3" in write_board(board, "A3", file)
    data = file.read_bytes()
    across, down, unit = struct.unpack(">IIB", data[data.index(b"pHYs") + 4 :][:9])
    assert across == down and unit == 1
    image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    assert np.array(image.shape[::-1]) / across == pytest.approx(np.array([0.297, 0.420]), abs=1e-3)
    view = BoardFinder(board).find(cv2.resize(image, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA))
    assert view is not None and len(view.ids) == 24
    apart_m = np.linalg.norm(view.points_px[5] - view.points_px[0]) * 4 / across
    assert apart_m == pytest.approx(5 * board.square_m, abs=2e-4)


def test_what_cannot_be_written_is_said(tmp_path):
    for name, said in (("board.svg", ".pdf or .png"), ("no/board.pdf", "cannot be written")):
        with pytest.raises(StationError, match=said):
            write_board(BOARDS[0], "A4", tmp_path / name)
    with pytest.raises(StationError, match="does not fit on A4"):
        write_board(CalibrationBoard(square_m=0.05), "A4", tmp_path / "board.pdf")


def test_a_file_that_is_there_is_overwritten_only_when_asked(tmp_path):
    file = tmp_path / "board.pdf"
    file.write_bytes(b"somebody's work")
    with pytest.raises(StationError, match=r"board\.pdf is there already.*--overwrite") as refused:
        write_board(BOARDS[0], "A4", file)
    assert refused.value.usage and file.read_bytes() == b"somebody's work"
    write_board(BOARDS[0], "A4", file, overwrite=True)
    assert file.read_bytes().startswith(b"%PDF")
