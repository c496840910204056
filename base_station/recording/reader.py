"""A recording read back, step by step, as the station saw and did it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from base_station.errors import StationError
from base_station.geometry import PinholeCamera
from base_station.orders import Order
from base_station.recording import protobuf, topics
from base_station.recording.mcap_file import McapFile, Message, Metadata
from base_station.types import Frame, TrackerResult
from protocol import Command, Hello, Telemetry, Truth

LONGEST_SIDE_PX = 8192
MOST_NUMBER = 1 << 40
LOWEST_UNIT, HIGHEST_UNIT = -128, 127

FrameKey = tuple[str, int]


@dataclass(frozen=True, kw_only=True)
class RecordedStep:
    """One frame and what was made of it. `frame`: None when its picture was left out (a slow disk)."""

    frame: Frame | None
    log_ns: int
    """When it was taken, nanoseconds since 1970."""
    key: FrameKey
    result: TrackerResult
    shadow: TrackerResult | None
    command: Command
    orders: tuple[Order, ...]
    tracker: str
    shadow_tracker: str | None
    behaviour: str
    learned: bool
    tracker_s: float
    pan_rad: float | None


class Recording:
    """Iterate it, as often as you like. `truths`, `odometry`, `notes`, `telemetry`, `hello`: of what was read so far.

    Raises StationError when the file cannot be read or holds something else than a run of the station.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.truths: dict[FrameKey, Truth] = {}
        """By connection and number of the frame; of the simulation only."""
        self.odometry: list[tuple[int, np.ndarray]] = []
        """World from robot (4x4) by the wheels, with nanoseconds since 1970."""
        self.notes: list[str] = []
        """What is wrong with the file, for a person."""
        self.telemetry: Telemetry | None = None
        """The newest that was read."""
        self.hello: Hello | None = None
        """What the robot last said of itself."""
        self._file = McapFile(path)
        told = self._told()
        self.raw = told.get("raw") == "true"
        """Its pictures are without loss."""
        self.run = _json_object(told.get("run", "{}"))
        """What the run was asked for."""

    @property
    def options(self) -> dict[str, Any]:
        """Of `base-station run`."""
        options = self.run.get("options")
        return options if isinstance(options, dict) else {}

    def option(self, name: str) -> str | None:
        """An option's text; None where it was not given."""
        value = self.options.get(name)
        return value if isinstance(value, str) else None

    def length(self, name: str) -> float | None:
        """An option's number; None where it was not given."""
        value = self.options.get(name)
        return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None

    def __iter__(self) -> Iterator[RecordedStep]:
        self.truths, self.odometry, self.notes = {}, [], []
        self.telemetry = self.hello = None
        gathered = _Gathered()
        count = 0
        for entry in self._file:
            try:
                if isinstance(entry, Metadata):
                    self._note(entry)
                    continue
                step = self._take(gathered, entry)
            except StationError as error:
                raise StationError(f"{self.path}, after {count} frames: {error}.") from error
            if step is not None:
                count += 1
                yield step
        if self._file.damage:
            self.notes.append(f"only {count} frames of {self.path} can be read: {self._file.damage}")
        if not count:
            raise StationError(f"{self.path} holds no frames of a run{': ' if self.notes else ''}{self._file.damage}.")

    def _told(self) -> dict[str, str]:
        for entry in self._file:
            if isinstance(entry, Message):
                break
            if entry.name == topics.RUN:
                return entry.fields
        raise StationError(f"{self.path} is no recording of `base-station run --record`.", usage=True)

    def _note(self, metadata: Metadata) -> None:
        if metadata.name == topics.HELLO:
            self.hello = topics.record_of(Hello, _json_object(metadata.fields.get("hello", "")))

    def _take(self, gathered: _Gathered, message: Message) -> RecordedStep | None:
        """The step that this message is the last of."""
        topic, data = message.topic, message.data
        if topic == topics.CALIBRATION:
            gathered.camera = _camera(data)
        elif topic == topics.CAMERA:
            gathered.picture = data
        elif topic == topics.ODOMETRY_POSE:
            self.odometry.append((message.log_ns, _pose(data)))
        elif topic == topics.TELEMETRY:
            self.telemetry = topics.record_of(Telemetry, topics.loads(topic, data))
        elif topic in (topics.ORDERS, topics.TRACKER, topics.SHADOW, topics.TRUTH, topics.STEP):
            fields = topics.loads(topic, data)
            if topic == topics.ORDERS:
                if len(gathered.orders) >= topics.MOST_ORDERS:
                    raise StationError("too many orders in one frame")
                gathered.orders.append(topics.order_of(fields))
            elif topic == topics.TRACKER:
                gathered.result = topics.result_of(fields)
            elif topic == topics.SHADOW:
                gathered.shadow = topics.result_of(fields)
            elif topic == topics.TRUTH:
                key = topics.text(fields, "connection"), topics.whole(fields, "number", 0, MOST_NUMBER)
                self.truths[key] = topics.truth_of(fields)
            else:
                return gathered.step(fields, message.log_ns)
        return None


