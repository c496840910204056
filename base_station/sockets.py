"""The station's ends of the four ports: raw frames and commands over TCP, telemetry and control over ZMQ."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable
from typing import NoReturn

import zmq

from protocol import (
    Command,
    FrameDecoder,
    FrameFormat,
    ProtocolError,
    Reply,
    Request,
    Telemetry,
    decode_reply,
    decode_telemetry,
    encode,
)
from protocol.records import MAX_MESSAGE_BYTES

CONNECT_TIMEOUT_S = 2.0


class LinkLost(Exception):
    """The connection ended; the text says how."""


class UnknownHost(LinkLost):
    """The host's name means nothing, or not now."""


class RawConnection:
    """Both raw TCP connections to one robot. Raises LinkLost when either cannot be made or ends."""

    def __init__(self, host: str, frame_port: int, frame_format: FrameFormat) -> None:
        self._frames = _connect(host, frame_port, receive_buffer=frame_format.size_bytes // 2)
        try:
            self._commands = _connect(host, frame_port + 1)
        except LinkLost:
            self._frames.close()
            raise
        self._decoder = FrameDecoder(frame_format)
        self.address = "{}:{}".format(*self._frames.getsockname()[:2])
        """The station's own end of the frame connection, as the agent sees it."""

    @property
    def frames_received(self) -> int:
        return self._decoder.frames

    def switch(self, frame_format: FrameFormat, number: int) -> None:
        """From frame `number` on the frames have this format. Raises ProtocolError when that one has begun to come.

        The receive buffer stays: a window that shrinks below what TCP sends at once makes it wait 0.2 s a frame.
        """
        self._decoder.switch(frame_format, number)

    def receive(self, timeout_s: float) -> tuple[bytearray, FrameFormat, float] | None:
        """The next whole frame, what it shows and when its last byte came, or None for now."""
        readable, _, _ = select.select([self._frames, self._commands], [], [], timeout_s)
        try:
            if self._frames not in readable:
                if self._commands in readable and not self._commands.recv(64):
                    self._end("the robot closed the command connection")
                return None
            count = self._frames.recv_into(self._decoder.writable())
        except BlockingIOError:
            return None
        except OSError as error:
            raise LinkLost(f"the connection broke ({error.strerror or error})") from error
        arrival_s = time.monotonic()
        if count == 0:
            self._end("the robot closed the frame connection")
        frame_format = self._decoder.format
        frame = self._decoder.advance(count)
        return None if frame is None else (frame, frame_format, arrival_s)

    def _end(self, how: str) -> NoReturn:
        """Raise LinkLost; where a frame is cut short that is what it says."""
        try:
            self._decoder.end()
        except ProtocolError as error:
            raise LinkLost(str(error)) from error
        raise LinkLost(how)

    def send(self, command: Command) -> float:
        """Hand a command to the socket; returns when (monotonic s). Raises LinkLost."""
        try:
            self._commands.send(bytes(command))
        except OSError as error:
            raise LinkLost(f"the command connection broke ({error.strerror or error})") from error
        return time.monotonic()

    def close(self) -> None:
        for connection in (self._frames, self._commands):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()


def _connect(host: str, port: int, receive_buffer: int | None = None) -> socket.socket:
    """Raises UnknownHost, LinkLost."""
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except (socket.gaierror, UnicodeError) as error:
        raise UnknownHost(f"there is no host {host!r} ({getattr(error, 'strerror', error)})") from error
    failure: OSError | None = None
    for family, kind, protocol, _, address in addresses:
        connection = socket.socket(family, kind, protocol)
        try:
            if receive_buffer is not None:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, max(receive_buffer, 4096))
            connection.settimeout(CONNECT_TIMEOUT_S)
            connection.connect(address)
            _tune(connection)
            return connection
        except OSError as error:
            connection.close()
            failure = error
    raise LinkLost(f"{host}:{port} does not answer ({(failure and failure.strerror) or failure})") from failure


