"""The values that pass between link, trackers and behaviours: frames, boxes, results."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from base_station.geometry import PinholeCamera


@dataclass(frozen=True, kw_only=True)
class Frame:
    """One picture from the robot. `image`: uint8, shape (height, width), gray, not to be written to.

    It may be a band of rows: its row r is then row `first_row` + r of the whole frame. `camera`, boxes and results are
    always those of whole frames. Trackers get bands only if they asked for them (`trackers.base.WantsRows`).

    `number` counts the frames of this connection from 1; some may be missing between two updates. `time_s` is when the
    picture was taken, on a clock that only goes forward (its zero means nothing).
    """

    image: np.ndarray
    number: int
    time_s: float
    camera: PinholeCamera
    connection: str = ""
    """Which connection to the robot: the station's own end of it. Numbers begin anew with each."""
    first_row: int = 0
    full_height: int = 0
    """Of the whole frame; 0: the image is whole."""
    stepped: bool = False
    """Lockstep: the robot's time stands until this frame is answered, so who needs time may take it."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the whole frame."""
        return self.full_height or self.image.shape[0], self.image.shape[1]

    @property
    def is_whole(self) -> bool:
        """It is no band."""
        return self.image.shape == self.shape

    def has_rows(self, first: int, past_last: int) -> bool:
        """Whether the image shows these rows of the whole frame (what sticks out of it does not count)."""
        end = self.first_row + self.image.shape[0]
        return self.first_row <= max(first, 0) and min(past_last, self.shape[0]) <= end

    def rows(self, first: int, past_last: int) -> np.ndarray:
        """Of these rows of the whole frame those that the image has; a view of it."""
        return self.image[max(first - self.first_row, 0) : max(past_last - self.first_row, 0)]


@dataclass(frozen=True, slots=True)
class Box:
    """An upright rectangle of pixels: column and row of its first pixel, its size. May stick out of the frame.

    Pixel centres are at integer coordinates (as OpenCV has it), so the middle of the box lies at x + (width - 1) / 2.

    Raises ValueError unless width and height are positive and all four are finite.
    """

    x: float
    y: float
    width: float
    height: float

    def __post_init__(self) -> None:
        is_finite = math.isfinite(self.x + self.y + self.width + self.height)  # one call: this is in every frame's path
        if not is_finite or self.width <= 0 or self.height <= 0:
            sides = f"{self.x},{self.y},{self.width},{self.height}"
            raise ValueError(f"not a box: {sides} (x,y,width,height, both sides > 0)")

    @property
    def center_px(self) -> tuple[float, float]:
        """x, y of the middle."""
        return self.x + (self.width - 1) / 2, self.y + (self.height - 1) / 2

    @classmethod
    def around(cls, x: float, y: float, width: float, height: float) -> Box:
        """The box with this centre and size."""
        return cls(x - (width - 1) / 2, y - (height - 1) / 2, width, height)

    def with_rows(self, most: int) -> Box:
        """The box, or where it is higher than so many rows, its middle."""
        return Box.around(*self.center_px, self.width, min(self.height, most))

    def clipped(self, width: int, height: int) -> Box | None:
        """The part of it inside a frame of this size, or None."""
        left, top = max(self.x, 0.0), max(self.y, 0.0)
        right, bottom = min(self.x + self.width, float(width)), min(self.y + self.height, float(height))
        return Box(left, top, right - left, bottom - top) if right > left and bottom > top else None


class TrackingState(Enum):
    """INITIALIZING: nothing learned yet, or not enough seen. TRACKING: the target is seen. LOST: it is not."""

    INITIALIZING = "INITIALIZING"
    TRACKING = "TRACKING"
    LOST = "LOST"


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackerResult:
    """What a tracker says about one frame. Measurements are there in state TRACKING only: never a stale value.

    What a tracker cannot tell is None, also when TRACKING.
    Raises ValueError when a state other than TRACKING carries a measurement, or one is not finite: the robot would
    turn at full speed towards it.
    """

    state: TrackingState
    reason: str = ""
    """In words, why not TRACKING; empty when TRACKING."""
    shift_px: float | None = None
    """Horizontal displacement of the target's centre since it was learned, to the right positive."""
    shift_y_px: float | None = None
    """Vertical displacement, downwards positive."""
    bearing_rad: float | None = None
    """Direction of the target's centre from the optical axis, to the left positive (counter-clockwise from above).
    For a learned view (no box): the direction of the learned heading."""
    elevation_rad: float | None = None
    """The same in the vertical, upwards positive."""
    zoom: float | None = None
    """Apparent size against the learned one: > 1 is nearer. Depth along the optical axis is the learned one / zoom."""
    view_angle_rad: float | None = None
    """By how much the line of sight to the target has turned about the vertical since it was learned, seen from the
    target; positive counter-clockwise from above, that is when the camera stands to the right of where it stood. The
    camera's heading has turned by this less the change of bearing."""
    range_m: float | None = None
    """Distance from the camera to the target's centre. The station fills it in where it knows the scale."""
    confidence: float = 0.0
    """0..1."""
    box: Box | None = None
    """The target's outline in this frame."""
    cam_from_world: np.ndarray | None = None
    """4x4, for trackers that know a pose."""
    compass_rad: float | None = None
    """Direction, from the optical axis of now, of what was straight ahead when the target was learned; left positive,
    -pi..pi. By a compass that keeps it without seeing the target: the one number that is there in any state."""

    def __post_init__(self) -> None:
        if self.state is not TrackingState.TRACKING:
            self._check_empty()
        total = 0.0  # of numbers of which one is not finite, neither is the sum; one check is quicker than eight
        for value in (
            self.shift_px, self.shift_y_px, self.bearing_rad, self.elevation_rad, self.zoom, self.view_angle_rad,
            self.range_m, self.compass_rad,
        ):  # fmt: skip
            if value is not None:
                total += value
        if not math.isfinite(total):
            self._check_finite()
        if self.zoom is not None and self.zoom <= 0:
            raise ValueError(f"a result's zoom is {self.zoom}, it must be positive")

    def _check_finite(self) -> None:
        for name in (
            "shift_px", "shift_y_px", "bearing_rad", "elevation_rad", "zoom", "view_angle_rad", "range_m", "compass_rad"
        ):  # fmt: skip
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise ValueError(f"a result's {name} is {value}")

    def _check_empty(self) -> None:
        measured = (
            self.shift_px,
            self.shift_y_px,
            self.bearing_rad,
            self.elevation_rad,
            self.zoom,
            self.view_angle_rad,
            self.range_m,
            self.box,
            self.cam_from_world,
        )
        if any(value is not None for value in measured):
            raise ValueError(f"a result in state {self.state.value} carries a measurement")
        if not self.reason:
            raise ValueError(f"a result in state {self.state.value} must give its reason")
