"""Frames on port 31440: gray pictures back to back, no header, no handshake (thesis, listings A.1 and A.2).

A frame is `height * width` bytes, 8-bit gray, row-major. Its format is agreed outside the stream (hello, or by hand),
so the decoder is told it; where the rows change on the way, it is told from which frame on. The decoder does no I/O: a
socket loop reads straight into `writable()` and reports with `advance(n)`, and the frame that is handed out is the
buffer that the socket filled: nothing is copied.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from protocol.errors import ProtocolError, TruncatedError

MAX_SIDE_PX = 8192


@dataclass(frozen=True, kw_only=True)
class FrameFormat:
    """What a frame on the wire is: a band of rows of the camera's picture, or all of it.

    `width` and `height` are those of the frame sent. `first_row` is the row of the camera's picture that the frame's
    row 0 shows, `full_height` the height of that whole picture (0 on construction means: the frame is the whole
    picture). Raises ProtocolError when a side is not 1..8192 or the band does not lie in the picture.
    """

    width: int
    height: int
    first_row: int = 0
    full_height: int = 0

    def __post_init__(self) -> None:
        if self.full_height == 0:
            object.__setattr__(self, "full_height", self.first_row + self.height)
        for name in ("width", "height", "full_height"):
            value = getattr(self, name)
            if not 1 <= value <= MAX_SIDE_PX:
                raise ProtocolError(f"frame {name} is {value}, it must be 1..{MAX_SIDE_PX}")
        if self.first_row < 0 or self.first_row + self.height > self.full_height:
            raise ProtocolError(
                f"rows {self.first_row}:{self.first_row + self.height} do not lie in a picture of {self.full_height}"
            )

    @property
    def size_bytes(self) -> int:
        """Bytes of one frame on the wire."""
        return self.width * self.height

    @property
    def rows(self) -> tuple[int, int]:
        """First and past-last row of the camera's picture that are sent."""
        return self.first_row, self.first_row + self.height

    def band(self, rows: tuple[int, int] | None) -> FrameFormat:
        """Of these frames only the rows first..past-last, counted as `rows`; None: all of them.

        Raises ProtocolError when they are none, or do not lie in the rows of these frames.
        """
        if rows is None:
            return self
        (first, past_last), (lowest, end) = rows, self.rows
        if not lowest <= first < past_last <= end:
            raise ProtocolError(f"rows {first}:{past_last} cannot be sent: the frames have rows {lowest}:{end}")
        return dataclasses.replace(self, first_row=first, height=past_last - first)

    def __str__(self) -> str:
        band = "" if self.height == self.full_height else f" (rows {self.first_row}:{self.first_row + self.height})"
        return f"{self.width}x{self.height}{band}"


class FrameDecoder:
    """Cuts a byte stream into frames. Holds one frame at the most.

    >>> decoder = FrameDecoder(FrameFormat(width=2, height=1))
    >>> [bytes(frame) for frame in decoder.feed(b"abcde")]
    [b'ab', b'cd']
    >>> decoder.pending
    1
    """

    def __init__(self, frame_format: FrameFormat) -> None:
        self.format = frame_format
        """Of the frame that comes next, or has begun to come."""
        self.frames = 0
        """Frames completed so far; the n-th frame of a connection is number n, counted from 1."""
        self._buffer = bytearray(frame_format.size_bytes)
        self._filled = 0
        self._later: tuple[int, FrameFormat] | None = None

    @property
    def pending(self) -> int:
        """Bytes of the unfinished frame that have arrived."""
        return self._filled

    def switch(self, frame_format: FrameFormat, number: int) -> None:
        """From frame `number` on the frames have this format. Replaces a switch that is still to come.

        Raises ProtocolError when that frame has begun already: its bytes were taken for something else.
        """
        if number <= self.frames or (number == self.frames + 1 and self._filled):
            raise ProtocolError(f"frames of {frame_format} were to begin with number {number}, which has begun to come")
        self._later = number, frame_format
        if number == self.frames + 1:
            self._take_over()

    def _take_over(self) -> None:
        """Make room for the frame that comes next, in its format."""
        if self._later is not None and self._later[0] == self.frames + 1:
            (_, self.format), self._later = self._later, None
        self._buffer, self._filled = bytearray(self.format.size_bytes), 0

    def writable(self) -> memoryview:
        """Where the next bytes belong: never empty, never beyond the end of the present frame."""
        return memoryview(self._buffer)[self._filled :]

    def advance(self, count: int) -> bytearray | None:
        """Report `count` bytes written into `writable()`. Returns the frame they complete, else None.

        The buffer returned is the caller's: the decoder goes on with a new one.
        """
        if not 0 <= count <= len(self._buffer) - self._filled:
            raise ValueError(f"advance({count}) with room for {len(self._buffer) - self._filled}")
        self._filled += count
        if self._filled < len(self._buffer):
            return None
        frame = self._buffer
        self.frames += 1
        self._take_over()
        return frame

    def feed(self, data: bytes | bytearray | memoryview) -> list[bytearray]:
        """Take bytes as they came, of any length; return the frames they complete (this one copies)."""
        frames: list[bytearray] = []
        view = memoryview(data)
        while view:
            space = self.writable()
            count = min(len(space), len(view))
            space[:count] = view[:count]
            frame = self.advance(count)
            if frame is not None:
                frames.append(frame)
            view = view[count:]
        return frames

    def end(self) -> None:
        """The stream ended. Raises TruncatedError when that was in the middle of a frame."""
        if self._filled:
            raise TruncatedError(
                f"the stream ended inside frame {self.frames + 1}: "
                f"{self._filled} of {self.format.size_bytes} bytes had arrived"
            )
