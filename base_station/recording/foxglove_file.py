"""Writes MCAP files with the field's own schemas; the only place that knows foxglove-sdk (extra `record`).

The file is handed out to the writing library as an object of ours, so that a full disk is noticed here: the library
itself would only log it. After the first failure nothing more is written; what is in the file already stays readable.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from base_station.errors import StationError
from base_station.evaluation.slam.trajectory import quaternions
from base_station.geometry import PinholeCamera
from base_station.recording import topics
from base_station.recording.labels import Label

CHUNK_BYTES = 1 << 20
COMPRESSION_LEVEL = 1
NS_PER_S = 1_000_000_000
CAMERA_FRAME, WORLD_FRAME = "camera", "world"
LINE_PX, TEXT_PX = 2.0, 14.0
"""Of annotations: their lines' thickness, and their letters' height."""


class _Sink(io.RawIOBase):
    """The file as the library sees it: without a buffer, so that a process that is killed loses nothing written."""

    def __init__(self, descriptor: int) -> None:
        self._file = io.FileIO(descriptor, "wb")
        self._at = self._end = 0
        self.failure: OSError | None = None
        self.written = 0

    def write(self, data: Any) -> int:
        """All of it, or after a failure none, without a word: see `failure`."""
        view = memoryview(data)
        self._at += len(view)
        self._end = max(self._end, self._at)
        while self.failure is None and len(view):
            try:
                count = self._file.write(view) or 0
            except OSError as error:
                self.failure = error
                break
            self.written += count
            view = view[count:]
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Where the library believes to be: after a failure it goes on counting what is not written any more."""
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._end}[whence]
        if self.failure is None:
            self._file.seek(self._at)
        return self._at

    def seekable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._at

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        if not self.closed:
            self._file.close()
        super().close()


@dataclass(frozen=True)
class Stamp:
    """When a message belongs: nanoseconds since 1970."""

    ns: int


