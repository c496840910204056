"""What the network carries: the four ports, Wi-Fi's bit rate, and a measured throughput to another machine.

The measurement is one TCP connection in the direction of the frames. On the PC `robot-agent doctor --sink` takes the
bytes and answers, every time that it has taken a piece, how many they were; so what counts is what has arrived.
"""

from __future__ import annotations

import contextlib
import errno
import re
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import zmq

from protocol import Hello, ProtocolError, Request, decode_reply, encode
from protocol.records import MAX_MESSAGE_BYTES
from robot_agent.access import AllowList
from robot_agent.doctor.findings import Finding, Verdict
from robot_agent.doctor.machine import run
from robot_agent.errors import AgentError

MEASURE_S = 2.0
CONNECT_S = 3.0
SINK_IDLE_S = 5.0
SINK_LONGEST_S = 30.0
HEADROOM = 1.3
"""A link that carries just as much as the frames need has nothing left for a bad second."""
WIFI_SHARE = 0.5
"""TCP gets about half of the bit rate that a Wi-Fi interface tells."""
HELLO_S = 1.0
_ARRIVED = struct.Struct("!Q")
_CHUNK_BYTES = 65536


def needed_mbit_s(width: int, height: int, fps: float) -> float:
    """What frames of that size take, in Mbit/s."""
    return width * height * 8 * fps / 1e6


def check_ports(host: str, port: int, service: str) -> Iterator[Finding]:
    """The four ports can be opened on this address. `service`: the systemd unit that may hold them."""
    taken, first = [], ""
    for number in range(port, port + 4):
        try:
            with socket.create_server((host, number)):
                pass
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                said = f"{host} cannot be listened on ({error.strerror})"
                mend = "--listen 0.0.0.0 for all addresses of this machine, or one that `ip -brief address` lists"
                yield Finding("ports", Verdict.FAILED, said, mend)
                return
            taken.append(number)
    if not taken:
        yield Finding("ports", Verdict.OK, f"{port} to {port + 3} are free on {host}")
        return
    hello = ask_hello(port)
    if hello is not None:
        first = f": {hello.agent} runs there (robot {hello.robot}, {hello.width}x{hello.height})"
    said = f"{', '.join(map(str, taken))} in use{first}"
    mend = f"systemctl --user stop {service}, or end the other agent, or choose other ports: --port {port + 10}"
    yield Finding("ports", Verdict.FAILED, said, mend)


def ask_hello(port: int, host: str = "127.0.0.1") -> Hello | None:
    """What an agent on these ports says of itself; None when none answers in time."""
    with zmq.Context() as context, context.socket(zmq.REQ) as asking:
        asking.linger = 0
        asking.maxmsgsize = MAX_MESSAGE_BYTES
        asking.connect(f"tcp://{host}:{port + 3}")
        asking.send(encode(Request(action="hello")))
        if not asking.poll(round(HELLO_S * 1000)):
            return None
        with contextlib.suppress(ProtocolError):
            return decode_reply(asking.recv()).hello
    return None


def check_link(peer: tuple[str, int] | None, needed: float, frame_bytes: int) -> Iterator[Finding]:
    """Measure to the peer, or to this machine itself when there is none. `needed`: Mbit/s of the frames asked for."""
    if peer is None:
        with _own_sink() as port:
            carried = measure("127.0.0.1", port, frame_bytes, MEASURE_S / 4)
        yield _judge("loopback", "this machine to itself", carried, needed)
        said = "the way to the PC was not measured"
        mend = "on the PC: robot-agent doctor --sink --listen 0.0.0.0   then here: doctor --peer ADDRESS_OF_THE_PC"
        yield Finding("link", Verdict.SKIPPED, said, mend)
        return
    yield _judge("link", "to the peer", measure(*peer, frame_bytes, MEASURE_S), needed)


def _judge(part: str, what: str, carried: float, needed: float) -> Finding:
    said = f"{what}: {carried:.0f} Mbit/s carried, {needed:.0f} needed by these frames"
    if carried >= HEADROOM * needed:
        return Finding(part, Verdict.OK, said)
    return Finding(part, Verdict.WARNING, said, fewer_bytes(carried / HEADROOM, needed))


def fewer_bytes(carried: float, needed: float) -> str:
    """The option that makes frames fit, `carried` and `needed` in Mbit/s."""
    if carried >= needed / 4:
        return "--size 320x240 (a quarter of 640x480)"
    if carried >= needed / 7.5:
        return "--rows 208:272 (a band of 64 rows, a seventh of 640x480)"
    return "--size 320x240 --fps 10 (a twelfth); or move nearer to the router, or use a cable"


def check_wifi(needed: float) -> Iterator[Finding]:
    """The bit rate of every Wi-Fi interface, as `iw` tells it; without iw the signal's quality as the kernel does."""
    interfaces = sorted(path.parent.name for path in Path("/sys/class/net").glob("*/wireless"))
    if not interfaces:
        yield Finding("wifi", Verdict.SKIPPED, "no Wi-Fi interface here")
    for interface in interfaces:
        printed = run("iw", "dev", interface, "link") or run("/usr/sbin/iw", "dev", interface, "link")
        if printed is None:
            quality = _quality(interface)
            said = f"{interface}: signal quality {quality} of 70" if quality else f"{interface} tells nothing"
            yield Finding("wifi", Verdict.WARNING, said, "sudo apt install iw, for its bit rate")
        else:
            yield wifi_finding(interface, printed, needed)


