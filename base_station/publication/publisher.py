"""Publishes each picture and, more seldom, the station's state: from the loop's thread, which it never keeps waiting.

Sockets hold one message for each listener and drop what they cannot get rid of: a console that is slow, stopped or
gone costs the loop nothing.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import TypeVar

import zmq

from base_station.publication.schema import MAP, STATE, Addresses, encode
from base_station.publication.states import StateMaker, map_of
from base_station.station import Step
from base_station.trackers.base import Maps, MapView, Shown, Shows, SignatureView, Signs, Tracker

STATE_PERIOD_S = 0.1
MAP_PERIOD_S = 0.5

T = TypeVar("T")


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
        self._mute: Tracker | None = None
        self._last: tuple[Step, Shown | None] | None = None
        self._signature: SignatureView | None = None
        self._state_s = self._map_s = float("-inf")

    def step(self, step: Step) -> None:
        """A frame was dealt with, just now."""
        maker, tracker = self._maker, self._tracker()
        maker.note_step(step)
        shown = self._ask(tracker, Shown, tracker.show) if isinstance(tracker, Shows) else None
        self._last = step, shown
        self._publish_picture(step, shown)
        if self._state_is_due():  # a signature takes as long as tracking does: it is not asked for with each picture
            self._signature = self._signature_of(tracker)
            self._publish_state()
        self._publish_map(tracker, step.tracker)

    def wait(self) -> None:
        """No frame came."""
        self._maker.note_wait()
        if self._state_is_due():
            self._publish_state()

    def hold(self) -> None:
        """No frame comes any more: the last one is shown again, for pages that are opened late."""
        self._maker.over = True
        if self._last is not None:
            self._publish_picture(*self._last)
        self._publish_state()

    def close(self) -> None:
        self._pictures.close()
        self._states.close()

    def _publish_picture(self, step: Step, shown: Shown | None) -> None:
        with contextlib.suppress(zmq.Again):
            self._pictures.send(encode(self._maker.head(step, shown)), zmq.SNDMORE | zmq.DONTWAIT)
            self._pictures.send(step.frame.image.data, zmq.DONTWAIT, copy=False)

    def _state_is_due(self) -> bool:
        return time.monotonic() - self._state_s >= STATE_PERIOD_S

    def _publish_state(self) -> None:
        self._state_s = time.monotonic()
        self._send(STATE + encode(self._maker.state(self._signature)))

    def _signature_of(self, tracker: Tracker | None) -> SignatureView | None:
        return self._ask(tracker, SignatureView, tracker.show_signature) if isinstance(tracker, Signs) else None

    def _publish_map(self, tracker: Tracker | None, name: str) -> None:
        now_s = time.monotonic()
        if now_s - self._map_s < MAP_PERIOD_S or not isinstance(tracker, Maps):
            return
        self._map_s = now_s
        view = self._ask(tracker, MapView, tracker.show_map)
        self._send(MAP + encode(map_of(view, name)))

    def _ask(self, tracker: Tracker, kind: type[T], show: Callable[[], object]) -> T | None:
        """What the tracker shows. A user's own may fail here, or mean something else by the name: it is not asked
        again, and the robot goes on."""
        if tracker is self._mute:
            return None
        try:
            shown = show()
            if shown is None or isinstance(shown, kind):
                return shown
            wrong = f"{type(shown).__name__}, not {kind.__name__}"
        except Exception as error:
            wrong = f"{type(error).__name__}: {error}"
        self._mute = tracker
        self._maker.notice(f"{type(tracker).__name__} cannot show itself ({wrong})")
        return None

    def _send(self, message: bytes) -> None:
        with contextlib.suppress(zmq.Again):
            self._states.send(message, zmq.DONTWAIT)


def _socket(context: zmq.Context[zmq.Socket[bytes]], address: str, most: int) -> zmq.Socket[bytes]:
    socket = context.socket(zmq.PUB)
    socket.linger, socket.sndhwm = 0, most
    socket.bind(address)
    return socket
