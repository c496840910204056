"""Pictures to calibrate from: those of a folder by name, or the frames of a video."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from base_station.errors import StationError

SUFFIXES = (".png", ".jpg", ".jpeg", ".pgm", ".bmp", ".tif", ".tiff")
MOST_SIDE_PX = 8192


def is_video(source: Path) -> bool:
    """Whether these are the frames of one file, which follow each other, and not pictures taken one by one."""
    if not source.exists():
        raise StationError(f"There is no folder and no video {source}.", usage=True)
    return not source.is_dir()


def read_pictures(source: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Name and gray picture, uint8 (height, width), of each. Raises StationError."""
    for name, picture in _video(source) if is_video(source) else _folder(source):
        if max(picture.shape[:2]) > MOST_SIDE_PX:
            size = f"{picture.shape[1]}x{picture.shape[0]}"
            raise StationError(f"{name} is {size}: {MOST_SIDE_PX} px a side are the most.", usage=True)
        yield name, picture


def _folder(source: Path) -> Iterator[tuple[str, np.ndarray]]:
    paths = sorted(path for path in source.iterdir() if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise StationError(f"No pictures in {source}: it must hold files such as .jpg or .png.", usage=True)
    for path in paths:
        data = np.frombuffer(path.read_bytes(), np.uint8)
        picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if data.size else None
        if picture is None:
            raise StationError(f"{path} is no picture: take it out of the folder.")
        yield path.name, np.asarray(picture)


def _video(source: Path) -> Iterator[tuple[str, np.ndarray]]:
    capture = cv2.VideoCapture(str(source))
    number = 0
    try:
        while True:
            good, picture = capture.read()
            if not good:
                break
            number += 1
            gray = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
            yield f"frame {number}", np.asarray(gray)
    finally:
        capture.release()
    if not number:
        raise StationError(f"{source} is no video that OpenCV can read.", usage=True)
