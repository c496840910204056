"""The two raw TCP ports: each listens, serves one station at a time and turns away all others at once."""

from __future__ import annotations

import array
import contextlib
import errno
import fcntl
import logging
import random
import select
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from protocol import COMMAND_BYTES, Command, CommandDecoder, TruncatedError
from robot_agent.access import AllowList
from robot_agent.errors import AgentError

log = logging.getLogger(__name__)

SIOCOUTQNSD = 0x894B
"""Linux: bytes that the kernel has not sent yet (include/uapi/linux/sockios.h)."""
PEER_TIMEOUT_MS = 5000
"""After this long without an answer the station is taken for dead, and the robot is free for another."""
FLOOD_PAUSE_S = 0.001
CHUNK_BYTES = 4096


@dataclass(frozen=True, eq=False)
class Peer:
    """One connection of a station. `number` counts the connections of the port, from 1."""

    socket: socket.socket
    host: str
    address: str
    """host:port of its end."""
    number: int


class StationPort:
    """A listening port with one peer at the most. `on_change` is called after a peer came or went, from any thread.

    `partner_host`: the host that is connected to the other port, if any; a peer from elsewhere is turned away.
    """

    def __init__(
        self,
        name: str,
        host: str,
        port: int,
        *,
        allow: AllowList,
        on_change: Callable[[], None],
        partner_host: Callable[[], str | None],
    ) -> None:
        self.name = name
        self.connections = 0
        """Peers served so far, the present one included."""
        self._allow, self._on_change, self._partner_host = allow, on_change, partner_host
        self._peer: Peer | None = None
        self._lock = threading.Lock()
        self._came = threading.Condition(self._lock)
        self._listener = _listen(host, port)
        self._thread = threading.Thread(target=self._accept, name=f"{name}-accept", daemon=True)

    def start(self) -> None:
        """Begin to accept."""
        self._thread.start()

    @property
    def peer(self) -> Peer | None:
        """The station that is connected."""
        return self._peer

    def wait_for_peer(self, timeout_s: float) -> Peer | None:
        """The peer, waiting for one if need be."""
        with self._came:
            self._came.wait_for(lambda: self._peer is not None, timeout_s)
            return self._peer

    def drop(self, peer: Peer, why: str) -> None:
        """Let this peer go, if it still is the present one."""
        with self._lock:
            if self._peer is not peer:
                return
            log.info("%s: %s is gone (%s)", self.name, peer.address, why)
            self._peer = None
        with contextlib.suppress(OSError):
            peer.socket.shutdown(socket.SHUT_RDWR)
        peer.socket.close()
        self._on_change()

    def drop_if_gone(self) -> None:
        """Let the peer go when it has closed its end. To be asked now and then: while nothing is read from a peer nor
        written to it (lockstep with half a station, a camera that hangs), nothing else notices that it went."""
        peer = self._peer
        if peer is None:
            return
        watch = select.poll()
        try:
            watch.register(peer.socket, select.POLLRDHUP)
        except ValueError:
            return  # closed by another thread just now
        if watch.poll(0):
            self.drop(peer, "it closed the connection")

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        if self._peer is not None:
            self.drop(self._peer, "the agent ends")

    def _accept(self) -> None:
        while True:
            try:
                connection, (host, port, *_) = self._listener.accept()
            except OSError:
                return  # the listener was closed: the agent ends
            why_not = self._admit(connection, host, f"{host}:{port}")
            if why_not:
                log.warning("%s: %s:%d turned away: %s", self.name, host, port, why_not)
                connection.close()
            else:
                self._on_change()

    def _admit(self, connection: socket.socket, host: str, address: str) -> str:
        """Take this station in. Returns why not, in words; empty when it was."""
        if not self._allow.permits(host):
            return "not in --allow"
        partner_host = self._partner_host()
        if partner_host not in (None, host):
            return f"busy with a station on {partner_host}"
        with self._came:
            if self._peer is not None:
                return f"second station, busy with {self._peer.address}"
            try:
                _tune(connection)
            except OSError as error:
                return f"it went at once ({error})"
            self.connections += 1
            self._peer = Peer(connection, host, address, self.connections)
            log.info("%s: %s connected", self.name, address)
            self._came.notify_all()
        return ""


def _listen(host: str, port: int) -> socket.socket:
    try:
        return socket.create_server((host, port), backlog=4)
    except OverflowError as error:
        raise AgentError(f"{port} is no port: give a base of 1..65532 with --port.") from error
    except OSError as error:
        raise AgentError(
            f"Port {port} on {host} cannot be opened ({error.strerror or error}): {advice(error.errno)}"
        ) from error


