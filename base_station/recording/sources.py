"""What can be replayed: our own recordings, folders of pictures in the field's layouts, videos.

Each gives frames with their times, what was ordered with them, and, where somebody knows it, the truth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from base_station.errors import StationError, counted
from base_station.evaluation.overlap import has_box, read_truth
from base_station.evaluation.sequences import IMAGE_FOLDER, TRUTH_FILE, check_numbers, in_order
from base_station.evaluation.slam.sequence import PICTURE_SUFFIXES, SlamSequence, read_gray, read_sequence
from base_station.geometry import PinholeCamera
from base_station.orders import Order
from base_station.recording.reader import RecordedStep, Recording
from base_station.types import Box, Frame
from protocol import Truth

FPS = 30.0
"""Of folders without times."""
LONGEST_SIDE_PX = 8192
RECORDING_SUFFIX = ".mcap"


@dataclass(frozen=True, kw_only=True)
class SourceFrame:
    """One frame of a source. `frame`: None when its picture is missing. `recorded`: what the station made of it, which
    can be compared only if the same was learned."""

    frame: Frame | None
    orders: tuple[Order, ...] = ()
    recorded: RecordedStep | None = None
    comparable: bool = False


@dataclass(frozen=True)
class TargetTruth:
    """What is known of the target in one frame; None where it is not."""

    bearing_rad: float | None = None
    zoom: float | None = None
    shift_px: float | None = None


@dataclass(kw_only=True)
class Known:
    """What a source knows besides its frames, complete after the last one was read."""

    truth: dict[int, TargetTruth] = field(default_factory=dict)
    """By the frame's place in the source, from 0."""
    notes: list[str] = field(default_factory=list)
    """What a person should know of it."""


class Source(Protocol):
    """Iterate it, as often as you like."""

    name: str

    def __iter__(self) -> Iterator[SourceFrame]:
        """Raises StationError when the source is damaged."""
        ...

    def known(self) -> Known:
        """After the last frame."""
        ...


def open_source(path: Path, *, target: Box | None = None, width: int | None = None) -> Source:
    """By the name: FILE.mcap is a recording, another file a video, a folder one of the layouts.

    `target` is learned in the first frame, instead of what the source tells. `width`: shrink pictures of folders and
    videos to so many columns; the target is counted in the shrunk picture. Raises StationError.
    """
    if width is not None and not 16 <= width <= LONGEST_SIDE_PX:
        raise StationError(f"--width must be 16..{LONGEST_SIDE_PX}, not {width}.", usage=True)
    if path.is_dir():
        return _folder(path, target, width)
    if not path.is_file():
        raise StationError(f"There is no {path}.", usage=True)
    if path.suffix.lower() == RECORDING_SUFFIX:
        if width is not None:
            raise StationError("--width is for folders and videos: a recording is replayed as it is.", usage=True)
        return RecordedRun(Recording(path), target)
    return Video(path, target, width)


class RecordedRun:
    """A recording of the station."""

    def __init__(self, recording: Recording, target: Box | None = None) -> None:
        self.recording, self._target = recording, target
        self.name = recording.path.stem
        self._keys: list[tuple[str, int]] = []
        self._pans: list[float] = []
        self._learned: list[int] = []
        self._missing = 0

    def __iter__(self) -> Iterator[SourceFrame]:
        self._keys, self._pans, self._learned, self._missing = [], [], [], 0
        first = (Order.learn(self._target),) if self._target is not None else ()
        for step in self.recording:
            orders = step.orders
            if self._target is not None:
                orders = first + tuple(order for order in orders if order.kind != "learn")
                first = ()
            if step.learned:
                self._learned.append(len(self._keys))
            self._keys.append(step.key)
            self._pans.append(step.pan_rad or 0.0)
            self._missing += step.frame is None
            yield SourceFrame(frame=step.frame, orders=orders, recorded=step, comparable=self._target is None)

    def known(self) -> Known:
        """Bearing and zoom of the simulation's truth, from the camera's axis, since the target was learned."""
        notes = list(self.recording.notes)
        if self._missing:
            notes.append(f"{self._missing} of {len(self._keys)} frames have no picture in this recording")
        return Known(truth=self._truth() if self._target is None else {}, notes=notes)

    def _truth(self) -> dict[int, TargetTruth]:
        found: dict[int, TargetTruth] = {}
        learned_depth_m: float | None = None
        learned = set(self._learned)
        for place, (key, pan_rad) in enumerate(zip(self._keys, self._pans, strict=True)):
            truth = self.recording.truths.get(key)
            if truth is None:
                continue
            depth_m = _depth_m(truth, pan_rad)
            if place in learned:
                learned_depth_m = depth_m
            if truth.bearing_rad is not None and truth.in_view:
                zoom = learned_depth_m / depth_m if learned_depth_m and depth_m else None
                found[place] = TargetTruth(bearing_rad=truth.bearing_rad - pan_rad, zoom=zoom)
        return found


