"""What a tracker saw as a video: every frame with the target's box and the result in words."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from base_station.display import describe
from base_station.errors import StationError
from base_station.evaluation.drawing import GREEN, RED, WHITE, as_ascii, draw_text
from base_station.output_files import check_output
from base_station.station import Step
from base_station.types import TrackingState

FOURCC = {".mp4": "mp4v", ".avi": "MJPG"}
FPS = 30.0
UNSENT_GRAY = 60
STRIP_PX = 24
"""Above the picture, for the words."""


class SeenVideo:
    """Use as a context manager. Raises StationError when there is no such kind of video, or it cannot be written."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._writer: cv2.VideoWriter | None = None
        self._size, self._frames = (0, 0), 0
        check_output("--video", path, tuple(FOURCC))

    def __enter__(self) -> SeenVideo:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._writer is None:
            return
        self._writer.release()
        if kind is None:
            self._check_written()

    def _check_written(self) -> None:
        """OpenCV's writer does not tell when the disk is full."""
        written = cv2.VideoCapture(str(self._path))
        frames = round(written.get(cv2.CAP_PROP_FRAME_COUNT)) if written.isOpened() else 0
        written.release()
        if frames < self._frames:
            raise StationError(f"{self._path} is cut short, {frames} of {self._frames} frames: is the disk full?")

    def note_step(self, step: Step) -> None:
        """One frame more. All have the size of the first."""
        picture = drawn(step)
        size = picture.shape[1], picture.shape[0]
        if self._writer is None:
            self._size = size
            fourcc = cv2.VideoWriter.fourcc(*FOURCC[self._path.suffix.lower()])
            self._writer = cv2.VideoWriter(str(self._path), fourcc, FPS, size)
            if not self._writer.isOpened():
                raise StationError(f"{self._path} cannot be written as a video.")
        if size != self._size:
            picture = cv2.resize(picture, self._size)
        self._writer.write(picture)
        self._frames += 1


def drawn(step: Step) -> np.ndarray:
    """The whole frame with the box (blue, green, red; even sides), a strip with the result above it."""
    frame, result = step.frame, step.result
    rows, columns = frame.shape
    whole = np.full((rows, columns), UNSENT_GRAY, np.uint8)
    whole[frame.first_row : frame.first_row + len(frame.image)] = frame.image
    picture = cv2.copyMakeBorder(
        cv2.cvtColor(whole, cv2.COLOR_GRAY2BGR), STRIP_PX, rows % 2, 0, columns % 2, cv2.BORDER_CONSTANT
    )
    tracking = result.state is TrackingState.TRACKING
    if result.box is not None:
        box, color = result.box, GREEN if tracking else RED
        corner = round(box.x), round(box.y) + STRIP_PX
        cv2.rectangle(picture, corner, (corner[0] + round(box.width), corner[1] + round(box.height)), color, 2)
    text = f"{step.tracker.rpartition('/')[2]}  {result.state.value}  {as_ascii(describe(result))}"
    draw_text(picture, text, (6, 17), color=WHITE if tracking else RED)
    return picture