class _Gathered:
    """The parts of a step until its last one comes."""

    def __init__(self) -> None:
        self.camera: PinholeCamera | None = None
        self._clear()

    def _clear(self) -> None:
        self.picture: bytes | None = None
        self.result: TrackerResult | None = None
        self.shadow: TrackerResult | None = None
        self.orders: list[Order] = []

    def step(self, fields: Mapping[str, Any], log_ns: int) -> RecordedStep:
        if self.result is None:
            raise StationError("a step without a tracker's result")
        connection, number = topics.text(fields, "connection"), topics.whole(fields, "number", 0, MOST_NUMBER)
        left, right = (topics.whole(fields, name, LOWEST_UNIT, HIGHEST_UNIT) for name in ("left", "right"))
        step = RecordedStep(
            frame=self._frame(fields, connection, number) if self.picture is not None else None,
            log_ns=log_ns,
            key=(connection, number),
            result=self.result,
            shadow=self.shadow,
            command=Command(left, right),
            orders=tuple(self.orders),
            tracker=topics.text(fields, "tracker"),
            shadow_tracker=topics.text(fields, "shadow_tracker") or None,
            behaviour=topics.text(fields, "behaviour"),
            learned=fields.get("learned") is True,
            tracker_s=topics.number(fields, "tracker_s"),
            pan_rad=topics.maybe_number(fields, "pan_rad"),
        )
        self._clear()
        return step

    def _frame(self, fields: Mapping[str, Any], connection: str, number: int) -> Frame:
        assert self.picture is not None
        if self.camera is None:
            raise StationError("a picture without its camera")
        width, height = (topics.whole(fields, name, 1, LONGEST_SIDE_PX) for name in ("width", "height"))
        first_row = topics.whole(fields, "first_row", 0, LONGEST_SIDE_PX)
        full_height = topics.whole(fields, "full_height", 0, LONGEST_SIDE_PX)
        image = _image(self.picture)
        if image.shape != (height, width):
            raise StationError(f"a picture of {image.shape[1]}x{image.shape[0]} px where {width}x{height} were told")
        if full_height and first_row + height > full_height:
            raise StationError("a band of rows that sticks out of the picture")
        return Frame(
            image=image,
            number=number,
            time_s=topics.number(fields, "time_s"),
            camera=self.camera,
            connection=connection,
            first_row=first_row,
            full_height=full_height,
        )


# -- foxglove's messages; field numbers as in its schemas, which are in every file -----------------------------------


def _image(data: bytes) -> np.ndarray:
    """Of a RawImage or CompressedImage: uint8 (height, width), not to be written to."""
    fields = protobuf.fields_of(data)
    if 6 in fields:
        width, height, step = (protobuf.whole(fields, number) for number in (2, 3, 5))
        pixels = protobuf.data(fields, 6)
        if protobuf.data(fields, 4) != b"mono8" or step != width or len(pixels) != width * height:
            raise StationError("a picture that is not gray, or not whole")
        return np.frombuffer(pixels, np.uint8).reshape(height, width)
    found = None
    with contextlib.suppress(cv2.error):
        found = cv2.imdecode(np.frombuffer(protobuf.data(fields, 2), np.uint8), cv2.IMREAD_GRAYSCALE)
    if found is None:
        raise StationError("a picture that cannot be read")
    found.flags.writeable = False
    return np.asarray(found)


def _camera(data: bytes) -> PinholeCamera:
    fields = protobuf.fields_of(data)
    width, height, k = protobuf.whole(fields, 2), protobuf.whole(fields, 3), protobuf.doubles(fields, 6)
    if len(k) != 9 or not np.isfinite(k).all() or min(k[0], k[4]) <= 0:
        raise StationError("a camera whose matrix is none")
    if not (1 <= width <= LONGEST_SIDE_PX and 1 <= height <= LONGEST_SIDE_PX):
        raise StationError(f"a camera of {width}x{height} px")
    d = protobuf.doubles(fields, 5) if 5 in fields else ()
    if not np.isfinite(d).all() or (any(d) and len(d) not in (4, 5)):
        raise StationError("a camera whose distortion is none")
    distortion = (d if any(d[4:]) else d[:4]) if any(d) else ()
    return PinholeCamera(width=width, height=height, fx=k[0], fy=k[4], cx=k[2], cy=k[5], distortion=distortion)


def _pose(data: bytes) -> np.ndarray:
    """World from body (4x4) of a PoseInFrame."""
    from base_station.evaluation.slam.trajectory import rotations

    pose = protobuf.fields_of(protobuf.data(protobuf.fields_of(data), 3))
    place, turn = (protobuf.fields_of(protobuf.data(pose, number)) for number in (1, 2))
    xyz, xyzw = (
        [(protobuf.doubles(fields, number) or (0.0,))[-1] for number in range(1, count + 1)]
        for fields, count in ((place, 3), (turn, 4))
    )
    if not np.isfinite([*xyz, *xyzw]).all() or abs(np.linalg.norm(xyzw) - 1) > 0.1:
        raise StationError("a pose that is none")
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotations(np.array([xyzw]))[0], xyz
    return found


def _json_object(text: str) -> dict[str, Any]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}
