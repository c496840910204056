"""Pictures and videos as gray arrays.

Debian's OpenCV brings 370 libraries and 100 MiB along, so it is loaded by the first picture that needs it. A binary PGM
is gray bytes already and does not.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from protocol.frames import MAX_SIDE_PX
from robot_agent.errors import CameraError

_PGM_HEADER = re.compile(rb"P5\s+(\d{1,4})\s+(\d{1,4})\s+255\s")
_LONGEST_HEADER = 64


def read_gray(path: Path) -> np.ndarray | None:
    """The picture in a file, uint8 (height, width); None when it is missing or no picture."""
    picture = _read_pgm(path)
    if picture is not None:
        return picture
    cv2 = _opencv()
    decoded: np.ndarray | None = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    return decoded


def read_video(path: Path) -> Iterator[tuple[float | None, np.ndarray]]:
    """Time in s (None when the file has no rate) and gray picture of every frame. Raises CameraError if it is none."""
    cv2 = _opencv()
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        raise CameraError(f"{path} is no video that OpenCV can read.")
    fps = capture.get(cv2.CAP_PROP_FPS)
    index = 0
    try:
        while True:
            good, picture = capture.read()
            if not good:
                return
            gray = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            yield (index / fps if fps > 0 else None), gray
            index += 1
    finally:
        capture.release()


def scaled(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The picture at this width and height, each pixel the mean of what it covers; itself when it has that size."""
    if picture.shape == (size[1], size[0]):
        return picture
    cv2 = _opencv()
    resized: np.ndarray = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return resized


def _read_pgm(path: Path) -> np.ndarray | None:
    """A binary PGM of 8 bits without comments; None for all else, which is left to OpenCV."""
    try:
        with path.open("rb") as file:
            header = _PGM_HEADER.match(file.read(_LONGEST_HEADER))
            if header is None:
                return None
            width, height = int(header[1]), int(header[2])
            if not (1 <= width <= MAX_SIDE_PX and 1 <= height <= MAX_SIDE_PX):
                return None
            file.seek(header.end())
            pixels = np.frombuffer(file.read(width * height), np.uint8)
    except OSError:
        return None
    return pixels.reshape(height, width) if pixels.size == width * height else None


def _opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise CameraError("This recording needs OpenCV: sudo apt install python3-opencv.") from error
    return cv2