def _depth_m(truth: Truth, pan_rad: float) -> float | None:
    """Along the camera's axis; None when the target is beside it."""
    if truth.range_m is None or truth.bearing_rad is None:
        return None
    depth_m = truth.range_m * math.cos(truth.bearing_rad - pan_rad)
    return depth_m if depth_m > 1e-3 else None


class Pictures:
    """A folder of pictures, with times and the camera where the layout tells them."""

    def __init__(
        self,
        name: str,
        paths: Sequence[Path],
        times_s: Sequence[float],
        *,
        target: Box | None = None,
        boxes: np.ndarray | None = None,
        sequence: SlamSequence | None = None,
        width: int | None = None,
    ) -> None:
        self.name = name
        self._paths, self._times_s, self._target, self._width = paths, times_s, target, width
        self._boxes, self._sequence = boxes, sequence
        self._unread: list[str] = []
        self._scale = 1.0
        self._camera: PinholeCamera | None = None

    def __iter__(self) -> Iterator[SourceFrame]:
        self._unread = []
        order: tuple[Order, ...] = (Order.learn(self._target),)
        size: tuple[int, int] | None = None
        for number, (path, time_s) in enumerate(zip(self._paths, self._times_s, strict=True), 1):
            whole = read_gray(path)
            if whole is None or (size is not None and whole.shape != size):
                self._unread.append(path.name)
                yield SourceFrame(frame=None, orders=order)
                order = ()
                continue
            size = whole.shape[0], whole.shape[1]
            image, self._scale = _shrunk(whole, self._width)
            self._camera = self._camera_of(image, self._scale)
            if self._target is None and self._boxes is not None and order:
                order = (Order.learn(_first_box(self._boxes, self._scale)),)
            frame = Frame(image=image, number=number, time_s=time_s, camera=self._camera, connection=self.name)
            yield SourceFrame(frame=frame, orders=order)
            order = ()
        if len(self._unread) == len(self._paths):
            raise StationError(f"{self.name}: none of the {len(self._paths)} pictures can be read.")

    def _camera_of(self, image: np.ndarray, scale: float) -> PinholeCamera:
        height, width = image.shape
        if self._sequence is None:
            return PinholeCamera.with_fov(width, height)
        known = self._sequence.camera
        cx, cy = (known.cx + 0.5) * scale - 0.5, (known.cy + 0.5) * scale - 0.5
        fx, fy = known.fx * scale, known.fy * scale
        return PinholeCamera(width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy, distortion=known.distortion)

    def known(self) -> Known:
        """Of OTB's layout where the true box is, how large and how far aside, since the first picture."""
        notes = []
        if self._unread:
            many = counted(len(self._unread), "picture")
            notes.append(f"{many} cannot be read or differ in size; the first: {self._unread[0]}")
        if self._boxes is not None and self._target is None and not (known := has_box(self._boxes)).all():
            notes.append(f"{(~known).sum()} of {len(known)} true boxes are none, and their pictures are not compared")
        return Known(truth=self._truth(), notes=notes)

    def _truth(self) -> dict[int, TargetTruth]:
        if self._boxes is None or self._camera is None or self._target is not None:
            return {}
        places = np.flatnonzero(has_box(self._boxes))
        boxes, camera = self._boxes[places] * self._scale, self._camera
        centers = boxes[:, 0] + (boxes[:, 2] - 1) / 2
        sizes = np.sqrt(boxes[:, 2] * boxes[:, 3])
        return {
            int(place): TargetTruth(
                bearing_rad=camera.bearing_rad(float(center)),
                zoom=float(size / sizes[0]),
                shift_px=float(center - centers[0]),
            )
            for place, center, size in zip(places, centers, sizes, strict=True)
        }


