"""Records a run: what the loop saw and did goes into a queue, and a thread of its own writes it to an MCAP file.

The loop never waits for the disk. When the thread cannot keep up, pictures are left out first (and counted), the rest
of a step later. When nothing can be written any more the recording ends and says so; the robot goes on.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from base_station.errors import StationError
from base_station.geometry import FlatPose, PinholeCamera
from base_station.recording import topics
from base_station.recording.foxglove_file import CAMERA_FRAME, NS_PER_S, WORLD_FRAME, FoxgloveFile, Stamp
from base_station.recording.jpeg import JpegEncoder
from base_station.recording.labels import labels_of
from base_station.recording.poses import inverse, world_from_camera, world_from_robot
from base_station.station import Step
from base_station.types import Frame
from protocol import Hello, Telemetry, Truth

log = logging.getLogger(__name__)

FLUSH_S = 0.5
"""So much is lost at the most of a process that is killed, besides what is in the queue."""
MOST_QUEUED_BYTES = 64 << 20
"""Of pictures: some 7 s of 640x480 at 30 per second."""
MOST_QUEUED = 4096
KEPT_TRUTHS = 512
CLOSING_S = 20.0
ODOMETRY_FRAME, MAP_FRAME = "odometry", "map"

FrameKey = tuple[str, int]


@dataclass(frozen=True)
class _Seen:
    """A step, where the robot was by its wheels, and whether its picture is still there."""

    step: Step
    driven: FlatPose | None
    picture: bool


@dataclass(frozen=True)
class _Heard:
    """Telemetry, and when it came, on the frames' clock."""

    telemetry: Telemetry
    time_s: float


