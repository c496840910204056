"""Writes MCAP files with the field's own schemas; the only place that knows foxglove-sdk (extra `record`).

The file is handed out to the writing library as an object of ours, so that a full disk is noticed here: the library
itself would only log it. After the first failure nothing more is written; what is in the file already stays readable.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from base_station.errors import StationError
from base_station.evaluation.slam.trajectory import quaternions
from base_station.geometry import PinholeCamera
from base_station.recording import topics

if TYPE_CHECKING:
    from foxglove.messages import Pose, Timestamp

CHUNK_BYTES = 1 << 20
COMPRESSION_LEVEL = 1
NS_PER_S = 1_000_000_000
CAMERA_FRAME, WORLD_FRAME = "camera", "world"


def require() -> None:
    """Raises StationError now, not when the robot moves already, when the library is missing."""
    _foxglove()


def _foxglove() -> Any:
    try:
        import foxglove
    except ImportError:
        raise StationError("Recording needs foxglove-sdk: pip install 'zservo[record]'.", usage=True) from None
    return foxglove


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

    def timestamp(self) -> Timestamp:
        from foxglove.messages import Timestamp

        return Timestamp(sec=self.ns // NS_PER_S, nsec=self.ns % NS_PER_S)


class FoxgloveFile:
    """One recording. Not for several threads. Raises StationError when the file cannot be made."""

    def __init__(self, path: Path) -> None:
        foxglove = _foxglove()
        from foxglove import Context
        from foxglove.mcap import MCAPCompression, MCAPWriteOptions

        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        except FileExistsError as error:
            raise StationError(f"{path} is there already: name another file for the recording.", usage=True) from error
        except OSError as error:
            raise StationError(f"{path} cannot be written ({error.strerror}).", usage=True) from error
        self._sink = _Sink(descriptor)
        self._context = Context()
        self._channels: dict[str, Any] = {}
        options = MCAPWriteOptions(
            compression=MCAPCompression.Zstd,
            compression_level=COMPRESSION_LEVEL,
            compression_threads=0,
            chunk_size=CHUNK_BYTES,
            profile="zservo",
        )
        self._writer = foxglove.open_mcap(self._sink, context=self._context, writer_options=options)
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
            from foxglove import Channel

            channel = Channel(topic, schema=topics.SCHEMAS[topic], context=self._context)
            self._channels[topic] = channel
        channel.log(topics.dumps(fields), log_time=at.ns)

    def jpeg(self, at: Stamp, data: bytes) -> None:
        """A picture, compressed."""
        from foxglove.messages import CompressedImage

        message = CompressedImage(timestamp=at.timestamp(), frame_id=CAMERA_FRAME, data=data, format="jpeg")
        self._log("CompressedImageChannel", topics.CAMERA, at, message)

    def raw(self, at: Stamp, image: np.ndarray) -> None:
        """A gray picture as it is, uint8 (height, width)."""
        from foxglove.messages import RawImage

        height, width = image.shape
        message = RawImage(
            timestamp=at.timestamp(), frame_id=CAMERA_FRAME, width=width, height=height, encoding="mono8", step=width,
            data=image.tobytes(),
        )  # fmt: skip
        self._log("RawImageChannel", topics.CAMERA, at, message)

    def calibration(self, at: Stamp, camera: PinholeCamera) -> None:
        """The camera, of whole pictures."""
        from foxglove.messages import CameraCalibration

        fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
        message = CameraCalibration(
            timestamp=at.timestamp(), frame_id=CAMERA_FRAME, width=camera.width, height=camera.height,
            distortion_model="plumb_bob", D=[0.0] * 5, K=[fx, 0, cx, 0, fy, cy, 0, 0, 1],
            R=[1, 0, 0, 0, 1, 0, 0, 0, 1], P=[fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0],
        )  # fmt: skip
        self._log("CameraCalibrationChannel", topics.CALIBRATION, at, message)

    def pose(self, topic: str, at: Stamp, frame_id: str, world_from_body: np.ndarray) -> None:
        """A pose (4x4) in the frame of this name."""
        from foxglove.messages import PoseInFrame

        message = PoseInFrame(timestamp=at.timestamp(), frame_id=frame_id, pose=_pose(world_from_body))
        self._log("PoseInFrameChannel", topic, at, message)

    def transform(self, at: Stamp, parent: str, child: str, parent_from_child: np.ndarray) -> None:
        """Where the frame `child` is (4x4)."""
        from foxglove.messages import FrameTransform, Quaternion, Vector3

        place, (x, y, z, w) = parent_from_child[:3, 3], quaternions(parent_from_child[None, :3, :3])[0]
        message = FrameTransform(
            timestamp=at.timestamp(), parent_frame_id=parent, child_frame_id=child,
            translation=Vector3(x=float(place[0]), y=float(place[1]), z=float(place[2])),
            rotation=Quaternion(x=float(x), y=float(y), z=float(z), w=float(w)),
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
            from foxglove import channels

            channel = getattr(channels, kind)(topic, context=self._context)
            self._channels[topic] = channel
        channel.log(message, log_time=at.ns)


def _pose(world_from_body: np.ndarray) -> Pose:
    from foxglove.messages import Pose, Quaternion, Vector3

    place, (x, y, z, w) = world_from_body[:3, 3], quaternions(world_from_body[None, :3, :3])[0]
    return Pose(
        position=Vector3(x=float(place[0]), y=float(place[1]), z=float(place[2])),
        orientation=Quaternion(x=float(x), y=float(y), z=float(z), w=float(w)),
    )
