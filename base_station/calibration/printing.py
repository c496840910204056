"""A board on paper, true to scale: a PDF of filled rectangles, or a PNG that tells its resolution."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from base_station.calibration.board import CELLS_A_SQUARE, CalibrationBoard
from base_station.errors import StationError

PAPERS_MM = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "A0": (841.0, 1189.0),
    "letter": (215.9, 279.4),
}
MARGIN_MM = 5.0
"""What printers leave white; the board needs a light rim besides, which this is."""
TEXT_MM = 6.0
"""Below the board."""
POINTS_A_MM = 72 / 25.4
PNG_DPI = 300
FONT_PT = 8


def write_board(board: CalibrationBoard, paper: str, path: Path, *, overwrite: bool = False) -> str:
    """Write the file that its suffix asks for; what it is, in words. Raises StationError, also when there is such a
    file already and it is not to be overwritten."""
    writers = {".pdf": board_pdf, ".png": board_png}
    if path.suffix.lower() not in writers:
        raise StationError(f"{path}: name a file that ends with .pdf or .png.", usage=True)
    page = page_mm(board, paper)
    data = writers[path.suffix.lower()](board, page)
    try:
        with path.open("wb" if overwrite else "xb") as file:
            file.write(data)
    except FileExistsError as error:
        raise StationError(f"{path} is there already: name another file, or give --overwrite.", usage=True) from error
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).", usage=True) from error
    return f"{board.described()} on {paper}, {page[0]:g}x{page[1]:g} mm"


def page_mm(board: CalibrationBoard, paper: str) -> tuple[float, float]:
    """Width and height of the paper as the board lies on it. Raises StationError when it does not fit."""
    width, height = (side * 1000 for side in board.size_m)
    short, long = PAPERS_MM[paper]
    for page in ((short, long), (long, short)):
        if width + 2 * MARGIN_MM <= page[0] and height + 2 * MARGIN_MM + 2 * TEXT_MM <= page[1]:
            return page
    raise StationError(
        f"{board.described()} measures {width:g}x{height:g} mm and does not fit on {paper}: take smaller squares "
        f"(--square-mm) or larger paper (--paper {', '.join(PAPERS_MM)}).",
        usage=True,
    )


def board_pdf(board: CalibrationBoard, page: tuple[float, float]) -> bytes:
    """One page (width, height in mm) with the board in its middle."""
    left, bottom = _place(board, page)
    cell = board.square_m * 1000 / CELLS_A_SQUARE * POINTS_A_MM
    cells = board.cells()
    origin = f"1 0 0 1 {left * POINTS_A_MM:.4f} {bottom * POINTS_A_MM:.4f} cm"
    # All in one path: pieces that are filled one by one show hairlines between them.
    pieces = [
        f"{column * cell:.4f} {(len(cells) - past_row) * cell:.4f} {(past_column - column) * cell:.4f}"
        f" {(past_row - row) * cell:.4f} re"
        for row, past_row, column, past_column in _rectangles(cells)
    ]
    text = f"BT /F1 {FONT_PT} Tf 0 {-0.75 * TEXT_MM * POINTS_A_MM:.3f} Td ({_caption(board)}) Tj ET"
    content = "\n".join(["q", origin, "0 g", *pieces, "f", text, "Q"]).encode("ascii")
    size = " ".join(f"{side * POINTS_A_MM:.4f}" for side in page)
    return _pdf(
        [
            b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
            b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size}] /Contents 4 0 R"
            " /Resources << /Font << /F1 5 0 R >> >> >>".encode("ascii"),
            b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
            b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
        ]
    )


def board_png(board: CalibrationBoard, page: tuple[float, float]) -> bytes:
    """The page as a picture of about 300 dpi; the exact resolution stands in its pHYs chunk."""
    cell_px = max(1, round(PNG_DPI / 25.4 * board.square_m * 1000 / CELLS_A_SQUARE))
    px_a_mm = cell_px * CELLS_A_SQUARE / (board.square_m * 1000)
    width, height = (round(side * px_a_mm) for side in page)
    sheet = np.full((height, width), 255, np.uint8)
    drawn = board.draw(CELLS_A_SQUARE * cell_px)
    left, bottom = (round(mm * px_a_mm) for mm in _place(board, page))
    top = height - bottom - drawn.shape[0]
    sheet[top : top + drawn.shape[0], left : left + drawn.shape[1]] = drawn
    below = (left, top + drawn.shape[0] + round(TEXT_MM * 0.75 * px_a_mm))
    cv2.putText(sheet, _caption(board), below, cv2.FONT_HERSHEY_SIMPLEX, 0.08 * px_a_mm, 0, 2, cv2.LINE_AA)
    _, data = cv2.imencode(".png", sheet)
    return _with_resolution(data.tobytes(), round(px_a_mm * 1000))


def _place(board: CalibrationBoard, page: tuple[float, float]) -> tuple[float, float]:
    """Of the board's lower left corner from the page's, in mm."""
    width, height = (side * 1000 for side in board.size_m)
    return (page[0] - width) / 2, (page[1] - height) / 2


def _caption(board: CalibrationBoard) -> str:
    width, height = (side * 1000 for side in board.size_m)
    return (
        f"{board.described()}. Print at 100 %, without fitting to the page. Measure: the board is"
        f" {width:g} x {height:g} mm."
    )


def _rectangles(cells: np.ndarray) -> Iterator[tuple[int, int, int, int]]:
    """First and past-last row and column of rectangles that cover the true cells, none twice."""
    open_runs: dict[tuple[int, int], int] = {}
    for number, row in enumerate([*cells, np.zeros(cells.shape[1], bool)]):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], row.astype(np.int8), [0]])))
        runs = set(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        for run in [run for run in open_runs if run not in runs]:
            yield open_runs.pop(run), number, *run
        for run in runs:
            open_runs.setdefault(run, number)


def _pdf(objects: list[bytes]) -> bytes:
    """A file of these objects, numbered from 1; the first is the catalogue."""
    data = bytearray(b"%PDF-1.4\n")
    offsets = []
    for number, body in enumerate(objects, 1):
        offsets.append(len(data))
        data += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    start, count = len(data), len(objects) + 1
    data += b"xref\n0 %d\n0000000000 65535 f \n" % count
    for offset in offsets:
        data += b"%010d 00000 n \n" % offset
    data += b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (count, start)
    return bytes(data)


def _with_resolution(png: bytes, px_a_m: int) -> bytes:
    """The PNG with a pHYs chunk, which must stand before the picture's data: right after the header of 33 bytes."""
    chunk = b"pHYs" + struct.pack(">IIB", px_a_m, px_a_m, 1)
    return png[:33] + struct.pack(">I", 9) + chunk + struct.pack(">I", zlib.crc32(chunk)) + png[33:]
