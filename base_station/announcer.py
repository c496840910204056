"""Tells the robot what the station sees, for its lights: only what changed.

A word that does not arrive is dropped: the lights are for people, nothing is steered by them.
"""

from __future__ import annotations

import logging

from base_station.courier import Courier
from base_station.sockets import ControlLine
from protocol import Request


class Announcer:
    def __init__(self, line: ControlLine) -> None:
        self._courier = Courier(line, complain_at=logging.DEBUG)
        self._said: tuple[str, str] | None = None

    def say(self, sight: str, connection: str) -> None:
        """The station sees this (one of the protocol's SIGHTS); a new connection is told again. Returns at once."""
        if (sight, connection) != self._said:
            self._said = (sight, connection)
            self._courier.send(Request(action="show", text=sight))

    def close(self) -> None:
        self._courier.close()
