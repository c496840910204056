"""Algorithm 4.1 of the thesis, mended: the shift property of the Z-transform solved for the shift n0.

The row of a target is transformed about an anchor column, to the right and to the left. If the picture moves by n0
pixels, both transforms change by the shift property, eqs. (3.3) and (3.4): what they would become can be foretold from
the learned row for every n0. Which n0 foretells what is seen now? The same is done with a column, for up and down.

What it tells: a shift to a fraction of a pixel, hence bearing and elevation. What it does not: zoom. It looks from one
anchor only and no farther than `span_px` from where the target was last.

The thesis's z = 0.9 is `ZShiftSettings.thesis()`; why that fails on real frames is in the README, section 8.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.ztransform.texture import texture_of
from base_station.trackers.ztransform.thesis.kernels import fit_shift, predict_shifts, transform_about
from base_station.types import Box, Frame, TrackerResult, TrackingState

LARGEST_GROWTH = 1e12
"""Of |z|^span or its inverse: stepping by (3.4) multiplies the rounding errors by it."""
COLUMN_ROOM_PX = 48
"""Of a band of rows, above and below the target."""


def _spiral(*reaches_px: float) -> tuple[complex, ...]:
    return tuple(cmath.exp((1 + 2j) / reach) for reach in reaches_px)


@dataclass(frozen=True, kw_only=True)
class ZShiftSettings:
    """Where to look and when to believe. Raises ValueError for a z that `span_px` steps would blow up."""

    z: tuple[complex, ...] = _spiral(5.0, 10.0, 20.0, 40.0)
    """The transform is taken at each. |z| > 1 fades from the anchor outwards, over 1 / ln|z| px; the angle of a complex
    z carries phase, hence fractions of a pixel. The thesis: 0.9."""
    span_px: int = 100
    """The shifts that are tried, to either side of the last one."""
    rows: int | None = None
    """Rows about the target's middle that are averaged into one; None: all of the target's. The thesis: 1."""
    any_light: bool = True
    """Compare differences of neighbours, at any gain: blind to the light. False: grey levels as they are (thesis)."""
    vertical: bool = True
    """Solve for the shift of a column as well. The thesis: False, a row alone."""
    both_sides: bool = True
    """Look from the anchor to the left as well. The thesis: False, the right half of the row alone."""
    largest_residual: float = 0.45
    """What the best n0 leaves unexplained, 0..1; above it: LOST."""
    gains: tuple[float, float] = (0.15, 6.0)
    """Contrast against the learned one that is believed."""
    least_texture: float = 1.5
    """Grey levels; less is featureless."""
    smallest_side_px: int = 10
    """Of the target."""

    def __post_init__(self) -> None:
        if not self.z or not 1 <= self.span_px <= 1000:
            raise ValueError("z-shift needs at least one z, and a span of 1..1000 px")
        for z in self.z:
            size = abs(z)
            if not 0 < size < float("inf") or max(size, 1 / size) ** self.span_px > LARGEST_GROWTH:
                raise ValueError(f"z = {z}: rounding errors grow {size:.3g}^{self.span_px}-fold; take a smaller span")

    @classmethod
    def thesis(cls) -> ZShiftSettings:
        """As in listing A.3, apart from its slips: z = 0.9, one row, grey levels, shifts of 1..100 either way."""
        return cls(
            z=(0.9,), rows=1, any_light=False, vertical=False, both_sides=False, largest_residual=1.0,
            gains=(0.0, float("inf")),
        )  # fmt: skip


@dataclass(frozen=True)
class _Axis:
    """What is kept of a row (or column): the foretold transforms for every shift, from `first` on."""

    predicted: np.ndarray
    first: int


class ZShiftTracker:
    """See the module. Source: Khalil 2021, algorithm 4.1, eqs. (3.2) to (3.4)."""

    def __init__(self, *, settings: ZShiftSettings | None = None) -> None:
        self._settings = settings or ZShiftSettings()
        self._z = np.array(self._settings.z, np.complex128)
        self._axes: tuple[_Axis, _Axis] | None = None
        nothing = np.zeros(8)
        foretold = self._predict(nothing, 4).predicted  # compile (or load) the kernels now: no late first frame
        fit_shift(foretold, self._transform(nothing, 4), self._settings.any_light)

    def learn(self, frame: Frame, target: Box | None) -> None:
        """Foretell every shift of the target's row and column. Raises ValueError as `base.Tracker.learn` does."""
        settings, (height, width) = self._settings, frame.image.shape
        box = (target or Box(0, 0, width, height)).clipped(width, height)
        if box is None:
            raise ValueError("the box is outside of the frame")
        self._size = columns, rows = round(box.width), round(box.height)
        if min(columns, rows) < settings.smallest_side_px:
            raise ValueError(f"the target is too small: {columns}x{rows} px")
        left, top = round(box.x), round(box.y)
        texture = texture_of(frame.image[top : top + rows, left : left + columns], max(1, min(columns, rows) // 16))
        if texture < settings.least_texture:
            raise ValueError(f"featureless: the target's texture is {texture:.1f} grey levels")
        self._learned_at = self._last = np.array(box.center_px)
        self._shape, self._is_tracking = frame.shape, True
        self._rest = self._last - np.floor(self._last)  # by so much the middle lies beside a whole pixel
        x, y = _anchor(frame.image, self._last)
        row, column = (self._profile(frame.image, axis, self._last) for axis in (0, 1))
        self._axes = self._predict(row, x), self._predict(column, y)

    def update(self, frame: Frame) -> TrackerResult:
        """See `base.Tracker.update`."""
        if self._axes is None:
            return TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
        self._is_tracking = False
        if frame.shape != self._shape:
            now, then = frame.shape, self._shape
            return _lost(f"the frame is {now[1]}x{now[0]}, learned in {then[1]}x{then[0]}")
        settings, first_row = self._settings, np.array([0, frame.first_row])
        place, residuals = self._last - first_row, [0.0, 0.0]
        for axis in (0, 1, 0) if settings.vertical else (0,):  # the row again, at the height that was found
            profile, anchor = self._profile(frame.image, axis, place), _anchor(frame.image, place)[axis]
            seen = self._transform(profile, anchor)
            index, residuals[axis], gain = fit_shift(self._axes[axis].predicted, seen, settings.any_light)
            if not settings.gains[0] <= gain <= settings.gains[1]:
                return _lost(f"featureless, or not the target: contrast {gain:.2g} times the learned one")
            place[axis] = anchor + self._rest[axis] + self._axes[axis].first + index
        worst = max(residuals)
        if worst > settings.largest_residual:
            return _lost(f"the target is hidden or gone: no shift explains the view (residual {worst:.2f})")
        place += first_row
        if not all(0 <= place[axis] <= self._shape[1 - axis] - 1 for axis in (0, 1)):
            return _lost("the target left the frame")
        self._last, self._is_tracking = place, True
        x, y = float(place[0]), float(place[1])
        return TrackerResult(
            state=TrackingState.TRACKING,
            shift_px=x - float(self._learned_at[0]),
            shift_y_px=y - float(self._learned_at[1]) if settings.vertical else None,
            bearing_rad=frame.camera.bearing_rad(x),
            elevation_rad=frame.camera.elevation_rad(y) if settings.vertical else None,
            confidence=min(max(1 - worst, 0.001), 1.0),
            box=Box.around(x, y, *self._size),
        )

    def wanted_rows(self) -> tuple[int, int] | None:
        """See `base.WantsRows`: the target's, and some around it for the column's transforms. All when lost."""
        if self._axes is None or not self._is_tracking:
            return None
        middle, half = float(self._last[1]), (self._settings.rows or self._size[1]) / 2
        reach = half + (COLUMN_ROOM_PX if self._settings.vertical else 1)
        return math.floor(middle - reach), math.ceil(middle + reach) + 1

    def close(self) -> None:
        """Let go of what was learned."""
        self._axes = None

    @property
    def landmark_bytes(self) -> int:
        """What must be kept to find it again: the row and the column, four bytes a pixel."""
        return 4 * sum(self._shape) if self._axes is not None else 0

    def _profile(self, image: np.ndarray, axis: int, place: np.ndarray) -> np.ndarray:
        """Axis 0: the mean row of the band about the place, axis 1: the mean column; float64, as long as the frame."""
        side = self._settings.rows or self._size[1 - axis]
        length = image.shape[axis]
        first = min(max(round(place[1 - axis] - (side - 1) / 2), 0), length - 1)
        beyond = min(first + side, length)
        band = image[first:beyond] if axis == 0 else image[:, first:beyond]
        profile = cv2.reduce(band, axis, cv2.REDUCE_SUM, dtype=cv2.CV_32S).ravel() / (beyond - first)
        if self._settings.any_light:
            profile[1:-1] = (profile[2:] - profile[:-2]) / 2
            profile[0] = profile[-1] = 0
        return profile

    def _predict(self, profile: np.ndarray, anchor: int) -> _Axis:
        """The part of -span..span for which the anchor stays in the frame."""
        span = min(self._settings.span_px, anchor, len(profile) - 1 - anchor)
        predicted = np.empty((2 * span + 1, len(self._z), 2), np.complex128)
        predict_shifts(profile, anchor, self._z, span, predicted)
        return _Axis(self._weighed(predicted).reshape(2 * span + 1, -1), -span)

    def _transform(self, profile: np.ndarray, anchor: int) -> np.ndarray:
        out = np.empty((len(self._z), 2), np.complex128)
        transform_about(profile, anchor, self._z, out)
        return self._weighed(out).ravel()

    def _weighed(self, transforms: np.ndarray) -> np.ndarray:
        """The sides asked for, (..., zs, sides); a window that reaches far gathers more, and would drown the others."""
        weights = np.sqrt(np.maximum(np.abs(1 - np.abs(self._z) ** -2.0), 1e-3))
        return transforms[..., : 2 if self._settings.both_sides else 1] * weights[:, None]


def _anchor(image: np.ndarray, place: np.ndarray) -> tuple[int, int]:
    """Column and row, whole and in the image, from which to look for what is about there."""
    x, y = np.floor(place)
    return int(min(max(x, 0), image.shape[1] - 1)), int(min(max(y, 0), image.shape[0] - 1))


def _lost(reason: str) -> TrackerResult:
    return TrackerResult(state=TrackingState.LOST, reason=reason)
