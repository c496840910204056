"""The wire format of Protocol Buffers, as much of it as reading foxglove's messages needs.

A message is a row of fields: a number and a kind, then the value. Repeated numbers may be packed into one field.
https://protobuf.dev/programming-guides/encoding
"""

from __future__ import annotations

import struct

from base_station.errors import StationError

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
MOST_FIELDS = 100_000

Fields = dict[int, list[int | bytes]]
"""By number, the values in their order: varints as int, everything else as its bytes."""


def fields_of(data: bytes) -> Fields:
    """Take a message apart. Raises StationError when it is cut short or is none."""
    found: Fields = {}
    at, count = 0, 0
    while at < len(data):
        key, at = _varint(data, at)
        number, kind = key >> 3, key & 7
        value: int | bytes
        if kind == VARINT:
            value, at = _varint(data, at)
        elif kind in (FIXED64, FIXED32, LENGTH):
            size, at = _varint(data, at) if kind == LENGTH else (8 if kind == FIXED64 else 4, at)
            if size > len(data) - at:
                raise StationError("a protobuf message is cut short")
            value, at = data[at : at + size], at + size
        else:
            raise StationError(f"a protobuf message has a field of the unknown kind {kind}")
        found.setdefault(number, []).append(value)
        count += 1
        if count > MOST_FIELDS:
            raise StationError("a protobuf message has too many fields")
    return found


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(data) and shift < 64:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
    raise StationError("a protobuf message is cut short")


def whole(fields: Fields, number: int) -> int:
    """The last value of this field as a number; 0 when it is left out, as protobuf has it."""
    value = fields.get(number, [0])[-1]
    if isinstance(value, bytes) and len(value) == 4:
        return int(struct.unpack("<I", value)[0])
    if isinstance(value, bytes):
        raise StationError(f"field {number} of a protobuf message is no number")
    return value


def data(fields: Fields, number: int) -> bytes:
    """The last value of this field as bytes; empty when it is left out."""
    value = fields.get(number, [b""])[-1]
    if not isinstance(value, bytes):
        raise StationError(f"field {number} of a protobuf message is a number")
    return value


def doubles(fields: Fields, number: int) -> tuple[float, ...]:
    """All values of this field as 64-bit floating-point numbers, packed or not."""
    joined = b"".join(value for value in fields.get(number, []) if isinstance(value, bytes))
    if len(joined) % 8:
        raise StationError(f"field {number} of a protobuf message holds no numbers")
    return struct.unpack(f"<{len(joined) // 8}d", joined)
