"""Where the robot has driven, by what its wheels measured: dead reckoning of a robot with two driven wheels.

Telemetry tells both wheels' speed some ten or more times a second; in between they are taken to have changed evenly.
Wheels slip, and every error of the heading stays: on a good floor this is good to some centimetres over ten metres.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict

from base_station.frame_clock import KEPT, FrameKey
from base_station.geometry import FlatPose
from protocol import RobotLimits, Telemetry

LONGEST_GAP_S = 1.0
"""Messages further apart than this leave out what happened between them."""


class WheelOdometry:
    """The pose since the first message, frame by frame. May be used from two threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: OrderedDict[FrameKey, FlatPose] = OrderedDict()
        self._pose = FlatPose(x_m=0.0, y_m=0.0, heading_rad=0.0)
        self._last: tuple[float, float, float] | None = None
        """Time in s, left and right in m/s."""

    def note(self, telemetry: Telemetry, limits: RobotLimits) -> None:
        """A message came. Robots that measure no speed have no odometry."""
        if telemetry.wheels_measured is None:
            return
        left, right = (units * limits.metres_per_unit_s for units in telemetry.wheels_measured)
        with self._lock:
            if self._last is not None:
                before_s, before_left, before_right = self._last
                step_s = telemetry.monotonic_s - before_s
                if 0.0 < step_s <= LONGEST_GAP_S:
                    way = (before_left + left) / 2 * step_s, (before_right + right) / 2 * step_s
                    self._pose = rolled(self._pose, *way, limits.wheel_base_m)
            self._last = telemetry.monotonic_s, left, right
            stamp = telemetry.frame
            if stamp is not None and telemetry.station is not None:
                self._known.setdefault((telemetry.station, stamp.number), self._pose)
                while len(self._known) > KEPT:
                    self._known.popitem(last=False)

    def of(self, key: FrameKey) -> FlatPose | None:
        """When this frame was sent; where its telemetry is late or lost, the newest. None: nothing is known."""
        with self._lock:
            return self._known.get(key, self._pose if self._last is not None else None)


def rolled(pose: FlatPose, left_m: float, right_m: float, wheel_base_m: float) -> FlatPose:
    """After the wheels have rolled so far: along the arc's chord."""
    turned_rad, ahead_m = (right_m - left_m) / wheel_base_m, (left_m + right_m) / 2
    half_rad = turned_rad / 2
    chord_m = ahead_m * (math.sin(half_rad) / half_rad if abs(half_rad) > 1e-9 else 1.0)
    way_rad = pose.heading_rad + half_rad
    return FlatPose(
        x_m=pose.x_m + chord_m * math.cos(way_rad),
        y_m=pose.y_m + chord_m * math.sin(way_rad),
        heading_rad=pose.heading_rad + turned_rad,
    )
