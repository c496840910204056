"""The frames' numbers, and with each number which rows of the picture go out and what was true when it was taken."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace

from protocol import FrameFormat, FrameStamp, ProtocolError, Truth
from robot_agent.bands import Bands
from robot_agent.cameras.base import CameraFrame
from robot_agent.ports import Peer


class Stamps:
    """Numbers the frames of each connection from 1. Numbers and rows are decided under one lock, so that both sides
    know from which frame on a choice of rows holds.

    `watcher`: the station that gets the frames now, if any.
    """

    def __init__(self, widest: FrameFormat, watcher: Callable[[], Peer | None]) -> None:
        self._widest, self._watcher = widest, watcher
        self._bands = Bands(widest)
        self._lock = threading.Lock()
        self._stamp: FrameStamp | None = None
        self._truth: Truth | None = None

    def stamp(
        self, connection: int, picture: CameraFrame, replaced: int, angles_rad: tuple[float, float] | None
    ) -> FrameFormat:
        """Give the picture its number: the next of its connection. Returns what of it goes out under this number.

        `replaced`: pictures that were never sent since the one before. `angles_rad`: pan and tilt as it was taken.
        """
        pan_rad, tilt_rad = angles_rad or (None, None)
        with self._lock:
            before = self._stamp
            if before is None or before.connection != connection:
                before = FrameStamp(connection=connection, number=0, capture_s=0.0, dropped=0)
            sent = self._bands.of(connection)
            self._stamp = replace(
                before,
                number=before.number + 1,
                capture_s=picture.capture_s,
                dropped=before.dropped + replaced,
                pan_rad=pan_rad,
                tilt_rad=tilt_rad,
                rows=sent.rows if sent is not self._widest else None,
            )
            self._truth = picture.truth
        return sent

    def choose_rows(self, rows: tuple[int, int] | None, station: str) -> int:
        """Send the station at this address these rows from the next frame on; returns that frame's number.

        Raises ProtocolError when it is not the station that gets the frames, or the rows are not among them.
        """
        with self._lock:
            peer = self._watcher()
            if peer is None or peer.address != station:
                raise ProtocolError("only the station that gets the frames can choose their rows")
            self._bands.choose(rows, peer.number)
            begun = self._stamp is not None and self._stamp.connection == peer.number
            return 1 + (self._stamp.number if begun and self._stamp is not None else 0)

    def current(self) -> tuple[FrameStamp | None, Truth | None]:
        """Of the newest frame of the station that watches now; None and None before its first."""
        with self._lock:
            watcher = self._watcher()
            current = self._stamp is not None and watcher is not None and self._stamp.connection == watcher.number
            return (self._stamp, self._truth) if current else (None, None)
