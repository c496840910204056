"""Commands on port 31441: two bytes, left and right wheel, back to back (thesis, listings A.1 and A.2).

Each byte is a signed 8-bit number in two's complement: listing A.2 writes -100 into a `char`. Listing A.1 reads them
unsigned, so there -100 drives forward at 156; towards such a peer only 0..127 mean the same on both sides.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from protocol.errors import ProtocolError, TruncatedError

COMMAND_BYTES = 2
MIN_UNIT, MAX_UNIT = -128, 127
_WIRE = struct.Struct("bb")


@dataclass(frozen=True)
class Command:
    """Wheel speeds in wire units, -128..127 each, forwards positive.

    One unit is one motor unit of the Thymio times the agent's speed scale. Raises ProtocolError out of range.
    """

    left: int
    right: int

    def __post_init__(self) -> None:
        for name, value in (("left", self.left), ("right", self.right)):
            if not MIN_UNIT <= value <= MAX_UNIT:
                raise ProtocolError(f"{name} wheel command is {value}, it must be {MIN_UNIT}..{MAX_UNIT}")

    @classmethod
    def clamped(cls, left: float, right: float, *, lowest: int = MIN_UNIT) -> Command:
        """The nearest command to any pair of finite numbers. `lowest` is 0 towards a peer that reads bytes unsigned.

        When a wheel is beyond the range, both are scaled by the same factor first, so the ratio, hence the turn, stays.
        """
        largest = max(left / MAX_UNIT, right / MAX_UNIT, -left / -MIN_UNIT, -right / -MIN_UNIT, 1.0)
        pair = (max(lowest, min(MAX_UNIT, round(value / largest))) for value in (left, right))
        return cls(*pair)

    @classmethod
    def from_bytes(cls, data: bytes | bytearray | memoryview) -> Command:
        """Decode exactly two bytes. Raises TruncatedError or ProtocolError on any other length."""
        if len(data) < COMMAND_BYTES:
            raise TruncatedError(f"a command is {COMMAND_BYTES} bytes, {len(data)} came")
        if len(data) > COMMAND_BYTES:
            raise ProtocolError(f"a command is {COMMAND_BYTES} bytes, not {len(data)}")
        return cls(*_WIRE.unpack(data))

    def __bytes__(self) -> bytes:
        return _WIRE.pack(self.left, self.right)


STOP = Command(0, 0)


class CommandDecoder:
    """Cuts a byte stream into commands and keeps the newest. Holds one byte at the most, whatever arrives.

    Only the newest command of a chunk is decoded, so a flood costs no more than a trickle.
    """

    def __init__(self) -> None:
        self.commands = 0
        """Commands completed so far."""
        self._half = b""

    @property
    def pending(self) -> int:
        """Bytes of an unfinished command: 0 or 1."""
        return len(self._half)

    def feed(self, data: bytes | bytearray | memoryview) -> Command | None:
        """Take bytes as they came; return the newest command they complete, or None."""
        total = len(self._half) + len(data)
        odd = total % COMMAND_BYTES
        complete = total // COMMAND_BYTES
        if complete == 0:
            self._half += bytes(data)
            return None
        tail = (self._half + bytes(data[-3:]))[-(COMMAND_BYTES + odd) :]
        self._half = tail[COMMAND_BYTES:]
        self.commands += complete
        return Command.from_bytes(tail[:COMMAND_BYTES])

    def end(self) -> None:
        """The stream ended. Raises TruncatedError when that was in the middle of a command."""
        if self._half:
            raise TruncatedError(f"the stream ended inside command {self.commands + 1}: 1 of 2 bytes had arrived")
