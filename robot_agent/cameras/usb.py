"""A USB (V4L2) camera through OpenCV, as the thesis used (listing A.1)."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import cv2

from protocol import Intrinsics
from robot_agent.cameras.base import CameraFrame
from robot_agent.errors import CameraError


class UsbCamera:
    """Gray pictures of camera `device` (a number, or a path such as /dev/video0).

    OpenCV's read blocks without a time-out when a camera hangs, so a thread of its own reads, and `read` waits for it.
    Raises CameraError when the device cannot be opened or gives another size than asked.
    """

    def __init__(
        self,
        device: str = "0",
        *,
        width: int = 640,
        height: int = 480,
        fps: float = 30.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._capture = _open(device)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
        self._capture.set(cv2.CAP_PROP_FPS, fps)
        self.width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if (self.width, self.height) != (width, height):
            self._capture.release()
            raise CameraError(
                f"Camera {device} gives {self.width}x{self.height} instead of {width}x{height}: "
                f"use --size {self.width}x{self.height}."
            )
        self.fps = float(self._capture.get(cv2.CAP_PROP_FPS)) or fps
        self.intrinsics: Intrinsics | None = None
        self._clock = clock
        self._news = threading.Condition()
        self._newest: CameraFrame | None = None
        self._failed = False
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._grab, name="usb-camera", daemon=True)
        self._thread.start()

    def _grab(self) -> None:
        while not self._closing.is_set():
            good, picture = self._capture.read()
            captured_s = self._clock()
            with self._news:
                self._failed = not good
                if good:
                    gray = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
                    self._newest = CameraFrame(gray, captured_s)
                self._news.notify()
            if not good:
                return

    def begin(self) -> None:
        """A live camera runs already."""

    def read(self, timeout_s: float) -> CameraFrame | None:
        """See Camera.read."""
        with self._news:
            self._news.wait_for(lambda: self._newest is not None or self._failed, timeout_s)
            frame, self._newest = self._newest, None
            if frame is None and self._failed:
                raise CameraError("The USB camera stopped giving pictures: check its cable and start the agent again.")
            return frame

    def close(self) -> None:
        """Let go of the device, unless its driver hangs: then the process's end does."""
        self._closing.set()
        self._thread.join(timeout=1.0)
        if not self._thread.is_alive():
            self._capture.release()


def _open(device: str) -> cv2.VideoCapture:
    path = f"/dev/video{device}" if device.isdigit() else device
    # OpenCV would print lines of its own about a device that is not there.
    if not path.startswith("/") or Path(path).exists():
        capture = cv2.VideoCapture(int(device) if device.isdigit() else device)
        if capture.isOpened():
            return capture
    present = ", ".join(sorted(str(path) for path in Path("/dev").glob("video*"))) or "none"
    raise CameraError(
        f"Camera {device} cannot be opened (video devices here: {present}): plug it in, or name another with --source."
    )
