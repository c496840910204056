"""Finding the pictures of a recording: an image folder, an OTB, TUM or EuRoC folder, each as (time, file) pairs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from robot_agent.errors import CameraError

SUFFIXES = {".jpg", ".jpeg", ".png", ".pgm", ".bmp", ".tif", ".tiff"}


@dataclass(frozen=True)
class RecordedImage:
    """A picture's file and its time in s, None when the layout has no times."""

    path: Path
    time_s: float | None


def list_images(folder: Path) -> list[RecordedImage]:
    """The pictures of a folder in order, whatever its layout. Raises CameraError when there are none.

    TUM: `rgb.txt` with lines "time file". EuRoC: `mav0/cam0/data.csv` (or `cam0/data.csv`, `data.csv`) with lines
    "nanoseconds,file" and the files in `data/`. OTB: pictures in `img/`. Else: the folder's own pictures by name.
    """
    try:
        images = _listed(folder)
    except OSError as error:
        raise CameraError(f"{folder} cannot be read ({error.strerror}).") from error
    if not images:
        raise CameraError(f"No pictures in {folder}: it must hold jpg or png files, or a TUM or EuRoC layout.")
    return images


def _listed(folder: Path) -> list[RecordedImage]:
    if (folder / "rgb.txt").is_file():
        return _tum(folder)
    if (table := _euroc_table(folder)) is not None:
        return _euroc(table)
    inner = folder / "img"
    paths = sorted((inner if inner.is_dir() else folder).iterdir())
    return [RecordedImage(path, None) for path in paths if path.suffix.lower() in SUFFIXES]


def _euroc_table(folder: Path) -> Path | None:
    candidates = (folder / "mav0" / "cam0" / "data.csv", folder / "cam0" / "data.csv", folder / "data.csv")
    return next((path for path in candidates if path.is_file()), None)


def _tum(folder: Path) -> list[RecordedImage]:
    images = []
    for number, line in enumerate(_lines(folder / "rgb.txt"), 1):
        words = line.split()
        if len(words) < 2:
            raise CameraError(f"{folder}/rgb.txt, entry {number}: a time and a file are expected, not {line[:60]!r}.")
        images.append(RecordedImage(folder / words[1], _number(words[0], folder / "rgb.txt", number)))
    return images


def _euroc(table: Path) -> list[RecordedImage]:
    images = []
    for number, line in enumerate(_lines(table), 1):
        words = [word.strip() for word in line.split(",")]
        if len(words) < 2:
            raise CameraError(f"{table}, entry {number}: a time and a file are expected, not {line[:60]!r}.")
        images.append(RecordedImage(table.parent / "data" / words[1], _number(words[0], table, number) * 1e-9))
    return images


def _lines(path: Path) -> list[str]:
    text = path.read_text(encoding="utf-8", errors="replace")
    return [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def _number(word: str, path: Path, entry: int) -> float:
    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise CameraError(f"{path}, entry {entry}: {word[:40]!r} is not a time.")
    return number
