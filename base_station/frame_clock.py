"""When a frame was taken: capture times from telemetry brought to the station's clock, or arrival times without them.

The raw stream has no times. Telemetry numbers the frames of a connection and gives each one's capture time on the
agent's clock; the smallest delay seen between capture and arrival is taken as the offset of the two clocks. A frame
whose telemetry is late was as long on its way as the one before.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque

FrameKey = tuple[str, int]
KEPT = 256
OFFSET_WINDOW = 300
"""Frames whose smallest delay sets the offset: ten seconds, in which two quartz clocks part by well below 1 ms."""
SLOWEST_PACE = 0.5
"""Where a quicker frame shows that the times so far were late, those that follow catch up at this pace, and do not
stand still: no two frames of a camera were taken at one time."""


class FrameClock:
    """Times of frames, each known by its key (connection, number). `note` and `time_s` may be called from two threads.

    One clock lasts as long as the link: it goes forward through all connections, whatever the agents' clocks show.
    """

    def __init__(self) -> None:
        self._captures: OrderedDict[FrameKey, float] = OrderedDict()
        self._noted = threading.Condition()
        self._delays: deque[float] = deque(maxlen=OFFSET_WINDOW)
        self._connection: str | None = None
        self._stepped_period_s: float | None = None
        self._wait_s = 0.0
        self._offset_s = 0.0
        self._last_s = float("-inf")
        self._last_capture_s = float("inf")

    def note(self, key: FrameKey, capture_s: float) -> None:
        """Telemetry says that this frame was taken at `capture_s`, on the agent's clock."""
        with self._noted:
            self._captures[key] = capture_s
            while len(self._captures) > KEPT:
                self._captures.popitem(last=False)
            self._noted.notify_all()

    def begin(self, *, stepped_period_s: float | None = None, wait_s: float = 0.0) -> None:
        """A new connection. In lockstep the agent's own times are used as they are, and are worth `wait_s` of waiting;
        a frame without one is a `stepped_period_s` after the one before."""
        self._delays.clear()
        self._last_capture_s = float("inf")
        self._stepped_period_s, self._wait_s = stepped_period_s, wait_s

    def time_s(self, key: FrameKey, arrival_s: float) -> float:
        """The time of this frame, never before that of the frame asked for before."""
        with self._noted:
            if self._wait_s:
                self._noted.wait_for(lambda: key in self._captures, self._wait_s)
            capture_s = self._captures.get(key)
        if self._stepped_period_s is not None:
            time_s = self._stepped_s(key[0], capture_s, self._stepped_period_s)
        elif capture_s is None and not self._delays:
            time_s = arrival_s
        else:
            time_s = self._paced_s(capture_s, arrival_s)
        self._last_s = max(self._last_s, time_s)
        return self._last_s

    def _paced_s(self, capture_s: float | None, arrival_s: float) -> float:
        if capture_s is None:
            capture_s = arrival_s - self._delays[-1]
        else:
            self._delays.append(arrival_s - capture_s)
        least_s = self._last_s + SLOWEST_PACE * max(capture_s - self._last_capture_s, 0.0)
        self._last_capture_s = capture_s
        return max(capture_s + min(self._delays), least_s)

    def _stepped_s(self, connection: str, capture_s: float | None, period_s: float) -> float:
        following_s = self._last_s + period_s if self._last_s > float("-inf") else 0.0
        if capture_s is None:
            return following_s
        if connection != self._connection:
            # The first connection keeps the agent's times; a later one goes on where the one before stopped.
            self._offset_s = max(0.0, following_s - capture_s) if self._connection is not None else 0.0
            self._connection = connection
        return capture_s + self._offset_s