def wifi_finding(interface: str, printed: str, needed: float) -> Finding:
    """What `iw dev INTERFACE link` printed, against what the frames need. The network's name is left out."""
    rate = re.search(r"tx bitrate: ([\d.]+) MBit/s", printed)
    if rate is None:
        mend = "sudo nmtui, and connect it (or use a cable)"
        return Finding("wifi", Verdict.WARNING, f"{interface} is not connected", mend)
    signal = re.search(r"signal: (-?\d+) dBm", printed)
    carried = WIFI_SHARE * float(rate[1])
    said = (
        f"{interface}: {float(rate[1]):.0f} Mbit/s on the air{f' at {signal[1]} dBm' if signal else ''}, "
        f"of which TCP gets about {carried:.0f}; {needed:.0f} needed by these frames"
    )
    if carried >= needed:
        return Finding("wifi", Verdict.OK, said)
    return Finding("wifi", Verdict.WARNING, said, fewer_bytes(carried, needed))


def _quality(interface: str) -> str:
    try:
        lines = Path("/proc/net/wireless").read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return ""
    return next((line.split()[2].rstrip(".") for line in lines if line.strip().startswith(f"{interface}:")), "")


def measure(host: str, port: int, frame_bytes: int, duration_s: float) -> float:
    """Mbit/s of frames that arrive at a sink. Raises AgentError when there is none, or it goes."""
    frame, sent, arrived, acknowledged = memoryview(bytes(frame_bytes)), 0, 0, b""
    try:
        with socket.create_connection((host, port), CONNECT_S) as connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            connection.setblocking(False)
            begun_s = now_s = time.monotonic()
            while now_s < begun_s + duration_s:
                readable, writable, _ = select.select([connection], [connection], [], 0.2)
                if writable:
                    with contextlib.suppress(BlockingIOError):
                        sent += connection.send(frame[sent % frame_bytes :])
                if readable:
                    acknowledged = acknowledged + _received(connection)
                    whole = len(acknowledged) // _ARRIVED.size * _ARRIVED.size
                    if whole:
                        arrived = min(sent, _ARRIVED.unpack_from(acknowledged, whole - _ARRIVED.size)[0])
                        acknowledged = acknowledged[whole:]
                now_s = time.monotonic()
    except OSError as error:
        raise AgentError(
            f"The peer does not take bytes on port {port} ({error.strerror or error}): start there "
            "`robot-agent doctor --sink --listen 0.0.0.0`, and let its firewall pass that port."
        ) from error
    if arrived == 0:
        raise AgentError(f"Whatever listens on the peer's port {port} is no `robot-agent doctor --sink`.")
    return arrived * 8 / 1e6 / (now_s - begun_s)


def _received(connection: socket.socket) -> bytes:
    data = connection.recv(_CHUNK_BYTES)
    if not data:
        raise ConnectionError("it closed the connection")
    return data


def open_sink(host: str, port: int) -> socket.socket:
    """The sink's listening socket. Raises AgentError when it cannot be had."""
    try:
        return socket.create_server((host, port))
    except OSError as error:
        raise AgentError(
            f"Port {port} on {host} cannot be opened ({error.strerror}): choose another with --port."
        ) from error


def serve_sink(
    listening: socket.socket, allow: AllowList, stopped: Callable[[], bool], tell: Callable[[str], None]
) -> None:
    """Take bytes and count them, one connection at a time, until `stopped`."""
    while not stopped():
        if not select.select([listening], [], [], 0.1)[0]:
            continue
        connection, address = listening.accept()
        with connection:
            if allow.permits(address[0]):
                total, took_s = _count(connection, stopped)
                tell(f"{total * 8 / 1e6 / max(took_s, 1e-3):.0f} Mbit/s from {address[0]}")


def _count(connection: socket.socket, stopped: Callable[[], bool]) -> tuple[int, float]:
    """Bytes and seconds of one measurement; it ends when the other end does, and is bounded in time."""
    total, begun_s = 0, time.monotonic()
    connection.settimeout(SINK_IDLE_S)
    with contextlib.suppress(OSError):
        while not stopped() and time.monotonic() < begun_s + SINK_LONGEST_S:
            data = connection.recv(_CHUNK_BYTES)
            if not data:
                break
            total += len(data)
            connection.sendall(_ARRIVED.pack(total))
    return total, time.monotonic() - begun_s


@contextlib.contextmanager
def _own_sink() -> Iterator[int]:
    """The port of a sink of this process's own, for as long as the context lasts."""
    closing = threading.Event()
    with open_sink("127.0.0.1", 0) as listening:
        arguments = (listening, AllowList(), closing.is_set, lambda text: None)
        thread = threading.Thread(target=serve_sink, args=arguments, name="sink", daemon=True)
        thread.start()
        try:
            yield int(listening.getsockname()[1])
        finally:
            closing.set()
            thread.join()
