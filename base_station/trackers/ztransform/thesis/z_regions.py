"""Algorithm 4.2 of the thesis: which region of the row has changed most?

A row (the mean of some rows) is divided into equal regions; each is transformed by itself at z = 0.7, 0.8 and 0.9. The
region whose numbers differ most from those of the learned view is where something has moved.

What it tells: a coarse bearing, that of the region's middle, good to half a region (1/32 of the view), while the camera
stands still. It tells no shift, no zoom and no elevation; not whether what moved is the target; and no heading to a
place. When nothing has changed it tells no bearing. When the camera itself moves, every region changes and the greatest
change is somewhere: the confidence (how much one region stands out) is then low.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.ztransform.texture import texture_of
from base_station.trackers.ztransform.thesis.kernels import transform_regions
from base_station.types import Box, Frame, TrackerResult, TrackingState


@dataclass(frozen=True, kw_only=True)
class ZRegionsSettings:
    """How to divide, and what counts as a change. Raises ValueError for fewer than two regions or z outside of 0..1."""

    regions: int = 16
    """Equal parts of the row. The thesis: e.g. 4."""
    z: tuple[float, ...] = (0.7, 0.8, 0.9)
    """The transform is taken at each; z = 0.9 sees some 10 px at each end of a region, z = 0.7 some 3."""
    rows: int = 64
    """Rows about the middle of the target, or of the view, that are averaged into one. The thesis: 1."""
    least_change: float = 3.0
    """Grey levels; below it nothing has changed."""
    least_texture: float = 1.5
    """Grey levels; less is featureless."""
    smallest_side_px: int = 10
    """Of the target."""

    def __post_init__(self) -> None:
        if self.regions < 2 or not self.z or not all(0 < z < 1 for z in self.z):
            raise ValueError("z-regions needs two regions or more, and every z between 0 and 1")


class ZRegionsTracker:
    """See the module. Source: Khalil 2021, algorithm 4.2 (pseudo-code only: listing A.4 is A.3 again)."""

    def __init__(self, *, settings: ZRegionsSettings | None = None) -> None:
        self._settings = settings or ZRegionsSettings()
        self._z = np.array(self._settings.z)
        self._profile: np.ndarray | None = None
        self._transform(np.zeros(64))  # compile (or load) the kernel now

    def learn(self, frame: Frame, target: Box | None) -> None:
        """Remember the row's transforms; a box only says which rows. Raises ValueError as `base.Tracker.learn` does."""
        settings, (height, width) = self._settings, frame.image.shape
        box = (target or Box(0, 0, width, height)).clipped(width, height)
        if box is None:
            raise ValueError("the box is outside of the frame")
        if min(box.width, box.height) < settings.smallest_side_px or width < 4 * settings.regions:
            raise ValueError(f"the target or the frame is too small: {box.width:.0f}x{box.height:.0f} px of {width}")
        first = round(box.center_px[1] - settings.rows / 2 + 0.5)
        self._rows = max(first, 0), min(max(first, 0) + settings.rows, height)
        rows = frame.rows(*self._rows)
        texture = _texture(rows)
        if texture < settings.least_texture:
            raise ValueError(f"featureless: the texture of the target's rows is {texture:.1f} grey levels")
        self._shape = frame.shape
        self._profile = _mean_row(rows)

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        if self._profile is None:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
        if frame.shape != self._shape:
            now, then = frame.shape, self._shape
            return _lost(f"the frame is {now[1]}x{now[0]}, learned in {then[1]}x{then[0]}")
        if not frame.has_rows(*self._rows):
            return _lost("the frame is a band without the target's rows")
        rows = frame.rows(*self._rows)
        texture = _texture(rows)
        if texture < self._settings.least_texture:
            return _lost(f"featureless: the texture of the target's rows is {texture:.1f} grey levels")
        changes = self._changes(_mean_row(rows))
        most = int(changes.argmax())
        if changes[most] < self._settings.least_change:
            return TrackerResult(state=TrackingState.TRACKING, confidence=1.0)
        first, beyond = (n * self._shape[1] // self._settings.regions for n in (most, most + 1))
        stands_out = 1 - float(np.median(changes) / changes[most])
        return TrackerResult(
            state=TrackingState.TRACKING,
            bearing_rad=frame.camera.bearing_rad((first + beyond - 1) / 2),
            confidence=max(stands_out, 0.001),
            box=Box(first, self._rows[0], beyond - first, self._rows[1] - self._rows[0]),
        )

    def wanted_rows(self) -> tuple[int, int] | None:
        """See `base.WantsRows`: always the same."""
        return None if self._profile is None else self._rows

    def close(self) -> None:
        """Let go of what was learned."""
        self._profile = None

    def _changes(self, profile: np.ndarray) -> np.ndarray:
        """How much each region differs from the learned view, in grey levels of that view's light; shape (regions,)."""
        assert self._profile is not None
        lit = _in_the_light_of(profile, self._profile)
        return np.abs(self._transform(lit) - self._transform(self._profile)).mean((1, 2))

    def _transform(self, profile: np.ndarray) -> np.ndarray:
        out = np.empty((self._settings.regions, len(self._z), 2))
        transform_regions(profile, self._settings.regions, self._z, out)
        return out


def _mean_row(rows: np.ndarray) -> np.ndarray:
    return cv2.reduce(rows, 0, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel() / len(rows)


def _texture(rows: np.ndarray) -> float:
    return texture_of(rows, max(1, min(rows.shape[1] // 32, len(rows) // 3)))


def _in_the_light_of(profile: np.ndarray, learned: np.ndarray) -> np.ndarray:
    """The profile at the gain and offset that suit the half of it which has changed least (least trimmed squares).

    Begun from the quartiles, which a thing that moves leaves nearly alone.
    """
    low, middle, high = np.percentile(profile, (25, 50, 75))
    learned_low, learned_middle, learned_high = np.percentile(learned, (25, 50, 75))
    gain = (learned_high - learned_low) / (high - low) if high - low > 1 else 1.0
    lit = (profile - middle) * gain + learned_middle
    for _ in range(3):
        off = np.abs(lit - learned)
        kept = off <= np.median(off)
        now, then = profile[kept], learned[kept]
        spread = ((now - now.mean()) ** 2).mean()
        gain = ((now - now.mean()) * (then - then.mean())).mean() / spread if spread > 1 else 1.0
        lit = (profile - now.mean()) * (gain if gain > 0 else 1.0) + then.mean()
    return lit


def _lost(reason: str) -> TrackerResult:
    return TrackerResult(state=TrackingState.LOST, reason=reason)