def advice(number: int | None) -> str:
    """What to do when a port cannot be opened, by the error's number."""
    if number == errno.EADDRINUSE:
        return "another agent may be running; stop it, or choose another with --port."
    return "is the address of --listen one of this machine's (0.0.0.0 is all of them)?"


def _tune(peer: socket.socket) -> None:
    """No delay for small packets, and a dead peer is noticed within seconds instead of minutes."""
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 1)
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1)
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, PEER_TIMEOUT_MS)
    peer.setblocking(False)


class FrameWriter:
    """Writes frames whole or not at all, and never lets a queue grow behind a slow station.

    A new frame is begun only when the kernel has nothing left to send of the frame before, so that at the most one
    frame waits on this side; what the station does not take in time is replaced by a newer one.
    """

    def __init__(self, port: StationPort, running: Callable[[], bool]) -> None:
        self._port, self._running = port, running
        self._buffered: tuple[Peer, int] | None = None
        """Whose kernel buffer was set, and to frames of how many bytes."""

    def ready(self, peer: Peer) -> bool:
        """Whether the frame before has left for the station."""
        unsent = array.array("i", [0])
        try:
            fcntl.ioctl(peer.socket.fileno(), SIOCOUTQNSD, unsent)
        except (OSError, ValueError):
            return True  # closed meanwhile; the write that follows tells
        return unsent[0] == 0

    def _keep_to_one_frame(self, peer: Peer, frame_bytes: int) -> None:
        """Make the kernel's buffer about as large as this frame (Linux doubles the figure for its own use)."""
        if self._buffered == (peer, frame_bytes):
            return
        self._buffered = peer, frame_bytes
        with contextlib.suppress(OSError):
            peer.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, max(frame_bytes // 2, CHUNK_BYTES))

    def write(self, peer: Peer, frame: memoryview) -> bool:
        """Send it all. False when the peer went; it is dropped then."""
        self._keep_to_one_frame(peer, len(frame))
        while frame:
            try:
                frame = frame[peer.socket.send(frame) :]
            except BlockingIOError:
                if not self._running() or self._port.peer is not peer:
                    return False
                with contextlib.suppress(OSError, ValueError):  # closed meanwhile; the next write tells
                    select.select([], [peer.socket], [], 0.1)
            except OSError as error:
                self._port.drop(peer, str(error))
                return False
        return True


class CommandReader:
    """Reads commands from the command port: the newest of what has come, or exactly one."""

    def __init__(self, port: StationPort) -> None:
        self._port = port
        self._decoder = CommandDecoder()
        self._peer: Peer | None = None

    def read(self, timeout_s: float, *, one: bool = False) -> tuple[Command, Peer] | None:
        """Wait for a command; returns it with the peer that sent it, None when none came in time.

        `one`: take the next in line and leave later ones for later calls (lockstep).
        """
        peer = self._port.wait_for_peer(timeout_s)
        if peer is None:
            return None
        if peer is not self._peer:
            self._peer, self._decoder = peer, CommandDecoder()
        try:
            readable, _, _ = select.select([peer.socket], [], [], timeout_s)
            if not readable:
                return None
            data = peer.socket.recv(COMMAND_BYTES - self._decoder.pending if one else CHUNK_BYTES)
        except BlockingIOError:
            return None
        except (OSError, ValueError) as error:
            self._port.drop(peer, str(error))
            return None
        if not data:
            self._end(peer)
            return None
        if len(data) == CHUNK_BYTES:
            time.sleep(FLOOD_PAUSE_S)  # a flood must not starve the camera's thread
        command = self._decoder.feed(data)
        return None if command is None else (command, peer)

    def _end(self, peer: Peer) -> None:
        why = "it closed the connection"
        try:
            self._decoder.end()
        except TruncatedError as error:
            why = str(error)
        self._port.drop(peer, why)


def free_ports(count: int = 4, host: str = "127.0.0.1") -> int:
    """The first of `count` ports in a row that nobody listens on just now. Raises AgentError when there are none."""
    for base in random.sample(range(20000, 32000, count), 200):
        with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
            for port in range(base, base + count):
                stack.enter_context(socket.create_server((host, port)))
            return base
    raise AgentError(f"There are no {count} free ports in a row on {host}.")


if __name__ == "__main__":
    print(free_ports())
