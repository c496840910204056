"""Takes wishes at one socket, in a thread of its own: reads, hands over, answers."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

import zmq

from base_station.errors import StationError
from base_station.publication.schema import Answer, Wish, encode
from protocol import ProtocolError
from protocol.records import from_bytes

log = logging.getLogger(__name__)

LARGEST_WISH_BYTES = 8192
TICK_MS = 200


class Desk:
    """`serve` does what is wished and returns what went wrong, in words; `tick` is called now and then."""

    def __init__(
        self,
        context: zmq.Context[zmq.Socket[bytes]],
        address: str,
        serve: Callable[[Wish], str],
        *,
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        self._serve, self._tick = serve, tick
        self._socket = context.socket(zmq.REP)
        self._socket.linger = 0
        self._socket.maxmsgsize = LARGEST_WISH_BYTES
        self._socket.bind(address)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="desk", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """After what is being done now."""
        self._closing.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            if self._socket.poll(TICK_MS):
                data = b"".join(self._socket.recv_multipart())
                self._socket.send(encode(Answer(error=self._answer(data))))
            self._tick()

    def _answer(self, data: bytes) -> str:
        try:
            return self._serve(from_bytes(Wish, data))
        except (ProtocolError, ValueError, StationError) as error:
            return str(error)
        except Exception as error:  # whatever it was, the next wish (an emergency stop) must be served
            log.exception("an order could not be served")
            return f"it failed ({type(error).__name__}: {error})"
