"""The robot's camera on its pan-tilt, as the station has it: where it looked in a frame, where it is to look.

A request and its reply take a round trip, which the loop has no time for: a thread asks, and only for the newest goal.
"""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict

from base_station.frame_clock import KEPT, FrameKey
from base_station.sockets import ControlLine, LinkLost
from protocol import FrameStamp, PanTiltLimits, ProtocolError, Request

log = logging.getLogger(__name__)

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
        self._line = line
        self._changed = threading.Condition()
        self._goal: Angles | None = None
        self._asking = False
        self._closing = False
        self._complaint = ""
        self._thread = threading.Thread(target=self._run, name="head", daemon=True)
        self._thread.start()

    def look(self, pan_rad: float, tilt_rad: float = 0.0) -> None:
        """Turn there, cut to the limits; the newest goal wins. Returns at once."""
        with self._changed:
            self._goal = self.limits.clamped(pan_rad, tilt_rad)
            self._changed.notify_all()

    def settle(self, timeout_s: float) -> bool:
        """Wait until the robot has taken the newest goal (or refused it). For lockstep, where time stands meanwhile."""
        with self._changed:
            return self._changed.wait_for(lambda: self._goal is None and not self._asking, timeout_s)

    def close(self) -> None:
        """Ask for the centre, and let go."""
        self.look(0.0)
        self.settle(FAREWELL_S)
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._goal is not None or self._closing)
                goal, self._goal = self._goal, None
                if goal is None or self._closing:
                    break
                self._asking = True
            self._ask(*goal)
            with self._changed:
                self._asking = False
                self._changed.notify_all()
        self._line.close()

    def _ask(self, pan_rad: float, tilt_rad: float) -> None:
        try:
            reply = self._line.ask(Request(action="look", pan_rad=pan_rad, tilt_rad=tilt_rad))
            complaint = "" if reply.ok else f"the robot does not turn its camera: {reply.error}"
        except (LinkLost, ProtocolError) as error:
            complaint = f"the camera cannot be turned: {error}"
        if complaint and complaint != self._complaint:
            log.warning("%s", complaint)
        self._complaint = complaint