class Recorder:
    """`note_step` and `note_telemetry` may be called from different threads, and return at once.

    `raw`: pictures without loss, so that a replay gives the same results. `patient`: rather wait than leave anything
    out, for a replay: no robot waits for it. `run`: what the run was asked for, as values
    that JSON knows. `hello`: what the robot says of itself. `driven`: where the wheels say that the robot was in a
    frame. Raises StationError, a mistake of usage, when the file cannot be made or foxglove-sdk is missing.
    """

    def __init__(
        self,
        path: Path,
        *,
        raw: bool = False,
        patient: bool = False,
        run: Mapping[str, Any] | None = None,
        hello: Callable[[], Hello | None] = lambda: None,
        driven: Callable[[Frame], FlatPose | None] = lambda frame: None,
    ) -> None:
        if path.suffix != ".mcap":
            raise StationError(f"{path}: call a recording NAME.mcap, or nothing opens it.", usage=True)
        self.path = path
        self.frames_without_picture = 0
        """Of the frames recorded, those whose picture was left out because the disk was slow."""
        self.steps_dropped = 0
        """Frames of which nothing was recorded; telemetry that was left out does not count."""
        self.frames = 0
        """Recorded, with or without their picture."""
        self._file = FoxgloveFile(path)
        self._raw, self._patient, self._hello, self._driven = raw, patient, hello, driven
        self._jpeg = JpegEncoder()
        self._queue: deque[_Seen | _Heard] = deque()
        self._queued_bytes = 0
        self._changed = threading.Condition()
        self._closing = False
        self._over = False
        self._ended_early = ""
        self._epoch_ns: int | None = None
        """Since 1970, when the frames' clock was zero."""
        self._newest_s = 0.0
        self._told_hello: Hello | None = None
        self._camera: PinholeCamera | None = None
        self._simulated: bool | None = None
        """The robot tells the truth of its place; None until it has told of a frame."""
        self._truths: OrderedDict[FrameKey, Truth] = OrderedDict()
        self._places: OrderedDict[FrameKey, tuple[Stamp, float]] = OrderedDict()
        """When the last frames were, and the camera's pan in them."""
        self._file.metadata(topics.RUN, {"run": json.dumps(dict(run or {}), default=str), "raw": str(raw).lower()})
        self._file.flush()
        self._thread = threading.Thread(target=self._write_all, name="recorder", daemon=True)
        self._thread.start()

    @property
    def failure(self) -> str:
        """Why the recording ended before its time; empty while all is well."""
        return self._ended_early or self._file.failure

    def note_step(self, step: Step) -> None:
        """A frame was dealt with."""
        if self._over:
            return
        size = step.frame.image.nbytes
        driven = self._driven(step.frame)
        with self._changed:
            if self._patient:
                self._changed.wait_for(lambda: self._queued_bytes <= MOST_QUEUED_BYTES // 4 or self._over)
            full = len(self._queue) >= MOST_QUEUED
            keeps = not full and (not self._queued_bytes or self._queued_bytes + size <= MOST_QUEUED_BYTES)
            if full:
                self.steps_dropped += 1
            else:
                if not keeps:
                    self.frames_without_picture += 1
                    step = replace(step, frame=replace(step.frame, image=step.frame.image[:0]))
                self._queue.append(_Seen(step, driven, keeps))
                self._queued_bytes += size if keeps else 0
                self._changed.notify()
            first = not keeps and self.frames_without_picture + self.steps_dropped == 1
        if first:
            log.warning("The recording cannot keep up (a slow disk or processor): pictures are left out of it.")

    def note_telemetry(self, telemetry: Telemetry) -> None:
        """A message came from the robot."""
        if self._over:
            return
        hello = self._hello()
        stepped = hello is not None and hello.rhythm == "lockstep"
        heard = _Heard(telemetry, self._newest_s if stepped else time.monotonic())
        with self._changed:
            if len(self._queue) < MOST_QUEUED:
                # Wakes nobody: it comes just before a frame, and the loop needs Python's lock then.
                self._queue.append(heard)

    def close(self) -> None:
        """Write what is queued and end the file."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(CLOSING_S)
        if self._thread.is_alive():
            log.error("The recording %s did not come to its end: the disk does not answer.", self.path)

    def described(self) -> str:
        """How the recording went, in a sentence."""
        text = f"{self.path}: {self.frames} frames, {self._file.bytes_written / 1e6:.1f} MB"
        if self.frames_without_picture:
            text += f", {self.frames_without_picture} of them without their picture"
        if self.steps_dropped:
            text += f", {self.steps_dropped} more dropped"
        return text + (f"; ended early: {self.failure}" if self.failure else "")

    # -- the writing thread ----------------------------------------------------------------------------------------

    def _write_all(self) -> None:
        flushed_s = time.monotonic()
        try:
            while (entry := self._next()) is not None or not self._closing:
                if isinstance(entry, _Seen):
                    self._write_step(entry)
                elif entry is not None:
                    self._write_telemetry(entry)
                if time.monotonic() - flushed_s >= FLUSH_S:
                    self._file.flush()
                    flushed_s = time.monotonic()
                if self.failure:
                    self._give_up(self.failure)
                    return
            self._end()
        except Exception as error:  # whatever it is: the robot drives on without a recording
            self._give_up(f"{type(error).__name__}: {error}")

    def _next(self) -> _Seen | _Heard | None:
        """The next entry; None when none came in time, or none will."""
        with self._changed:
            self._changed.wait_for(lambda: self._queue or self._closing, FLUSH_S)
            if not self._queue:
                return None
            entry = self._queue.popleft()
            if isinstance(entry, _Seen) and entry.picture:
                self._queued_bytes -= entry.step.frame.image.nbytes
            if self._patient:
                self._changed.notify()
            return entry

    def _give_up(self, reason: str) -> None:
        self._over, self._ended_early = True, reason
        with self._changed:
            self._queue.clear()
            self._changed.notify_all()
        log.error(
            "The recording ends here: %s cannot be written any more (%s). The %s goes on; %d frames are recorded.",
            self.path, reason, "replay" if self._patient else "robot", self.frames,
        )  # fmt: skip
        self._file.close()

    def _end(self) -> None:
        self._over = True
        self._file.metadata(
            topics.END,
            {
                "frames": str(self.frames),
                "frames_without_picture": str(self.frames_without_picture),
                "steps_dropped": str(self.steps_dropped),
            },
        )
        self._file.close()
        if self.failure:
            log.error("The end of the recording %s could not be written (%s).", self.path, self.failure)

    def _write_step(self, seen: _Seen) -> None:
        step, frame = seen.step, seen.step.frame
        at = self._stamp(frame.time_s)
        self._newest_s = frame.time_s
        self._tell_hello()
        if frame.camera != self._camera:
            self._camera = frame.camera
            self._file.calibration(at, frame.camera)
        if seen.picture:
            self._write_picture(at, frame.image)
        for order in step.orders:
            self._file.json(topics.ORDERS, at, topics.order_fields(order))
        self._file.json(topics.TRACKER, at, topics.result_fields(step.result, step.tracker))
        if step.shadow is not None:
            self._file.json(topics.SHADOW, at, topics.result_fields(step.shadow, step.shadow_tracker or ""))
        fields = topics.step_fields(step, picture=seen.picture)
        self._file.annotations(at, labels_of(step))
        self._file.json(
            topics.COMMAND, at, {name: fields[name] for name in topics.SCHEMAS[topics.COMMAND]["properties"]}
        )
        self._write_poses(at, seen)
        self._file.json(topics.STEP, at, fields)  # the last of a step: a reader knows that it has all
        self.frames += 1
        self._note_place((frame.connection, frame.number), at, step.pan_rad or 0.0)

    def _write_picture(self, at: Stamp, image: np.ndarray) -> None:
        if self._raw:
            self._file.raw(at, image)
            return
        self._file.jpeg(at, self._jpeg.encode(image))

    def _write_poses(self, at: Stamp, seen: _Seen) -> None:
        driven, pose = seen.driven, topics.whole_pose(seen.step.result)
        if driven is not None:
            place = driven.x_m, driven.y_m, driven.heading_rad
            self._file.pose(topics.ODOMETRY_POSE, at, ODOMETRY_FRAME, world_from_robot(*place))
            if self._simulated is False:  # a simulation knows better
                camera = world_from_camera(*place, seen.step.pan_rad or 0.0)
                self._file.transform(at, ODOMETRY_FRAME, CAMERA_FRAME, camera)
        if pose is not None:
            self._file.pose(topics.SLAM_POSE, at, MAP_FRAME, inverse(pose))

    def _write_telemetry(self, heard: _Heard) -> None:
        fields = asdict(heard.telemetry)
        fields.pop("truth")
        self._file.json(topics.TELEMETRY, self._stamp(heard.time_s), fields)
        stamp, truth, station = heard.telemetry.frame, heard.telemetry.truth, heard.telemetry.station
        if stamp is not None:
            self._simulated = self._simulated or truth is not None
        if stamp is not None and truth is not None and station is not None:
            self._note_truth((station, stamp.number), truth)

    def _tell_hello(self) -> None:
        hello = self._hello()
        if hello is not None and hello is not self._told_hello:
            self._told_hello = hello
            self._file.metadata(topics.HELLO, {"hello": json.dumps(asdict(hello))})

    # -- the truth is told with a frame's telemetry, which may come before or after the frame ----------------------

    def _note_truth(self, key: FrameKey, truth: Truth) -> None:
        if key in self._places:
            self._write_truth(key, truth, *self._places.pop(key))
        else:
            _keep(self._truths, key, truth)

    def _note_place(self, key: FrameKey, at: Stamp, pan_rad: float) -> None:
        if key in self._truths:
            self._write_truth(key, self._truths.pop(key), at, pan_rad)
        else:
            _keep(self._places, key, (at, pan_rad))

    def _write_truth(self, key: FrameKey, truth: Truth, at: Stamp, pan_rad: float) -> None:
        connection, number = key
        self._file.json(topics.TRUTH, at, {"number": number, "connection": connection, **asdict(truth)})
        self._file.pose(topics.TRUE_POSE, at, WORLD_FRAME, world_from_robot(*truth.robot))
        self._file.transform(at, WORLD_FRAME, CAMERA_FRAME, world_from_camera(*truth.robot, pan_rad))

    def _stamp(self, time_s: float) -> Stamp:
        """The frames' clock in nanoseconds since 1970: it goes as the frames', and began when the recording did."""
        if self._epoch_ns is None:
            self._epoch_ns = time.time_ns() - round(time_s * NS_PER_S)
        return Stamp(max(0, self._epoch_ns + round(time_s * NS_PER_S)))


def _keep(kept: OrderedDict[FrameKey, Any], key: FrameKey, value: Any) -> None:
    kept[key] = value
    while len(kept) > KEPT_TRUTHS:
        kept.popitem(last=False)