class FoxgloveFile:
    """One recording. Not for several threads. Raises StationError when the file cannot be made."""

    def __init__(self, path: Path) -> None:
        self._library = _Library()
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except FileExistsError as error:
            raise StationError(f"{path} is there already: name another file for the recording.", usage=True) from error
        except OSError as error:
            raise StationError(f"{path} cannot be written ({error.strerror}).", usage=True) from error
        self._sink = _Sink(descriptor)
        self._context = self._library.context()
        self._channels: dict[str, Any] = {}
        self._writer = self._library.writer(self._sink, self._context)
        if self.failure:
            self._sink.close()
            raise StationError(f"{path} cannot be written ({self.failure}).", usage=True)

    @property
    def failure(self) -> str:
        """Why nothing is written any more; empty while all is well."""
        error = self._sink.failure
        return "" if error is None else error.strerror or str(error)

    @property
    def bytes_written(self) -> int:
        return self._sink.written

    def json(self, topic: str, at: Stamp, fields: Mapping[str, Any]) -> None:
        """A message of one of our own topics."""
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._library.foxglove.Channel(topic, schema=topics.SCHEMAS[topic], context=self._context)
            self._channels[topic] = channel
        channel.log(topics.dumps(fields), log_time=at.ns)

    def jpeg(self, at: Stamp, data: bytes) -> None:
        """A picture, compressed."""
        message = self._library.messages.CompressedImage(
            timestamp=self._library.timestamp(at), frame_id=CAMERA_FRAME, data=data, format="jpeg"
        )
        self._log("CompressedImageChannel", topics.CAMERA, at, message)

    def raw(self, at: Stamp, image: np.ndarray) -> None:
        """A gray picture as it is, uint8 (height, width)."""
        height, width = image.shape
        message = self._library.messages.RawImage(
            timestamp=self._library.timestamp(at), frame_id=CAMERA_FRAME, width=width, height=height, encoding="mono8",
            step=width, data=image.tobytes(),
        )  # fmt: skip
        self._log("RawImageChannel", topics.CAMERA, at, message)

    def annotations(self, at: Stamp, labels: Sequence[Label]) -> None:
        """Boxes and words over the picture of the same time; none where there are none, so that old ones go."""
        messages, timestamp = self._library.messages, self._library.timestamp(at)
        points, texts = [], []
        for label in labels:
            colour = messages.Color(r=label.colour[0], g=label.colour[1], b=label.colour[2], a=1.0)
            x, y = label.at_px
            if label.box is not None:
                left, top, width, height = label.box
                corners = ((left, top), (left + width, top), (left + width, top + height), (left, top + height))
                points.append(
                    messages.PointsAnnotation(
                        timestamp=timestamp, type=messages.PointsAnnotationType.LineLoop,
                        points=[messages.Point2(x=x, y=y) for x, y in corners], outline_color=colour, thickness=LINE_PX,
                    )
                )  # fmt: skip
            texts.append(
                messages.TextAnnotation(
                    timestamp=timestamp, position=messages.Point2(x=x, y=y), text=label.text, font_size=TEXT_PX,
                    text_color=colour, background_color=messages.Color(r=0.04, g=0.05, b=0.07, a=0.7),
                )
            )  # fmt: skip
        message = messages.ImageAnnotations(timestamp=timestamp, points=points, texts=texts)
        self._log("ImageAnnotationsChannel", topics.ANNOTATIONS, at, message)

    def calibration(self, at: Stamp, camera: PinholeCamera) -> None:
        """The camera, of whole pictures."""
        fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
        distortion = (*camera.distortion, *[0.0] * 5)[:5]
        message = self._library.messages.CameraCalibration(
            timestamp=self._library.timestamp(at), frame_id=CAMERA_FRAME, width=camera.width, height=camera.height,
            distortion_model="plumb_bob", D=list(distortion), K=[fx, 0, cx, 0, fy, cy, 0, 0, 1],
            R=[1, 0, 0, 0, 1, 0, 0, 0, 1], P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
        )  # fmt: skip
        self._log("CameraCalibrationChannel", topics.CALIBRATION, at, message)

    def pose(self, topic: str, at: Stamp, frame_id: str, world_from_body: np.ndarray) -> None:
        """A pose (4x4) in the frame of this name."""
        message = self._library.messages.PoseInFrame(
            timestamp=self._library.timestamp(at), frame_id=frame_id, pose=self._library.pose(world_from_body)
        )
        self._log("PoseInFrameChannel", topic, at, message)

    def transform(self, at: Stamp, parent: str, child: str, parent_from_child: np.ndarray) -> None:
        """Where the frame `child` is (4x4)."""
        place, turn = self._library.place_and_turn(parent_from_child)
        message = self._library.messages.FrameTransform(
            timestamp=self._library.timestamp(at), parent_frame_id=parent, child_frame_id=child,
            translation=place, rotation=turn,
        )  # fmt: skip
        self._log("FrameTransformChannel", topics.TRANSFORMS, at, message)

    def metadata(self, name: str, fields: Mapping[str, str]) -> None:
        """A metadata record; ends the chunk."""
        self._writer.write_metadata(name, dict(fields))

    def flush(self) -> None:
        """All that was written until now can be read, whatever happens next."""
        self._writer.flush()

    def close(self) -> None:
        self._writer.close()
        self._sink.close()

    def _log(self, kind: str, topic: str, at: Stamp, message: Any) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = getattr(self._library.channels, kind)(topic, context=self._context)
            self._channels[topic] = channel
        channel.log(message, log_time=at.ns)


class _Library:
    """What is used of foxglove-sdk. Raises StationError, one sentence, when it is missing."""

    def __init__(self) -> None:
        try:
            import foxglove
            from foxglove import channels, mcap, messages
        except ImportError:
            raise StationError("Recording needs foxglove-sdk: pip install 'zservo[record]'.", usage=True) from None
        self.foxglove, self.channels, self.messages, self._mcap = foxglove, channels, messages, mcap

    def context(self) -> Any:
        """Of one file: what is logged there goes nowhere else."""
        return self.foxglove.Context()

    def writer(self, sink: _Sink, context: Any) -> Any:
        """Of chunks that are compressed in the thread that writes."""
        options = self._mcap.MCAPWriteOptions(
            compression=self._mcap.MCAPCompression.Zstd,
            compression_level=COMPRESSION_LEVEL,
            compression_threads=0,
            chunk_size=CHUNK_BYTES,
            profile="zservo",
        )
        return self.foxglove.open_mcap(sink, context=context, writer_options=options)

    def timestamp(self, at: Stamp) -> Any:
        return self.messages.Timestamp(sec=at.ns // NS_PER_S, nsec=at.ns % NS_PER_S)

    def pose(self, world_from_body: np.ndarray) -> Any:
        """Of a 4x4 matrix."""
        place, turn = self.place_and_turn(world_from_body)
        return self.messages.Pose(position=place, orientation=turn)

    def place_and_turn(self, world_from_body: np.ndarray) -> tuple[Any, Any]:
        """Its vector and its quaternion."""
        x, y, z, w = (float(part) for part in quaternions(world_from_body[None, :3, :3])[0])
        px, py, pz = (float(part) for part in world_from_body[:3, 3])
        place = self.messages.Vector3(x=px, y=py, z=pz)
        return place, self.messages.Quaternion(x=x, y=y, z=z, w=w)
