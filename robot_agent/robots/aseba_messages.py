"""The Aseba messages that tell a robot's protocol version, as they go over TCP and the serial cable. No I/O.

A message is three little-endian 16-bit numbers (length of the payload, source node, type) and the payload. Every node
answers LIST_NODES with NODE_PRESENT, whatever its version. (Aseba, common/consts.h and common/msg; the same numbers
are used by Mobsya's thymiodirect.)
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

DESCRIPTION, NODE_PRESENT, GET_DESCRIPTION, LIST_NODES = 0x9000, 0x900C, 0xA000, 0xA011
OLDEST_PROTOCOL = 4
"""The oldest version that asebamedulla 1.5 and 1.6 accept (ASEBA_MIN_TARGET_PROTOCOL_VERSION)."""
HEADER = struct.Struct("<HHH")
"""Length of the payload, source, type."""
_NUMBER = struct.Struct("<H")


@dataclass(frozen=True)
class AsebaMessage:
    """`source`: the node's number, 0 for programs."""

    source: int
    kind: int
    payload: bytes

    def __bytes__(self) -> bytes:
        return HEADER.pack(len(self.payload), self.source, self.kind) + self.payload

    @property
    def protocol_version(self) -> int | None:
        """The Aseba protocol version that a node tells, None in any other message and in a damaged one."""
        if self.kind == NODE_PRESENT and len(self.payload) >= _NUMBER.size:
            return int(_NUMBER.unpack_from(self.payload)[0])
        if self.kind == DESCRIPTION and self.payload:
            after_name = 1 + self.payload[0]
            if len(self.payload) >= after_name + _NUMBER.size:
                return int(_NUMBER.unpack_from(self.payload, after_name)[0])
        return None


def ask_version(kind: int, protocol: int) -> AsebaMessage:
    """LIST_NODES or GET_DESCRIPTION, as a program of that protocol version sends it."""
    return AsebaMessage(0, kind, _NUMBER.pack(protocol))


class AsebaDecoder:
    """Bytes to messages. Holds one unfinished message at the most, which is 65541 bytes."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def receive_data(self, data: bytes) -> list[AsebaMessage]:
        """The messages that these bytes complete."""
        self._buffer += data
        messages = []
        while len(self._buffer) >= HEADER.size:
            length, source, kind = HEADER.unpack_from(self._buffer)
            end = HEADER.size + length
            if len(self._buffer) < end:
                break
            messages.append(AsebaMessage(source, kind, bytes(self._buffer[HEADER.size : end])))
            del self._buffer[:end]
        return messages
