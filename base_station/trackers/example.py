"""A tracker of your own in one file: follow a torch, the brightest spot of the picture.

Copy this file, change `update`, and run it without touching anything else:

    base-station run --tracker base_station/trackers/example.py:TorchTracker

A tracker is any class without constructor arguments that has three methods. `learn` remembers, `update` looks at
one frame, `close` lets go. Rules: never write to the frame's image, read no clock but `frame.time_s`, and when you do
not see the target return LOST with the reason in words: a robot drives by what you return.
"""

from __future__ import annotations

import cv2

from base_station.types import Box, Frame, TrackerResult, TrackingState

LEAST_CONTRAST = 60.0
"""Grey levels by which the spot must outshine the mean of the picture."""
SPOT_PX = 15
"""The picture is blurred over this many pixels first, so that a single noisy pixel is no torch. Odd."""


class TorchTracker:
    """Knows where the brightest spot is and how bright; nothing about its distance, so zoom stays None."""

    def __init__(self) -> None:
        self._learned_at: tuple[int, int] | None = None

    def learn(self, frame: Frame, target: Box | None) -> None:
        """Remember where the torch is now; shifts are told against this. The box is not needed."""
        x, y, contrast = _brightest(frame)
        if contrast < LEAST_CONTRAST:
            raise ValueError(f"featureless: nothing outshines the picture (by {contrast:.0f} of {LEAST_CONTRAST:.0f})")
        self._learned_at = (x, y)

    def update(self, frame: Frame) -> TrackerResult:
        """Where it is in this frame."""
        if self._learned_at is None:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
        x, y, contrast = _brightest(frame)
        if contrast < LEAST_CONTRAST:
            return TrackerResult(state=TrackingState.LOST, reason=f"no torch: contrast {contrast:.0f} grey levels")
        return TrackerResult(
            state=TrackingState.TRACKING,
            shift_px=float(x - self._learned_at[0]),
            shift_y_px=float(y - self._learned_at[1]),
            bearing_rad=frame.camera.bearing_rad(x),
            elevation_rad=frame.camera.elevation_rad(y),
            confidence=min(contrast / 255, 1.0),
            box=Box.around(x, y, SPOT_PX, SPOT_PX),
        )

    def close(self) -> None:
        """Nothing to let go of but the memory."""
        self._learned_at = None


def _brightest(frame: Frame) -> tuple[int, int, float]:
    """Column and row of the brightest spot, and by how much it outshines the picture's mean."""
    smooth = cv2.blur(frame.image, (SPOT_PX, SPOT_PX))
    _, brightest, _, (x, y) = cv2.minMaxLoc(smooth)
    return x, y, float(brightest - smooth.mean())
