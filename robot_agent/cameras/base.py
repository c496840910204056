"""What the agent asks of a camera: the next picture, or the news that there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from protocol import Intrinsics, Truth


@dataclass(frozen=True)
class CameraFrame:
    """One picture. `image`: uint8, shape (height, width), gray. `capture_s`: when it was taken, on the camera's clock
    (the agent's monotonic clock; simulated time in simulation; the recorded time in a replay). `truth`: simulation
    only, where things were at that moment."""

    image: np.ndarray
    capture_s: float
    truth: Truth | None = None


class Camera(Protocol):
    """A source of gray pictures of one size. Used from a single thread; `close` may come from another."""

    width: int
    height: int
    fps: float
    intrinsics: Intrinsics | None
    """Of the whole picture (width x height), None when unknown."""

    def begin(self) -> None:
        """The first station is there. Recordings and simulated scenarios start now; a live camera has nothing to do."""
        ...

    def read(self, timeout_s: float) -> CameraFrame | None:
        """Wait for the next picture. None when none came in time. Raises CameraError when the camera is gone and
        EndOfRecording after the last picture of a recording."""
        ...

    def close(self) -> None: ...
