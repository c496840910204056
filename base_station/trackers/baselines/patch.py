"""What the baselines share: a patch that was learned, where it was last, and when there is nothing to say.

A baseline tells what it remembers of the patch (`_prepare`) and how it finds it in a picture (`_look`). The checks, the
reasons and the conversion to a result stand here. A learned place is the patch that fills the view.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.types import Box, Frame, TrackerResult, TrackingState

LEAST_CONTRAST = 2.0
"""Standard deviation of a patch or picture, grey levels; with less it is featureless."""
SMALLEST_SIDE_PX = 8
"""Of the target."""
ROOM_PX = 2
"""Of a band of rows: a patch whose middle lies between two rows is read with both."""


@dataclass(frozen=True, kw_only=True)
class Learned:
    """`shape`: rows and columns of the patch. `center_px`: of the patch, in the frame of this shape."""

    shape: tuple[int, int]
    center_px: tuple[float, float]
    frame_shape: tuple[int, int]
    is_place: bool


@dataclass(frozen=True, kw_only=True)
class Found:
    """Where the patch's middle is now; None is what the method cannot tell."""

    x: float
    y: float | None = None
    zoom: float | None = None
    confidence: float


@dataclass(frozen=True)
class Missed:
    """It was not found. `agreement`: of the best that there was."""

    reason: str
    agreement: float = 0.0


class PatchTracker(ABC):
    """`base.Tracker`, all but the looking."""

    def __init__(self) -> None:
        self._learned: Learned | None = None
        self._last = Found(x=0.0, y=0.0, confidence=0.0)
        """Where it was seen last, or learned."""

    def learn(self, frame: Frame, target: Box | None) -> None:
        """Remember the patch. Raises ValueError as `base.Tracker.learn` does."""
        height, width = frame.shape
        box = (target or Box(0, 0, width, height)).clipped(width, height)
        if box is None:
            raise ValueError("the box is outside of the frame")
        columns, rows = round(box.width), round(box.height)
        if min(columns, rows) < SMALLEST_SIDE_PX:
            raise ValueError(f"the target is too small: {columns}x{rows} px")
        x, y = box.center_px
        patch = cut(frame.image, x, y, columns, rows)
        if float(patch.std()) < LEAST_CONTRAST:
            raise ValueError(f"featureless: the target's contrast is {patch.std():.1f} grey levels")
        learned = Learned(shape=(rows, columns), center_px=(x, y), frame_shape=frame.shape, is_place=target is None)
        self._prepare(frame.image, patch, learned)
        self._learned, self._last = learned, Found(x=x, y=y, confidence=1.0)

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        learned = self._learned
        if learned is None:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
        if frame.shape != learned.frame_shape:
            now, then = frame.shape, learned.frame_shape
            return _lost(Missed(f"the frame is {now[1]}x{now[0]}, learned in {then[1]}x{then[0]}"))
        contrast = float(cv2.meanStdDev(frame.image)[1][0, 0])
        if contrast < LEAST_CONTRAST:
            return _lost(Missed(f"featureless: contrast {contrast:.1f} grey levels"))
        found = self._look(frame.image, _in_band(learned, frame.first_row))
        if isinstance(found, Missed):
            return _lost(found)
        if not learned.is_place and _is_outside(found, learned.frame_shape):
            return _lost(Missed("the target left the frame"))
        self._last = found
        return _tracked(found, learned, frame)

    @property
    def landmark_bytes(self) -> int:
        """What must be kept to find it again: the patch, a byte a pixel, from which all else can be made once more."""
        return math.prod(self._learned.shape) if self._learned is not None else 0

    def close(self) -> None:
        """Let go of what was learned."""
        self._learned = None

    @abstractmethod
    def _prepare(self, image: np.ndarray, patch: np.ndarray, learned: Learned) -> None:
        """Remember what is needed of the picture, or of the patch (as `cut` gives it). Raises ValueError when this
        cannot be tracked."""

    @abstractmethod
    def _look(self, image: np.ndarray, learned: Learned) -> Found | Missed:
        """Where the patch is in this picture, which has the learned one's shape. A tracker that wants a band of rows
        (`RowsOfPatch`) may get one: `learned.center_px` is then in its rows."""


class RowsOfPatch(PatchTracker):
    """One that reads the rows of the learned patch, wherever the patch has gone, and no others."""

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        wanted = self.wanted_rows()
        if wanted is not None and not frame.has_rows(*wanted):
            return _lost(Missed("the frame is a band without the target's rows"))
        return super().update(frame)

    def wanted_rows(self) -> tuple[int, int] | None:
        """See `base.WantsRows`."""
        if self._learned is None:
            return None
        middle, half = self._learned.center_px[1], self._learned.shape[0] / 2
        return math.floor(middle - half) - ROOM_PX, math.ceil(middle + half) + ROOM_PX


def cut(image: np.ndarray, x: float, y: float, columns: int, rows: int) -> np.ndarray:
    """The patch about x, y less its mean, float32 (rows, columns); outside of the frame, the border repeats.

    Without its mean, because the window's own spectrum about 0 would otherwise agree with itself: a peak at no shift.
    """
    patch = cv2.getRectSubPix(image, (columns, rows), (x, y), patchType=cv2.CV_32F)
    return patch - patch.mean()


def agreement(one: np.ndarray, other: np.ndarray) -> float:
    """Normalised correlation of two patches (or profiles) that have no mean, -1..1."""
    return float((one * other).sum() / max(float(np.sqrt((one**2).sum() * (other**2).sum())), 1e-6))


def peak_offset(before: float, peak: float, after: float) -> float:
    """Where the parabola through three values at -1, 0, 1 has its top, -0.5..0.5; `peak` is the largest of them."""
    curvature = before - 2 * peak + after
    return 0.0 if curvature >= 0 else min(max(0.5 * (before - after) / curvature, -0.5), 0.5)


def gone(agreement: float) -> Missed:
    """The usual reason."""
    return Missed(f"the target is hidden or gone (agreement {agreement:.2f})", agreement)


def _in_band(learned: Learned, first_row: int) -> Learned:
    if not first_row:
        return learned
    x, y = learned.center_px
    return dataclasses.replace(learned, center_px=(x, y - first_row))


def _is_outside(found: Found, shape: tuple[int, int]) -> bool:
    return not 0 <= found.x < shape[1] or (found.y is not None and not 0 <= found.y < shape[0])


def _tracked(found: Found, learned: Learned, frame: Frame) -> TrackerResult:
    (rows, columns), zoom = learned.shape, found.zoom or 1.0
    y, there = found.y, learned.center_px
    return TrackerResult(
        state=TrackingState.TRACKING,
        shift_px=found.x - there[0],
        shift_y_px=None if y is None else y - there[1],
        bearing_rad=frame.camera.bearing_rad(found.x),
        elevation_rad=None if y is None else frame.camera.elevation_rad(y),
        zoom=found.zoom,
        confidence=min(max(found.confidence, 0.0), 1.0),
        box=None if y is None else Box.around(found.x, y, columns * zoom, rows * zoom),
    )


def _lost(missed: Missed) -> TrackerResult:
    confidence = min(max(missed.agreement, 0.0), 1.0)
    return TrackerResult(state=TrackingState.LOST, reason=missed.reason, confidence=confidence)
