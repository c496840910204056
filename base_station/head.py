"""The robot's camera on its pan-tilt, as the station has it: where it looked in a frame, where it is to look."""

from __future__ import annotations

import threading
from collections import OrderedDict

from base_station.courier import Courier
from base_station.frame_clock import KEPT, FrameKey
from base_station.sockets import ControlLine
from protocol import FrameStamp, PanTiltLimits, Request

FAREWELL_S = 0.5
Angles = tuple[float, float]
"""Pan and tilt, rad."""


class HeadAngles:
    """Where the camera looked, frame by frame, as telemetry told. May be used from two threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: OrderedDict[FrameKey, Angles] = OrderedDict()

    def note(self, station: str, stamp: FrameStamp) -> None:
        """A frame's stamp came."""
        if stamp.pan_rad is None or stamp.tilt_rad is None:
            return
        with self._lock:
            self._known[station, stamp.number] = stamp.pan_rad, stamp.tilt_rad
            while len(self._known) > KEPT:
                self._known.popitem(last=False)

    def of(self, key: FrameKey) -> Angles | None:
        """Of this frame; where its telemetry is late or lost, of the newest one of its connection. None: not known, or
        the camera is fixed."""
        with self._lock:
            if key in self._known:
                return self._known[key]
            return next((self._known[known] for known in reversed(self._known) if known[0] == key[0]), None)


class PanHead:
    """Turns the camera. Implements behaviours.base.Head; `close` centres it."""

    def __init__(self, limits: PanTiltLimits, line: ControlLine) -> None:
        self.limits = limits
        self.pan_rad = 0.0
        """Where the camera looked in the frame that is dealt with."""
        self._courier = Courier(line)

    def look(self, pan_rad: float, tilt_rad: float = 0.0) -> None:
        """Turn there, cut to the limits; the newest goal wins. Returns at once."""
        pan_rad, tilt_rad = self.limits.clamped(pan_rad, tilt_rad)
        self._courier.send(Request(action="look", pan_rad=pan_rad, tilt_rad=tilt_rad))

    def settle(self, timeout_s: float) -> bool:
        """Wait until the robot has taken the newest goal (or refused it). For lockstep, where time stands meanwhile."""
        return self._courier.settle(timeout_s)

    def close(self) -> None:
        """Ask for the centre, and let go."""
        self.look(0.0)
        self.settle(FAREWELL_S)
        self._courier.close()
