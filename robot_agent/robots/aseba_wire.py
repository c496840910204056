"""The bytes to and from an Aseba network, over a serial port or TCP, in the form that thymiodirect reads.

thymiodirect's reader takes no bytes for a time-out, and reads on: at the end of a connection it would spin, a message
cut in two would put it out of step, and garbage would end it. So messages are read here, whole and checked, and handed
on in the pieces asked for; when the connection has ended `read` waits, and `why_lost` says why.
"""

from __future__ import annotations

import contextlib
import glob
import socket
import time
from collections.abc import Callable
from typing import Any, Protocol

from robot_agent.errors import AgentError
from robot_agent.robots.aseba_messages import HEADER

SERIAL_PORTS = "/dev/ttyACM*"
READ_S = 0.1
WRITE_S = 0.5
CONNECT_S = 1.0
MAX_PAYLOAD = 1024
"""Aseba's own limit is about half of that."""
MESSAGE_S = 1.0
"""The rest of a message must come within this time after its beginning."""


class WireError(Exception):
    """There is no robot at the end of this wire, or it went; the text says why, for a person."""


class _Line(Protocol):
    """A serial port or a TCP connection, unbuffered."""

    def receive(self, count: int) -> bytes:
        """Some bytes, at most `count`; none when none came in time. Raises OSError when the line is broken."""

    def send(self, data: bytes) -> None:
        """Raises OSError."""

    def close(self) -> None: ...


class Wire:
    """What thymiodirect wants of its `io`. `name`: of the port, for people; `is_sound`: whether a message (type,
    source, payload) can be handed on."""

    def __init__(self, line: _Line, name: str, is_sound: Callable[[int, int, bytes], bool]) -> None:
        self._line, self.name, self._is_sound = line, name, is_sound
        self._message = b""
        self.closed = False
        self.why_lost = ""
        """Why the connection ended, in words; empty while it stands."""

    def read(self, count: int) -> bytes:
        """The next `count` bytes of a message; none when none has come for a moment, or the connection has ended."""
        if not self._message:
            self._message = self._next_message()
        data, self._message = self._message[:count], self._message[count:]
        return data

    def _next_message(self) -> bytes:
        """A whole sound one, or nothing for now."""
        if self.closed or self.why_lost:
            time.sleep(READ_S)
            return b""
        try:
            header = self._receive(HEADER.size)
            if not header:
                return b""
            length, source, kind = HEADER.unpack(header)
            payload = self._receive(length, may_be_none=False) if length <= MAX_PAYLOAD else b""
        except OSError as error:
            self._lose(error)
            return b""
        if length > MAX_PAYLOAD or not self._is_sound(kind, source, payload):
            self._lose(OSError("what comes from it is not Aseba's protocol"))
            return b""
        return header + payload

    def _receive(self, count: int, *, may_be_none: bool = True) -> bytes:
        """Exactly so many bytes, or none where that may be. Raises OSError."""
        data = bytearray()
        deadline_s = time.monotonic() + MESSAGE_S
        while len(data) < count:
            data += self._line.receive(count - len(data))
            if not data and may_be_none:
                break
            if len(data) < count and time.monotonic() > deadline_s:
                raise OSError("a message broke off")
        return bytes(data)

    def write(self, data: bytes) -> None:
        """Send all; when that cannot be, the connection has ended."""
        if self.closed or self.why_lost:
            return
        try:
            self._line.send(data)
        except OSError as error:
            self._lose(error)

    def close(self) -> None:
        self.closed = True
        with contextlib.suppress(OSError):
            self._line.close()

    def _lose(self, error: OSError) -> None:
        if not self.closed:
            self.why_lost = self.why_lost or f"the connection to {self.name} broke ({error.strerror or error})"


def check_packages(device: str | None) -> None:
    """Raises AgentError when a package is missing that `open_wire` needs."""
    if not _is_tcp(device):
        _load_serial()


def open_wire(device: str | None, is_sound: Callable[[int, int, bytes], bool]) -> Wire:
    """Open a serial port's path, "tcp:HOST:PORT", or with None the first of SERIAL_PORTS.

    Raises WireError. `is_sound`: see Wire.
    """
    if device is not None and _is_tcp(device):
        host, _, port = device.removeprefix("tcp:").rpartition(":")
        return Wire(_Tcp(host, int(port)), f"{host}:{port}", is_sound)
    ports = sorted(glob.glob(SERIAL_PORTS))
    if device is None and not ports:
        raise WireError(f"there is no serial port {SERIAL_PORTS}")
    path = device or ports[0]
    return Wire(_Serial(path), path, is_sound)


def _is_tcp(device: str | None) -> bool:
    return device is not None and device.startswith("tcp:")


class _Tcp:
    def __init__(self, host: str, port: int) -> None:
        try:
            self._socket = socket.create_connection((host, port), timeout=CONNECT_S)
        except (OSError, UnicodeError) as error:
            raise WireError(f"{host}:{port} does not answer ({getattr(error, 'strerror', None) or error})") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(WRITE_S)

    def receive(self, count: int) -> bytes:
        try:
            data = self._socket.recv(count)
        except TimeoutError:
            return b""
        if not data:
            raise OSError("the other side closed it")
        return data

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes a thread that still reads
        self._socket.close()


class _Serial:
    def __init__(self, path: str) -> None:
        serial = _load_serial()
        try:
            self._port = serial.Serial(path, timeout=READ_S, write_timeout=WRITE_S, exclusive=True)
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise WireError(f"the serial port {path} cannot be opened ({why})") from error
        self._broken: tuple[type[Exception], ...] = (serial.SerialException, TypeError, ValueError)

    def receive(self, count: int) -> bytes:
        return bytes(self._guarded(self._port.read, count))

    def send(self, data: bytes) -> None:
        self._guarded(self._port.write, data)

    def close(self) -> None:
        self._guarded(self._port.close)

    def _guarded(self, call: Any, *arguments: Any) -> Any:
        """pyserial tells a port that was unplugged, or closed meanwhile, in several ways."""
        try:
            return call(*arguments)
        except self._broken as error:
            raise OSError(str(error)) from error


def _load_serial() -> Any:
    try:
        import serial
    except ImportError as error:
        raise AgentError(
            "A Thymio on a serial port needs pyserial: sudo apt install python3-serial, or "
            "pip install 'zservo[thymio-serial]'."
        ) from error
    return serial
