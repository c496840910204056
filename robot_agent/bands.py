"""Which rows of the picture go out: those that the agent was started with, or the fewer that the station asked for.

What a station asked for ends with its connection: the next one begins with what hello names.
"""

from __future__ import annotations

from protocol import FrameFormat


class Bands:
    """Pure state, to be used under the lock that also numbers the frames: what is chosen between two frames holds from
    the second one on, and both sides know which one that is."""

    def __init__(self, widest: FrameFormat) -> None:
        self._widest = widest
        self._chosen, self._connection = widest, 0

    def choose(self, rows: tuple[int, int] | None, connection: int) -> None:
        """Send this connection these rows of the camera's picture; None: as many as there are.

        Raises ProtocolError when they do not lie in the rows that hello names; then nothing changes.
        """
        self._chosen, self._connection = self._widest.band(rows), connection

    def of(self, connection: int) -> FrameFormat:
        """What the next frame of this connection is."""
        return self._chosen if connection == self._connection else self._widest
