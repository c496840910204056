"""The console's side of what a station publishes: a thread that keeps the newest of all, and the last minute.

Pictures become JPEG here, once for all pages, as wide as the widest shows them, and only while somebody looks.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import struct
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import cv2
import numpy as np
import zmq

from base_station.publication.schema import MAP, STATE, Addresses, Head, Map, State
from protocol import ProtocolError
from protocol.records import from_bytes

JPEG_QUALITY = 82
LOOKED_AT_S = 2.0
"""After the last page asked for a picture, so long more are encoded."""
WHOLE = 1 << 20
"""Wider than any picture."""
SILENT_S = 1.5
"""A station tells its state ten times a second."""
HISTORY_S, HISTORY_PERIOD_S = 60.0, 0.2
EMERGENCY = "emergency stop"
"""How the reason of a robot that is latched begins."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One moment of the last minute."""

    time_s: float
    shift_px: float | None
    zoom: float | None
    bearing_rad: float | None
    confidence: float | None


class Feed:
    """`start` it; the rest may be read from any thread, `picture` from the event loop.

    `first_look`: called once, when the first page asks for a picture.
    """

    def __init__(self, addresses: Addresses, first_look: Callable[[], None] = lambda: None) -> None:
        self._state: State | None = None
        self._state_s = float("-inf")
        self.map: Map | None = None
        self.map_number = 0
        """Counts the maps that came."""
        self.history: deque[Sample] = deque(maxlen=round(HISTORY_S / HISTORY_PERIOD_S))
        self.ended = False
        """The station has ended."""
        self._addresses, self._first_look = addresses, first_look
        self._packet: tuple[int, bytes] = (0, b"")
        self._asked_s = float("-inf")
        self._width, self._width_s = 0, float("-inf")
        """The largest that a page asked for, and when that was."""
        self._sampled_s = self._pictured_s = float("-inf")
        self._waiting: set[asyncio.Future[None]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="feed", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        self._thread.join()

    def end(self) -> None:
        """Say that the station has ended, and wake who waits."""
        self.ended = True
        self._announce()

    @property
    def state(self) -> State | None:
        """How the station stands, as it last said; one that has fallen silent is not known to stand well."""
        silent_s = time.monotonic() - self._state_s
        if self._state is None or silent_s < SILENT_S or self.ended:
            return self._state
        link = f"no news from the station for {silent_s:.0f} s"
        return replace(self._state, link=link, connected=False, telemetry=None, seen=None, shadow=None)

    async def picture(self, after: int, patience_s: float, width: int = 0) -> bytes:
        """A packet (see `packet`) with a picture numbered above `after`, as soon as there is one; without a picture
        when none came in time. `width`: how wide it will be shown, in px; 0: as wide as it is."""
        if self._asked_s == float("-inf"):
            self._first_look()
        self._note_look(width or WHOLE)
        self._loop = asyncio.get_running_loop()
        if self._packet[0] <= after and not self.ended:
            woken = self._loop.create_future()
            self._waiting.add(woken)
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(woken, patience_s)
            self._waiting.discard(woken)
        number, packed = self._packet
        fresh = number > after and time.monotonic() - self._pictured_s < LOOKED_AT_S
        return packed if fresh else packet(None, self.status(), b"")

    def _note_look(self, width: int) -> None:
        now_s = self._asked_s = time.monotonic()
        if width >= self._width or now_s - self._width_s > LOOKED_AT_S:
            self._width, self._width_s = width, now_s

    def status(self) -> dict[str, Any]:
        """What every page must know at once, whether or not there is a picture."""
        return status_of(self.state, self.ended)

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        cv2.setNumThreads(1)
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        pictures, states = _listening(context, self._addresses.pictures), _listening(context, self._addresses.state)
        poller = zmq.Poller()
        poller.register(pictures, zmq.POLLIN)
        poller.register(states, zmq.POLLIN)
        while not self._closing.is_set():
            ready = dict(poller.poll(200))
            with contextlib.suppress(ProtocolError):  # from a station of another age, perhaps: show what can be read
                if states in ready:
                    self._take_state(states.recv())
            with contextlib.suppress(ProtocolError):
                if pictures in ready:
                    self._take_picture(_newest(pictures))
        context.destroy(linger=0)

    def _take_state(self, message: bytes) -> None:
        kind, body = message[:1], message[1:]
        if kind == STATE:
            self._state, self._state_s = from_bytes(State, body), time.monotonic()
            if self.map is not None and self.map.tracker != self._state.tracker:
                self.map = None  # when that tracker comes back, its map is another one
            self._sample(self._state)
        elif kind == MAP:
            self.map = from_bytes(Map, body)
            self.map_number += 1

    def _sample(self, state: State) -> None:
        now_s = time.monotonic()
        if now_s - self._sampled_s < HISTORY_PERIOD_S or state.over:
            return
        self._sampled_s = now_s
        seen = state.seen
        self.history.append(
            Sample(
                time_s=time.time(),
                shift_px=seen.shift_px if seen else None,
                zoom=seen.zoom if seen else None,
                bearing_rad=seen.bearing_rad if seen else None,
                confidence=seen.confidence if seen else None,
            )
        )

    def _take_picture(self, parts: list[bytes]) -> None:
        if len(parts) != 2 or time.monotonic() - self._asked_s > LOOKED_AT_S:
            return
        head = from_bytes(Head, parts[0])
        if head.rows <= 0 or head.width <= 0 or head.rows * head.width != len(parts[1]):
            return
        image = np.frombuffer(parts[1], np.uint8).reshape(head.rows, head.width)
        good, coded = cv2.imencode(".jpg", reduced(image, self._width), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if good:
            self._packet = head.number, packet(head, self.status(), coded.tobytes())
            self._pictured_s = time.monotonic()
            self._announce()

    def _announce(self) -> None:
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the server is ending
                self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        for woken in self._waiting:
            if not woken.done():
                woken.set_result(None)
        self._waiting.clear()


def reduced(image: np.ndarray, width: int) -> np.ndarray:
    """No wider than it is shown: what the page would shrink is not encoded, sent and decoded first."""
    rows, columns = image.shape
    if not 0 < width < columns:
        return image
    how = cv2.INTER_LINEAR if 2 * width > columns else cv2.INTER_AREA  # the first is quick, and good enough so far
    return cv2.resize(image, (width, max(round(rows * width / columns), 1)), interpolation=how)


def packet(head: Head | None, status: dict[str, Any], jpeg: bytes) -> bytes:
    """What a page gets: the length of a JSON text as uint32, the text, the features' uint16 x and y, and the JPEG; all
    little endian. The text has "status", and with a picture "head", in which "features" counts them."""
    told: dict[str, Any] = {"status": status}
    features = b""
    if head is not None:
        fields = asdict(head)
        features = fields.pop("features")
        told["head"] = {**fields, "features": len(features) // 4}
    text = json.dumps(told, separators=(",", ":")).encode()
    return struct.pack("<I", len(text)) + text + features + jpeg


def status_of(state: State | None, ended: bool = False) -> dict[str, Any]:
    """Of the emergency stop, the link and the behaviour, in few words."""
    if state is None:
        return {"ended": ended, "link": "waiting for the station", "connected": False, "latched": False}
    telemetry = state.telemetry
    return {
        "ended": ended,
        "link": state.link,
        "connected": state.connected,
        "orders": state.orders,
        "controllable": state.controllable,
        "behaviour": state.behaviour,
        "safety": telemetry.safety if telemetry is not None else "",
        "reason": telemetry.reason if telemetry is not None else "",
        "latched": telemetry is not None and telemetry.reason.startswith(EMERGENCY),
    }


def _listening(context: zmq.Context[zmq.Socket[bytes]], address: str) -> zmq.Socket[bytes]:
    socket = context.socket(zmq.SUB)
    socket.linger, socket.rcvhwm = 0, 2
    socket.subscribe(b"")
    socket.connect(address)
    return socket


def _newest(socket: zmq.Socket[bytes]) -> list[bytes]:
    parts = socket.recv_multipart()
    while socket.poll(0):
        parts = socket.recv_multipart()
    return parts
