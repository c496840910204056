"""A recording as a camera: a video file or a folder of pictures, at its own rate, at another, or frame by frame."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from protocol import Intrinsics
from robot_agent.cameras.base import CameraFrame
from robot_agent.cameras.decoding import read_gray, read_video, scaled
from robot_agent.cameras.recordings import list_images
from robot_agent.errors import CameraError, EndOfRecording

DEFAULT_FPS = 30.0


class ReplayCamera:
    """Gray pictures of a recording, each once and in order, from the first one after `begin`.

    `size`: (width, height) to scale to, None keeps the recording's. `fps`: a rate of one's own; None keeps the
    recorded times (30 per second where there are none). With `realtime` false, `read` never waits.
    Raises CameraError when the source is missing, unreadable or empty.
    """

    def __init__(
        self,
        source: str,
        *,
        size: tuple[int, int] | None = None,
        fps: float | None = None,
        realtime: bool = True,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        path = Path(source).expanduser()
        if not path.exists():
            raise CameraError(f"There is no recording {source}: name a video file or a folder with --source.")
        self._pictures = _folder(path) if path.is_dir() else read_video(path)
        self._size, self._own_fps, self._realtime, self._clock = size, fps, realtime, clock
        self._first_time_s: float | None = None
        self._started_s = 0.0
        self._loaded = 0
        self._begun = threading.Event()
        self._closed = threading.Event()
        self.height, self.width = 0, 0
        self._ahead = [frame for frame in (self._load(), self._load()) if frame is not None]
        if not self._ahead:
            raise CameraError(f"There is no picture in {source} that OpenCV can read.")
        interval_s = self._ahead[-1].capture_s - self._ahead[0].capture_s
        self.fps = 1.0 / interval_s if interval_s > 0 else DEFAULT_FPS
        self.intrinsics: Intrinsics | None = None

    def begin(self) -> None:
        """A station is there: the recording starts."""
        if not self._begun.is_set():
            self._started_s = self._clock()
            self._begun.set()

    def read(self, timeout_s: float) -> CameraFrame | None:
        """See Camera.read. `capture_s` is the recorded time since the first picture."""
        if not self._begun.wait(timeout_s):
            return None
        if not self._ahead:
            raise EndOfRecording("The recording has come to its end.")
        if self._realtime:
            wait_s = self._started_s + self._ahead[0].capture_s - self._clock()
            if self._closed.wait(max(0.0, min(wait_s, timeout_s))) or wait_s > timeout_s:
                return None
        frame = self._ahead.pop(0)
        following = self._load()
        if following is not None:
            self._ahead.append(following)
        return frame

    def close(self) -> None:
        self._closed.set()
        self._begun.set()

    def _load(self) -> CameraFrame | None:
        item = next(self._pictures, None)
        if item is None:
            return None
        time_s, picture = item
        if self._size is not None:
            picture = scaled(picture, self._size)
        if self._loaded == 0:
            self.height, self.width = picture.shape
        elif picture.shape != (self.height, self.width):
            raise CameraError(
                f"Picture {self._loaded + 1} of the recording is {picture.shape[1]}x{picture.shape[0]}, the first was "
                f"{self.width}x{self.height}: give one size for all with --size."
            )
        capture_s = self._capture_time_s(time_s)
        self._loaded += 1
        return CameraFrame(picture, capture_s)

    def _capture_time_s(self, time_s: float | None) -> float:
        """Time since the first picture."""
        if self._own_fps or time_s is None:
            return self._loaded / (self._own_fps or DEFAULT_FPS)
        if self._first_time_s is None:
            self._first_time_s = time_s
        return time_s - self._first_time_s


def _folder(path: Path) -> Iterator[tuple[float | None, np.ndarray]]:
    for image in list_images(path):
        picture = read_gray(image.path)
        if picture is None:
            raise CameraError(f"{image.path} is missing or no picture: mend the recording or take it out of the list.")
        yield image.time_s, picture
