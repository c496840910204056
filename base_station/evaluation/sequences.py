"""Tracking of recorded sequences with a true box per picture, as the OTB benchmark does it (one-pass evaluation).

A sequence is a folder with `img/*.jpg` (or png) and `groundtruth_rect.txt`. The tracker learns the first true box; that
box counts as its answer to the first picture. Every further picture needs a box: when a tracker is LOST, the box that
it gave last stands for it, and the picture is counted in `lost_frames`. A picture without a true box is shown, and not
compared. Learning is not in the times.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from base_station.errors import StationError, counted
from base_station.evaluation.overlap import has_box, read_truth, score_boxes
from base_station.geometry import PinholeCamera
from base_station.trackers.base import Tracker
from base_station.trackers.own import FAILURES, checked, told
from base_station.types import Box, Frame, TrackingState

TRUTH_FILE, IMAGE_FOLDER = "groundtruth_rect.txt", "img"
SUFFIXES = (".jpg", ".jpeg", ".png")
FPS = 30.0


@dataclass(frozen=True, kw_only=True)
class Recording:
    """`truth`: (n, 4), x, y, width, height of the first n pictures; NaN or no size where there is no true box."""

    name: str
    pictures: Sequence[Path]
    truth: np.ndarray
    note: str = ""
    """What a reader of the scores should know."""


@dataclass(frozen=True, kw_only=True)
class SequenceScore:
    """What a tracker did on one sequence."""

    sequence: str
    frames: int
    auc: float
    """Area under the success curve, 0..1 (see `overlap`)."""
    precision20: float
    """Share of pictures whose centre is within 20 px."""
    mean_iou: float
    ms_p50: float
    ms_p95: float
    lost_frames: int


class Follower(Protocol):
    """What follows a box through pictures (uint8; gray, or blue, green, red, as `flags` says to cv2.imread)."""

    flags: int

    def start(self, image: np.ndarray, box: Box) -> None:
        """Raises ValueError when this box cannot be followed."""
        ...

    def next(self, image: np.ndarray) -> Box | None:
        """The box, or None: lost."""
        ...


class TrackerFollower:
    """One of our trackers: gray pictures at 30 a second, a camera with the default field of view."""

    flags = cv2.IMREAD_GRAYSCALE

    def __init__(self, tracker: Tracker) -> None:
        self._tracker, self._number = tracker, 0

    def start(self, image: np.ndarray, box: Box) -> None:
        """Learn it."""
        self._tracker.learn(self._frame(image), box)

    def next(self, image: np.ndarray) -> Box | None:
        """Update with the next frame."""
        result = checked(self._tracker, self._tracker.update(self._frame(image)))
        return result.box if result.state is TrackingState.TRACKING else None

    def _frame(self, image: np.ndarray) -> Frame:
        self._number += 1
        camera = PinholeCamera.with_fov(image.shape[1], image.shape[0])
        return Frame(image=image, number=self._number, time_s=self._number / FPS, camera=camera)


def find_sequences(folder: Path, max_frames: int | None = None) -> list[Recording]:
    """The folder itself if it is a sequence, else those right inside of it. Raises StationError when there are none."""
    if not folder.is_dir():
        raise StationError(f"There is no folder {folder}.", usage=True)
    if (folder / TRUTH_FILE).is_file():
        return [_sequence(folder, max_frames)]
    inside = [path for path in sorted(folder.iterdir()) if (path / TRUTH_FILE).is_file()]
    if not inside:
        raise StationError(
            f"{folder} is no OTB sequence: {TRUTH_FILE} and {IMAGE_FOLDER}/ are expected in it, or in folders in it.",
            usage=True,
        )
    return [_sequence(path, max_frames) for path in inside]


def _sequence(folder: Path, max_frames: int | None) -> Recording:
    images = folder / IMAGE_FOLDER
    pictures = in_order(path for path in images.glob("*") if path.suffix.lower() in SUFFIXES)
    if not pictures:
        raise StationError(f"{images} has no pictures ({', '.join(SUFFIXES)}).", usage=True)
    truth = read_truth(folder / TRUTH_FILE)
    frames = min(len(pictures), len(truth), max_frames or len(truth))
    if frames < 2:
        raise StationError(
            f"{folder} has {counted(frames, 'picture')} with a true box; at least 2 are needed.", usage=True
        )
    check_numbers(pictures, len(truth))
    name = folder.resolve().name
    known = has_box(truth[:frames])
    if not known[0]:
        raise StationError(f"{folder / TRUTH_FILE}: the first line is no box to learn.")
    differ = len(pictures) != len(truth) and frames == min(len(pictures), len(truth))
    notes = [f"{len(pictures)} pictures and {len(truth)} true boxes; the first {frames} are compared"] if differ else []
    if not known.all():
        notes.append(f"{frames - known.sum()} of {frames} pictures have no true box and are left out")
    return Recording(name=name, pictures=pictures[:frames], truth=truth[:frames], note="; ".join(notes))


def in_order(paths: Iterable[Path]) -> list[Path]:
    """By the numbers that their names end with, if all have one (2 before 10), else by name."""
    found = sorted(paths)
    numbers = _numbers(found)
    return found if numbers is None else [found[at] for at in np.argsort(numbers, kind="stable")]


def check_numbers(pictures: Sequence[Path], boxes: int) -> None:
    """Raises StationError when pictures are missing in the middle, so that it is not told which box is whose. Whatever
    the first number is, the first box is the first picture's; as many boxes as pictures belong to them one by one."""
    frames = min(len(pictures), boxes)
    numbers = _numbers(pictures)
    if numbers is None or len(pictures) == boxes:
        return
    gap = next((at for at in range(1, frames) if numbers[at] != numbers[at - 1] + 1), None)
    if gap is not None:
        raise StationError(
            f"{pictures[gap - 1].parent}: after {pictures[gap - 1].name} comes {pictures[gap].name}, and there are "
            f"{counted(boxes, 'true box', 'true boxes')} for {counted(len(pictures), 'picture')}: which box belongs to "
            "which picture cannot be told. Put the missing pictures back, or take out their lines."
        )


