"""When a frame was taken: capture times from telemetry brought to the station's clock, or arrival times without them.

The raw stream has no times. Telemetry numbers the frames of a connection and gives each one's capture time on the
agent's clock; the smallest delay seen between capture and arrival is taken as the offset of the two clocks.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque

FrameKey = tuple[str, int]
KEPT = 256
OFFSET_WINDOW = 300
"""Frames whose smallest delay sets the offset: ten seconds, in which two quartz clocks part by well below 1 ms."""


class FrameClock:
    """Times of frames, each known by its key (connection, number). `note` and `time_s` may be called from two threads.

    `stepped`: the peer goes in lockstep, where the agent's own times are used as they are and are worth waiting for.
    """

    def __init__(self, *, stepped: bool = False, wait_s: float = 0.0) -> None:
        self.uses_capture_times = False
        """Whether the newest time came from telemetry."""
        self._stepped, self._wait_s = stepped, wait_s
        self._captures: OrderedDict[FrameKey, float] = OrderedDict()
        self._delays: deque[float] = deque(maxlen=OFFSET_WINDOW)
        self._noted = threading.Condition()
        self._last_s = float("-inf")

    def note(self, key: FrameKey, capture_s: float) -> None:
        """Telemetry says that this frame was taken at `capture_s`, on the agent's clock."""
        with self._noted:
            self._captures[key] = capture_s
            while len(self._captures) > KEPT:
                self._captures.popitem(last=False)
            self._noted.notify_all()

    def time_s(self, key: FrameKey, arrival_s: float) -> float:
        """The time of this frame, never before that of the frame asked for before."""
        with self._noted:
            if self._wait_s:
                self._noted.wait_for(lambda: key in self._captures, self._wait_s)
            capture_s = self._captures.get(key)
        self.uses_capture_times = capture_s is not None
        if capture_s is None:
            time_s = arrival_s
        elif self._stepped:
            time_s = capture_s
        else:
            self._delays.append(arrival_s - capture_s)
            time_s = capture_s + min(self._delays)
        self._last_s = max(self._last_s, time_s)
        return self._last_s