def _first_box(boxes: np.ndarray, scale: float) -> Box:
    if not has_box(boxes[:1]).any():
        raise StationError(f"{TRUTH_FILE}: the first line is no box to learn.")
    return Box(*(float(side) for side in boxes[0] * scale))


def _shrunk(image: np.ndarray, width: int | None) -> tuple[np.ndarray, float]:
    """The picture with so many columns, if it has more, and by how much it was scaled. Not to be written to."""
    scale = 1.0
    if width is not None and image.shape[1] > width:
        scale = width / image.shape[1]
        image = cv2.resize(image, (width, max(1, round(image.shape[0] * scale))), interpolation=cv2.INTER_AREA)
    image.flags.writeable = False
    return image, scale


def _folder(path: Path, target: Box | None, width: int | None) -> Pictures:
    name = path.resolve().name
    if (path / TRUTH_FILE).is_file():
        paths, boxes = in_order(_images(path / IMAGE_FOLDER)), read_truth(path / TRUTH_FILE)
        if target is None:
            check_numbers(paths, len(boxes))
        return Pictures(name, paths, _even(paths), target=target, boxes=boxes[: len(paths)], width=width)
    layouts = ("rgb.txt", "mav0/cam0/data.csv", "cam0/data.csv", "times.txt")
    if any((path / listed).is_file() for listed in layouts):
        sequence = read_sequence(path)
        times_s = [float(time_s) for time_s in sequence.times_s]
        return Pictures(name, sequence.pictures, times_s, target=target, sequence=sequence, width=width)
    paths = _images(path / IMAGE_FOLDER if (path / IMAGE_FOLDER).is_dir() else path)
    return Pictures(name, paths, _even(paths), target=target, width=width)


def _images(folder: Path) -> list[Path]:
    try:
        found = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES)
    except OSError as error:
        raise StationError(f"{folder} cannot be read ({error.strerror}).", usage=True) from error
    if not found:
        raise StationError(
            f"{folder} has no pictures ({', '.join(PICTURE_SUFFIXES)}) and no layout that is known (TUM, EuRoC, KITTI, "
            "OTB).",
            usage=True,
        )
    return found


def _even(paths: Sequence[Path]) -> list[float]:
    return [number / FPS for number in range(len(paths))]


class Video:
    """A video's file, such as a phone makes: whatever OpenCV reads. Phones turn their pictures; OpenCV turns back."""

    def __init__(self, path: Path, target: Box | None = None, width: int | None = None) -> None:
        self.name = path.stem
        self._path, self._target, self._width = path, target, width
        self._open().release()

    def _open(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(str(self._path))
        if not capture.isOpened():
            raise StationError(f"{self._path} is no video that can be read.", usage=True)
        return capture

    def __iter__(self) -> Iterator[SourceFrame]:
        capture = self._open()
        try:
            fps = capture.get(cv2.CAP_PROP_FPS)
            period_s = 1 / fps if math.isfinite(fps) and 0.1 <= fps <= 1000 else 1 / FPS
            number, last_s = 0, -period_s
            while (image := self._next(capture)) is not None:
                told_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                last_s = told_s if math.isfinite(told_s) and told_s > last_s else last_s + period_s
                number += 1
                camera = PinholeCamera.with_fov(image.shape[1], image.shape[0])
                frame = Frame(image=image, number=number, time_s=last_s, camera=camera, connection=self.name)
                yield SourceFrame(frame=frame, orders=(Order.learn(self._target),) if number == 1 else ())
            if not number:
                raise StationError(f"{self._path} shows no pictures.")
        finally:
            capture.release()

    def _next(self, capture: cv2.VideoCapture) -> np.ndarray | None:
        try:
            there, picture = capture.read()
        except cv2.error:
            return None
        if not there:
            return None
        gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY) if picture.ndim == 3 else picture
        if max(gray.shape) > LONGEST_SIDE_PX:
            raise StationError(f"{self._path}: pictures of {gray.shape[1]}x{gray.shape[0]} px are too large.")
        return _shrunk(gray, self._width)[0]

    def known(self) -> Known:
        """Nothing."""
        return Known()
