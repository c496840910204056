"""Frozen dataclasses to msgpack maps and back, checked field by field.

The messages of ports 31442 and 31443 are plain dataclasses; this module is how they cross the wire. A map from outside
is trusted in nothing: its length, types and numbers are checked, and the error names the field. Unknown keys are passed
over and missing ones take the dataclass's default, so that peers of different age understand each other.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import reprlib
import types
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import msgpack

from protocol.errors import ProtocolError

MAX_MESSAGE_BYTES = 64 * 1024
MAX_TEXT = 4096
MAX_ITEMS = 1024
MAX_BYTES = 48 * 1024
"""Of one field of bytes."""

T = TypeVar("T")


def to_bytes(record: Any) -> bytes:
    """Encode a dataclass (nested ones and tuples too) as a msgpack map."""
    data = msgpack.packb(dataclasses.asdict(record), use_bin_type=True)
    assert isinstance(data, bytes)
    return data


def from_bytes(kind: type[T], data: bytes) -> T:
    """Decode a msgpack map into the dataclass `kind`. Raises ProtocolError, naming what is wrong."""
    return from_map(kind, unpack_map(data))


def unpack_map(data: bytes) -> dict[str, Any]:
    """Decode bytes that must be one msgpack map with text keys, of bounded size. Raises ProtocolError."""
    if len(data) > MAX_MESSAGE_BYTES:
        raise ProtocolError(f"a message of {len(data)} bytes; at most {MAX_MESSAGE_BYTES} are read")
    try:
        value = msgpack.unpackb(data, raw=False, strict_map_key=True)
    except Exception as error:  # msgpack raises a dozen unrelated types on garbage
        raise ProtocolError(f"not a msgpack message: {error}") from error
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise ProtocolError("the message is not a map with text keys")
    return value


def from_map(kind: type[T], value: Any, where: str = "") -> T:
    """Build the dataclass `kind` from a decoded map. Raises ProtocolError."""
    if not isinstance(value, dict):
        raise ProtocolError(f"{where or kind.__name__}: a map is expected, {type(value).__name__} came")
    known: dict[str, Any] = {}
    hints = _hints(kind)  # type: ignore[arg-type]
    for field in dataclasses.fields(kind):  # type: ignore[arg-type]
        path = f"{where}.{field.name}" if where else field.name
        if field.name in value:
            known[field.name] = _convert(hints[field.name], value[field.name], path)
        elif field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING:
            raise ProtocolError(f"{path} is missing")
    try:
        return kind(**known)
    except ProtocolError:
        raise
    except (TypeError, ValueError) as error:
        raise ProtocolError(f"{where or kind.__name__}: {error}") from error


@functools.cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _convert(kind: Any, value: Any, path: str) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        (inner,) = (argument for argument in arguments if argument is not type(None))
        return _convert(inner, value, path)
    if origin is tuple:
        return _convert_tuple(arguments, value, path)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return from_map(kind, value, path)
    return _convert_scalar(kind, value, path)


def _convert_tuple(arguments: tuple[Any, ...], value: Any, path: str) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)) or len(value) > MAX_ITEMS:
        raise ProtocolError(f"{path}: a list of at most {MAX_ITEMS} items is expected")
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        return tuple(_convert(arguments[0], item, f"{path}[{i}]") for i, item in enumerate(value))
    if len(value) != len(arguments):
        raise ProtocolError(f"{path}: {len(arguments)} items are expected, {len(value)} came")
    return tuple(_convert(a, item, f"{path}[{i}]") for i, (a, item) in enumerate(zip(arguments, value, strict=True)))


def _convert_scalar(kind: Any, value: Any, path: str) -> Any:
    if kind is bool and isinstance(value, bool):
        return value
    if kind is str and isinstance(value, str) and len(value) <= MAX_TEXT:
        return value
    if kind is bytes and isinstance(value, bytes) and len(value) <= MAX_BYTES:
        return value
    if kind is int and isinstance(value, int) and not isinstance(value, bool):
        return value
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        number = float(value)
        if math.isfinite(number):
            return number
    shown = reprlib.repr(value)  # bounded in depth: str() of a thousand nested lists would exhaust the stack
    raise ProtocolError(f"{path}: {shown[:40]} is not a valid {getattr(kind, '__name__', kind)}")
