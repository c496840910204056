"""Tracked boxes against true ones, as the OTB benchmark scores them (Wu, Lim and Yang, CVPR 2013).

Success is the share of frames whose overlap exceeds a threshold, averaged over thresholds 0 to 1 (the area under its
curve); precision the share whose centre is within 20 px. A frame without a box overlaps by nothing.
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


@dataclass(frozen=True, kw_only=True)
class OverlapScore:
    frames: int
    boxes: int
    """Frames for which a box was given."""
    mean_iou: float
    auc: float
    precision20: float


def score_boxes(found: np.ndarray, truth: np.ndarray) -> OverlapScore:
    """`found`, `truth`: shape (n, 4), x, y, width, height; a row of NaN is no box. Raises ValueError on other
    shapes."""
    if found.shape != truth.shape or found.ndim != 2 or found.shape[1] != 4 or len(found) == 0:
        raise ValueError(f"boxes of shape {found.shape} against {truth.shape}: both must be (n, 4) with n > 0")
    iou = np.nan_to_num(_iou(found, truth))
    off_px = np.hypot(*((found + np.roll(found, -2, 1) / 2 - truth - np.roll(truth, -2, 1) / 2)[:, :2].T))
    return OverlapScore(
        frames=len(found),
        boxes=int(np.isfinite(found).all(1).sum()),
        mean_iou=float(iou.mean()),
        auc=float(np.mean([(iou > threshold).mean() for threshold in THRESHOLDS])),
        precision20=float((off_px <= PRECISION_PX).mean()),
    )


def _iou(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Intersection over union, row by row."""
    corner = np.maximum(a[:, :2], b[:, :2])
    opposite = np.minimum(a[:, :2] + a[:, 2:], b[:, :2] + b[:, 2:])
    common = np.clip(opposite - corner, 0, None).prod(1)
    return np.asarray(common / (a[:, 2:].prod(1) + b[:, 2:].prod(1) - common))


def read_truth(path: Path) -> np.ndarray:
    """An OTB `groundtruth_rect.txt`: four numbers a line, apart by commas, tabs or spaces. Raises StationError."""
    try:
        lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
        boxes = [[float(word) for word in re.split(r"[,\s]+", line.strip())] for line in lines]
        if any(len(box) != 4 for box in boxes):
            raise ValueError("a line has another number of them")
        return np.array(boxes).reshape(-1, 4)
    except OSError as error:
        raise StationError(f"{path} cannot be read ({error.strerror}).", usage=True) from error
    except ValueError as error:
        raise StationError(f"{path} is no list of boxes: four numbers a line are expected ({error}).") from error


def read_results(path: Path) -> np.ndarray:
    """The boxes of a `--results` file, frame by frame; NaN where there is none. Raises StationError."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
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
    except (KeyError, ValueError) as error:
        raise StationError(f"{path} is no file written by --results ({error}).") from error
