"""Publishes each picture and, more seldom, the station's state: from the loop's thread, which it never keeps waiting.

Sockets hold one message for each listener and drop what they cannot get rid of: a console that is slow, stopped or
gone costs the loop nothing.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

import zmq

from base_station.publication.schema import MAP, STATE, Addresses, encode
from base_station.publication.states import StateMaker, map_of
from base_station.station import Step
from base_station.trackers.base import Maps, Shown, Shows, Tracker

STATE_PERIOD_S = 0.1
MAP_PERIOD_S = 0.5


class Publisher:
    """`tracker`: the one that steers now, asked in the loop's thread; it may have something to show."""

    def __init__(
        self,
        context: zmq.Context[zmq.Socket[bytes]],
        addresses: Addresses,
        maker: StateMaker,
        tracker: Callable[[], Tracker | None] = lambda: None,
    ) -> None:
        self._maker, self._tracker = maker, tracker
        self._pictures = _socket(context, addresses.pictures, 1)
        self._states = _socket(context, addresses.state, 4)
        self._state_s = self._map_s = float("-inf")

    def step(self, step: Step) -> None:
        """A frame was dealt with, just now."""
        maker, tracker = self._maker, self._tracker()
        maker.note_step(step)
        shown = tracker.show() if isinstance(tracker, Shows) else None
        with contextlib.suppress(zmq.Again):
            self._pictures.send(encode(maker.head(step, shown)), zmq.SNDMORE | zmq.DONTWAIT)
            self._pictures.send(step.frame.image.data, zmq.DONTWAIT, copy=False)
        self._publish_state(shown)
        self._publish_map(tracker)

    def wait(self) -> None:
        """No frame came."""
        self._maker.note_wait()
        self._publish_state(None)

    def close(self) -> None:
        self._pictures.close()
        self._states.close()

    def _publish_state(self, shown: Shown | None) -> None:
        now_s = time.monotonic()
        if now_s - self._state_s >= STATE_PERIOD_S:
            self._state_s = now_s
            self._send(STATE + encode(self._maker.state(shown)))

    def _publish_map(self, tracker: Tracker | None) -> None:
        now_s = time.monotonic()
        if now_s - self._map_s < MAP_PERIOD_S or not isinstance(tracker, Maps):
            return
        self._map_s = now_s
        view = tracker.show_map()
        if view is not None:
            self._send(MAP + encode(map_of(view)))

    def _send(self, message: bytes) -> None:
        with contextlib.suppress(zmq.Again):
            self._states.send(message, zmq.DONTWAIT)


def _socket(context: zmq.Context[zmq.Socket[bytes]], address: str, most: int) -> zmq.Socket[bytes]:
    socket = context.socket(zmq.PUB)
    socket.linger, socket.sndhwm = 0, most
    socket.bind(address)
    return socket
