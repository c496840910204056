"""The Raspberry Pi's own camera through picamera2 (Raspberry Pi OS, package python3-picamera2)."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from protocol import Intrinsics
from robot_agent.cameras.base import CameraFrame
from robot_agent.errors import CameraError

WIDTH_STEP_PX = 64


class PiCamera:
    """Gray pictures: the Y plane of YUV420, which is the picture's first `height` rows, without any conversion.

    The array that libcamera fills is copied once, because its buffer goes back to the camera.
    Raises CameraError without picamera2, without a camera, or for a width that is no multiple of 64.
    """

    def __init__(
        self, *, width: int = 640, height: int = 480, fps: float = 30.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        if width % WIDTH_STEP_PX:
            raise CameraError(f"The Pi camera needs a width that is a multiple of {WIDTH_STEP_PX}, not {width}.")
        self._camera = _open()
        period_us = round(1_000_000 / fps)
        configuration = self._camera.create_video_configuration(
            main={"format": "YUV420", "size": (width, height)},
            controls={"FrameDurationLimits": (period_us, period_us)},
            buffer_count=3,
        )
        self._camera.configure(configuration)
        self._camera.start()
        self.width, self.height, self.fps = width, height, fps
        self.intrinsics: Intrinsics | None = None
        self._clock = clock
        self._news = threading.Condition()
        self._newest: CameraFrame | None = None
        self._error: Exception | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._grab, name="pi-camera", daemon=True)
        self._thread.start()

    def _grab(self) -> None:
        try:
            while not self._closing.is_set():
                planes = self._camera.capture_array("main")
                frame = CameraFrame(planes[: self.height, : self.width].copy(), self._clock())
                with self._news:
                    self._newest = frame
                    self._news.notify()
        except Exception as error:  # whatever libcamera raises must reach the reader, not end a thread unseen
            with self._news:
                self._error = error
                self._news.notify()

    def begin(self) -> None:
        """A live camera runs already."""

    def read(self, timeout_s: float) -> CameraFrame | None:
        """See Camera.read."""
        with self._news:
            self._news.wait_for(lambda: self._newest is not None or self._error is not None, timeout_s)
            frame, self._newest = self._newest, None
            if frame is None and self._error is not None:
                raise CameraError(f"The Pi camera failed: {self._error}. Check its ribbon cable, then start again.")
            return frame

    def set_exposure(self, exposure_us: float) -> None:
        """Fix the exposure time; 0 gives it back to the camera's automatic."""
        self._camera.set_controls({"AeEnable": exposure_us == 0, "ExposureTime": int(exposure_us)})

    def close(self) -> None:
        self._closing.set()
        self._thread.join(timeout=1.0)
        self._camera.stop()
        self._camera.close()


def _open() -> Any:
    try:
        from picamera2 import Picamera2
    except ImportError as error:
        raise CameraError(
            "The Pi camera needs picamera2: sudo apt install python3-picamera2 (Raspberry Pi OS only)."
        ) from error
    try:
        return Picamera2()
    except (IndexError, RuntimeError) as error:
        raise CameraError(
            f"No Pi camera answers ({error}): check its cable; `rpicam-hello` must show a picture."
        ) from error
