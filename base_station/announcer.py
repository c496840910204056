"""Tells the robot what the station sees, for its lights: only what changed, and never in the loop's time.

The loop leaves word and goes on; a thread asks the robot's control port. Where the robot is slower than the changes,
the newest word counts. A word that does not arrive is dropped: the lights are for people, nothing is steered by them.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from base_station.sockets import LinkLost
from protocol import ProtocolError, Reply, Request

log = logging.getLogger(__name__)


class Announcer:
    """`ask` puts a request to the robot and may wait for the reply. Use as a context manager."""

    def __init__(self, ask: Callable[[Request], Reply | None]) -> None:
        self._ask = ask
        self._said: tuple[str, str] | None = None
        self._news = threading.Condition()
        self._word: str | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="announcer", daemon=True)

    def __enter__(self) -> Announcer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join()

    def say(self, word: str, connection: str) -> None:
        """The station sees this (one of the protocol's SIGHTS); a new connection is told again. Returns at once."""
        if (word, connection) == self._said:
            return
        self._said = (word, connection)
        with self._news:
            self._word = word
            self._news.notify()

    def _run(self) -> None:
        while (word := self._next_word()) is not None:
            try:
                reply = self._ask(Request(action="show", text=word))
            except (LinkLost, ProtocolError) as error:
                log.debug("the robot's lights: %s", error)
            else:
                if reply is not None and not reply.ok:
                    log.debug("the robot's lights: %s", reply.error)

    def _next_word(self) -> str | None:
        """None: it is over."""
        with self._news:
            self._news.wait_for(lambda: self._closing or self._word is not None)
            word, self._word = self._word, None
            return None if self._closing else word