def _tune(connection: socket.socket) -> None:
    """No delay for two bytes, and a robot that vanished (Wi-Fi gone, plug pulled) is noticed within seconds."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
    connection.setblocking(False)


class Control:
    """Asks the agent's control port. One question at a time, from any thread."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], host: str, port: int) -> None:
        self._context, self._host, self._port = context, host, port
        self._asking = threading.Lock()

    def ask(self, request: Request, timeout_s: float = 2.0) -> Reply | None:
        """The agent's reply, None when nobody listens there.

        Raises LinkLost when somebody listens but does not answer, ProtocolError when the answer makes no sense.
        """
        with self._asking:
            if not self.listens():
                return None
            with self._context.socket(zmq.REQ) as asking:  # a new one each time: REQ is stuck after a lost reply
                _prepare(asking, self._host, self._port)
                return _exchange(asking, request, timeout_s, f"{self._host}:{self._port}")

    def listens(self) -> bool:
        """Whether anything listens there: a plain thesis peer does not, and need not be waited for."""
        try:
            _connect(self._host, self._port).close()
        except LinkLost:
            return False
        return True


class ControlLine:
    """A connection to the control port that stays open, for requests that come as often as frames. From one thread."""

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], host: str, port: int) -> None:
        self._context, self._host, self._port = context, host, port
        self._socket: zmq.Socket[bytes] | None = None

    def ask(self, request: Request, timeout_s: float = 0.5) -> Reply:
        """The agent's reply. Raises LinkLost when none comes, ProtocolError when it makes no sense."""
        if self._socket is None:
            self._socket = self._context.socket(zmq.REQ)
            _prepare(self._socket, self._host, self._port)
        try:
            return _exchange(self._socket, request, timeout_s, f"{self._host}:{self._port}")
        except LinkLost:
            self.close()  # REQ is stuck after a lost reply
            raise

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _prepare(asking: zmq.Socket[bytes], host: str, port: int) -> None:
    asking.linger = 0
    asking.maxmsgsize = MAX_MESSAGE_BYTES
    asking.connect(f"tcp://{host}:{port}")


def _exchange(asking: zmq.Socket[bytes], request: Request, timeout_s: float, where: str) -> Reply:
    silent = f"{where} gives no answer (does the agent's --allow let this station in?)"
    asking.sndtimeo = int(timeout_s * 1000)
    try:
        asking.send(encode(request))
    except zmq.Again as error:  # a station that is refused has nobody to send to
        raise LinkLost(silent) from error
    if not asking.poll(int(timeout_s * 1000)):
        raise LinkLost(silent)
    return decode_reply(asking.recv())


class TelemetryFeed:
    """Receives telemetry in a thread and hands each message to `take`; `failed` is told what ends the thread early."""

    def __init__(
        self,
        context: zmq.Context[zmq.Socket[bytes]],
        host: str,
        port: int,
        take: Callable[[Telemetry], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._take, self._failed = take, failed
        self._first = threading.Event()
        self._closing = threading.Event()
        self._socket = context.socket(zmq.SUB)
        self._socket.linger = 0
        self._socket.maxmsgsize = MAX_MESSAGE_BYTES
        self._socket.subscribe(b"")
        self._socket.connect(f"tcp://{host}:{port}")
        self._thread = threading.Thread(target=self._listen, name="telemetry", daemon=True)
        self._thread.start()

    def wait_until_live(self, timeout_s: float) -> bool:
        """Whether a message has come, waiting for it: from then on none of the connection's is missed."""
        return self._first.wait(timeout_s)

    def _listen(self) -> None:
        while not self._closing.is_set():
            if not self._socket.poll(100):
                continue
            try:
                telemetry = decode_telemetry(self._socket.recv())
            except ProtocolError:
                continue  # a later message may be whole; the frames do not depend on it
            self._first.set()
            try:
                self._take(telemetry)
            except Exception as error:
                self._failed(error)
                break
        self._socket.close()

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
