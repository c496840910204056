"""Brings requests to the robot's control port beside the loop, which has no time for a round trip.

The newest request counts: one that has not left yet when the next one comes is dropped.
"""

from __future__ import annotations

import logging
import threading

from base_station.sockets import ControlLine, LinkLost
from protocol import ProtocolError, Request

log = logging.getLogger(__name__)


class Courier:
    """A thread that asks one kind of thing on a line of its own. `complain_at`: the logging level at which a request
    that fails is told; the same complaint is told once in a row."""

    def __init__(self, line: ControlLine, *, complain_at: int = logging.WARNING) -> None:
        self._line, self._level = line, complain_at
        self._changed = threading.Condition()
        self._request: Request | None = None
        self._asking = False
        self._closing = False
        self._complaint = ""
        self._thread = threading.Thread(target=self._run, name="courier", daemon=True)
        self._thread.start()

    def send(self, request: Request) -> None:
        """Ask this next. Returns at once."""
        with self._changed:
            self._request = request
            self._changed.notify_all()

    def settle(self, timeout_s: float) -> bool:
        """Wait until the robot has answered the newest request, or was given up. Whether that was in time."""
        with self._changed:
            return self._changed.wait_for(lambda: self._request is None and not self._asking, timeout_s)

    def close(self) -> None:
        """End the thread, once the robot has answered what it was asked; what has not left yet is dropped."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        while (request := self._next()) is not None:
            self._ask(request)
            with self._changed:
                self._asking = False
                self._changed.notify_all()
        self._line.close()

    def _next(self) -> Request | None:
        """None: it is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._request is not None or self._closing)
            request, self._request = self._request, None
            self._asking = request is not None
            return None if self._closing else request

    def _ask(self, request: Request) -> None:
        try:
            reply = self._line.ask(request)
            complaint = "" if reply.ok else f"the robot refuses to {request.action}: {reply.error}"
        except (LinkLost, ProtocolError) as error:
            complaint = f"the robot cannot be asked to {request.action}: {error}"
        if complaint and complaint != self._complaint:
            log.log(self._level, "%s", complaint)
        self._complaint = complaint
