"""Tracked boxes against true ones, as the OTB benchmark scores them (Wu, Lim and Yang, CVPR 2013).

Success is the share of frames whose overlap exceeds a threshold, averaged over thresholds 0 to 1 (the area under its
curve); precision the share whose centre is within 20 px. A frame without a box overlaps by nothing; a frame without a
true box is left out.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from base_station.errors import StationError

THRESHOLDS = np.linspace(0.0, 1.0, 21)
PRECISION_PX = 20.0
MOST_PX = 1e5
"""Of a true box's place and size: more is no place in a picture."""


@dataclass(frozen=True, kw_only=True)
class OverlapScore:
    frames: int
    """Those with a true box."""
    boxes: int
    """Frames for which a box was given."""
    mean_iou: float
    auc: float
    precision20: float


def score_boxes(found: np.ndarray, truth: np.ndarray) -> OverlapScore:
    """`found`, `truth`: shape (n, 4), x, y, width, height; a row of NaN is no box. Raises ValueError on other shapes,
    and when there is no true box at all."""
    if found.shape != truth.shape or found.ndim != 2 or found.shape[1] != 4 or len(found) == 0:
        raise ValueError(f"boxes of shape {found.shape} against {truth.shape}: both must be (n, 4) with n > 0")
    known = has_box(truth)
    if not known.any():
        raise ValueError("there is no true box")
    found, truth = found[known], truth[known]
    iou = np.nan_to_num(_iou(found, truth))
    off_px = np.hypot(*((found + np.roll(found, -2, 1) / 2 - truth - np.roll(truth, -2, 1) / 2)[:, :2].T))
    return OverlapScore(
        frames=len(found),
        boxes=int(np.isfinite(found).all(1).sum()),
        mean_iou=float(iou.mean()),
        auc=float(np.mean([(iou > threshold).mean() for threshold in THRESHOLDS])),
        precision20=float((off_px <= PRECISION_PX).mean()),
    )


def has_box(truth: np.ndarray) -> np.ndarray:
    """(n,) bool: which of these rows (n, 4) are boxes. A file says of frames without the target NaN, or no size."""
    return np.asarray((np.abs(truth) <= MOST_PX).all(1) & (truth[:, 2:] > 0).all(1))


def _iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Intersection over union, row by row."""
    corner = np.maximum(a[:, :2], b[:, :2])
    opposite = np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:])
    common = np.clip(opposite - corner, 0, None).prod(1)
    return np.asarray(common / (a[:, 2:].prod(1) + b[:, 2:].prod(1) - common))


def read_truth(path: Path) -> np.ndarray:
    """An OTB `groundtruth_rect.txt`: four numbers a line, apart by commas, tabs or spaces. Raises StationError."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise StationError(f"{path} cannot be read ({error.strerror}).", usage=True) from error
    except UnicodeDecodeError as error:
        raise StationError(f"{path} is no text, and so no list of boxes.") from error
    rows = [(number, line.strip()) for number, line in enumerate(lines, 1) if line.strip()]
    return np.array([_four_numbers(path, number, line) for number, line in rows]).reshape(-1, 4)


def _four_numbers(path: Path, number: int, line: str) -> list[float]:
    try:
        numbers = [float(word) for word in re.split(r"[,\s]+", line)]
    except ValueError:
        numbers = []
    if len(numbers) != 4:
        raise StationError(
            f"{path} is no list of boxes: four numbers a line are expected, line {number} is {line[:60]!r}."
        )
    return numbers


def read_results(path: Path) -> np.ndarray:
    """The boxes of a `--results` file, frame by frame; NaN where there is none. Raises StationError."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
        if [int(row["frame"]) for row in rows] != list(range(1, len(rows) + 1)):
            raise StationError(
                f"{path} lacks frames, so its rows cannot be told to the truth's: replay the recording with the "
                "agent's --rhythm lockstep."
            )
        names = ("x", "y", "width", "height")
        return np.array([[float(row[name] or "nan") for name in names] for row in rows]).reshape(-1, 4)
    except OSError as error:
        raise StationError(f"{path} cannot be read ({error.strerror}).", usage=True) from error
    except UnicodeDecodeError as error:
        raise StationError(f"{path} is no file written by --results: it is no text.") from error
    except (KeyError, ValueError, TypeError, csv.Error) as error:
        raise StationError(f"{path} is no file written by --results ({error}).") from error
