"""Fewer bytes: of each picture only the band of rows that the trackers look at.

A tracker says after each frame which rows it needs next (`trackers.base.WantsRows`). What the robot is asked for is a
little more, so that it need not be asked again in every frame. Frames have no header, so both sides must agree where
in the stream the rows change: the robot, asked between two frames, answers with the number of the first frame that has
them (`frame` of the reply). Until the answer is there nothing more is read.
"""

from __future__ import annotations

import logging

from base_station.sockets import ControlLine, LinkLost, RawConnection
from protocol import FrameFormat, ProtocolError, Request

log = logging.getLogger(__name__)

Rows = tuple[int, int]
"""First and past-last row."""

STEP = 4
"""Bands begin and end at multiples of this, so that pictures at half and quarter size fall on the same pixels."""
SLACK = 0.06
"""Of the rows wanted, added at either end."""
LARGEST_SHARE = 0.85
"""Of all rows: a band that saves less than the rest is not worth asking for."""
WASTEFUL = 1.35
"""A band so many times as large as the one that would be chosen now is given up."""
PATIENCE_S = 2.0
KEPT = 64
"""Frames whose telemetry is remembered."""
NO_ROWS = "%s: --rows changes nothing, the frames stay whole."


def united(wishes: list[Rows | None]) -> Rows | None:
    """The rows that serve all wishes; None (all rows) when one of them does, or there is none."""
    known = [rows for rows in wishes if rows is not None]
    if not known or len(known) < len(wishes):
        return None
    return min(first for first, _ in known), max(past_last for _, past_last in known)


def band_for(wanted: Rows | None, present: Rows | None, height: int) -> Rows | None:
    """The band to ask for, of frames with `height` rows; None for whole frames.

    `present`: what is sent now. It stays as long as the wanted rows lie in it and it is not far too large.
    """
    if wanted is None:
        return None
    slack = round(SLACK * (wanted[1] - wanted[0]))
    first = max((wanted[0] - slack) // STEP * STEP, 0)
    past_last = min(-(-(wanted[1] + slack) // STEP) * STEP, height)
    if past_last <= first or past_last - first > LARGEST_SHARE * height:
        return None
    if present is None:
        return first, past_last
    holds_all = present[0] <= max(wanted[0], 0) and min(wanted[1], height) <= present[1]
    is_small = present[1] - present[0] <= WASTEFUL * (past_last - first)
    return present if holds_all and is_small else (first, past_last)


class RowSwitch:
    """Asks for bands on one connection. `want` is the loop's, `note` telemetry's, the others the receiving thread's."""

    def __init__(self, line: ControlLine, whole: FrameFormat, station: str) -> None:
        """`whole`: the frames as hello names them; bands are counted in their rows. `station`: see `Request`."""
        self._line, self._whole, self._station = line, whole, station
        self._present: Rows | None = None
        self._wanted: Rows | None = None
        self._gave_up = False
        self._told: dict[int, Rows | None] = {}

    def want(self, rows: Rows | None) -> None:
        """These rows are needed from now on; None: all. Returns at once."""
        self._wanted = rows

    def note(self, number: int, rows: Rows | None) -> None:
        """Telemetry says which rows of the camera's picture this frame shows."""
        self._told[number] = rows
        self._told.pop(number - KEPT, None)

    def check(self, number: int, frame_format: FrameFormat) -> None:
        """Raises LinkLost when a frame that was read as this is said to be another: somebody else changed the rows, and
        what was read is torn. (Where telemetry is late nothing is checked.)"""
        if number in self._told and (self._told[number] or self._whole.rows) != frame_format.rows:
            raise LinkLost("its telemetry tells of other rows than it was asked for")

    def act(self, raw: RawConnection) -> None:
        """Between two frames: ask for other rows where they are needed, and tell the connection from which frame on
        they come. Raises LinkLost when the robot does not say: then nobody knows how long its frames are."""
        band = band_for(self._wanted, self._present, self._whole.height)
        if band == self._present or self._gave_up:
            return
        offset = self._whole.first_row
        rows = None if band is None else (band[0] + offset, band[1] + offset)
        try:
            sent = self._whole.band(rows)
            reply = self._line.ask(Request(action="rows", rows=rows, station=self._station), PATIENCE_S)
            if reply.ok:
                raw.switch(sent, reply.frame)
                self._present = band
                return
        except ProtocolError as error:
            raise LinkLost(f"it does not make clear which rows it sends ({error})") from error
        if self._present is not None:
            raise LinkLost(f"it refuses to change its rows ({reply.error})")
        log.warning(NO_ROWS, f"the robot refuses ({reply.error})")
        self._gave_up = True

    def close(self) -> None:
        self._line.close()