def _numbers(pictures: Sequence[Path]) -> list[int] | None:
    """That the names end with, after the same beginning; None where they do not tell one each."""
    parts = [re.fullmatch(r"(.*?)([0-9]{1,12})", path.stem) for path in pictures]
    named = [(part[1], int(part[2])) for part in parts if part is not None]
    if len(named) != len(pictures) or len({begin for begin, _ in named}) != 1:
        return None
    numbers = [number for _, number in named]
    return numbers if len(set(numbers)) == len(numbers) else None


def run_sequence(sequence: Recording, follower: Follower, on_frame: Callable[[], None] = lambda: None) -> SequenceScore:
    """Raises StationError when the first box cannot be learned, a picture cannot be read, or the follower fails."""
    first = Box(*sequence.truth[0].tolist())
    image = _read(sequence.pictures[0], follower.flags)
    try:
        follower.start(image, first)
    except ValueError as error:
        raise StationError(f"{sequence.name}: the first box cannot be learned: {error}.") from error
    except FAILURES as error:
        raise _failed(sequence, sequence.pictures[0], error) from error
    on_frame()
    boxes, times_ms, lost = [first], [], 0
    for path in sequence.pictures[1:]:
        image = _read(path, follower.flags)
        begin = time.perf_counter_ns()
        try:
            box = follower.next(image)
        except FAILURES as error:
            raise _failed(sequence, path, error) from error
        times_ms.append((time.perf_counter_ns() - begin) / 1e6)
        lost += box is None
        boxes.append(box or boxes[-1])
        on_frame()
    found = np.array([(box.x, box.y, box.width, box.height) for box in boxes])
    score = score_boxes(found, sequence.truth)
    return SequenceScore(
        sequence=sequence.name,
        frames=score.frames,
        auc=score.auc,
        precision20=score.precision20,
        mean_iou=score.mean_iou,
        ms_p50=float(np.median(times_ms)),
        ms_p95=float(np.percentile(times_ms, 95)),
        lost_frames=lost,
    )


def _failed(sequence: Recording, path: Path, error: BaseException) -> StationError:
    if isinstance(error, StationError):
        return error
    return StationError(f"{sequence.name}: the tracker failed at {path.name}: {told(error)}.")


def _read(path: Path, flags: int) -> np.ndarray:
    try:
        image = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), flags)
    except (OSError, cv2.error):
        image = None
    if image is None:
        raise StationError(f"{path} cannot be read as a picture.")
    return np.asarray(image)


def mean_score(scores: Sequence[SequenceScore]) -> SequenceScore:
    """Each sequence counts the same, whatever its length; frames are summed up."""
    return SequenceScore(
        sequence="mean",
        frames=sum(score.frames for score in scores),
        auc=float(np.mean([score.auc for score in scores])),
        precision20=float(np.mean([score.precision20 for score in scores])),
        mean_iou=float(np.mean([score.mean_iou for score in scores])),
        ms_p50=float(np.mean([score.ms_p50 for score in scores])),
        ms_p95=float(np.mean([score.ms_p95 for score in scores])),
        lost_frames=sum(score.lost_frames for score in scores),
    )
