"""For tests with real sockets and real processes: programs that are sure to end, peers that speak the wire, waiting.

Nothing here is a mock: `RawStation` and `RawPeer` are the smallest programs that speak the raw ports.
"""

from __future__ import annotations

import contextlib
import os
import random
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import zmq

from protocol import Command, Hello, Reply, Request, Telemetry, decode_reply, decode_telemetry, encode

ROOT = Path(__file__).resolve().parents[1]
LOOPBACK = "127.0.0.1"

T = TypeVar("T")


def wait_until(condition: Callable[[], T], timeout_s: float, what: str = "the condition") -> T:
    """The condition's value as soon as it is true. Raises AssertionError, naming `what`, when the time is over."""
    deadline_s = time.monotonic() + timeout_s
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > deadline_s:
            raise AssertionError(f"not within {timeout_s} s: {what}")
        time.sleep(0.005)


def free_ports() -> int:
    """The first of four ports in a row that nobody uses, below the range that the kernel hands out itself."""
    while True:
        base = random.randrange(20_000, 32_000, 4)
        with contextlib.ExitStack() as stack:
            try:
                for port in range(base, base + 4):
                    stack.enter_context(socket.socket()).bind((LOOPBACK, port))
            except OSError:
                continue
            return base


class Program:
    """A process of ours in a session of its own, with all that it prints."""

    def __init__(self, arguments: Sequence[str], *, stdin: int = subprocess.DEVNULL, **environment: str) -> None:
        self.process = subprocess.Popen(
            arguments,
            cwd=ROOT,
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "COLUMNS": "250", "PYTHONUNBUFFERED": "1", **environment},
            start_new_session=True,
        )
        self._printed: dict[str, bytearray] = {"stdout": bytearray(), "stderr": bytearray()}
        self._readers = [threading.Thread(target=self._read, args=(name,), daemon=True) for name in self._printed]
        for reader in self._readers:
            reader.start()

    def _read(self, name: str) -> None:
        stream = getattr(self.process, name)
        while data := os.read(stream.fileno(), 65536):
            self._printed[name] += data

    @property
    def stderr(self) -> str:
        return bytes(self._printed["stderr"]).decode(errors="replace")

    @property
    def stdout(self) -> str:
        return bytes(self._printed["stdout"]).decode(errors="replace")

    @property
    def alive(self) -> bool:
        return self.process.poll() is None

    def says(self, text: str, timeout_s: float = 10.0) -> str:
        """Wait until this text was printed on stderr. Fails when it was not, or the process ended without it."""

        def said() -> bool:
            return text in self.stderr or not self.alive

        try:
            wait_until(said, timeout_s)
        except AssertionError:
            raise AssertionError(f"{text!r} was not said within {timeout_s} s, but:\n{self.stderr}") from None
        self._join_readers_if_over()
        assert text in self.stderr, f"{text!r} was not said before the end, but:\n{self.stderr}"
        return self.stderr

    def signal(self, number: int) -> None:
        self.process.send_signal(number)

    def exit_code(self, timeout_s: float = 15.0) -> int:
        """Wait for the end; the exit code. Fails when it does not come, or came with a traceback."""
        try:
            code = self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"still running after {timeout_s} s:\n{self.stderr}") from None
        self._join_readers_if_over()
        assert "Traceback" not in self.stderr, self.stderr
        return code

    def _join_readers_if_over(self) -> None:
        if not self.alive:
            for reader in self._readers:
                reader.join(5.0)

    def orphans(self) -> list[int]:
        """Processes that are left of this program's session after its own end."""
        return [pid for pid in _processes() if pid != self.process.pid and _session(pid) == self.process.pid]

    def kill(self) -> None:
        """End it and everything it started, whatever state it is in."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        for reader in self._readers:
            reader.join(5.0)
        for stream in (self.process.stdin, self.process.stdout, self.process.stderr):
            if stream is not None:
                stream.close()


def _processes() -> list[int]:
    return [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]


def _session(pid: int) -> int | None:
    try:
        return os.getsid(pid)
    except OSError:
        return None


class Programs:
    """Starts agents and stations, and kills what is left of them in `close`."""

    def __init__(self) -> None:
        self._started: list[Program] = []

    def start(self, *arguments: str, stdin: int = subprocess.DEVNULL, **environment: str) -> Program:
        program = Program(arguments, stdin=stdin, **environment)
        self._started.append(program)
        return program

    def agent(self, port: int, *options: str) -> Program:
        """An agent that serves already."""
        agent = self.start(sys.executable, "-m", "robot_agent", "--port", str(port), *options)
        agent.says("serving robot", 20.0)
        return agent

    def sim(self, port: int, *options: str) -> Program:
        """A simulated robot with a small picture, so that the processor has time for the test."""
        return self.agent(port, "--robot", "sim", "--size", "160x120", "--speed-scale", "4", *options)

    def replay(self, port: int, source: Path, *options: str) -> Program:
        """A camera that shows a recording, and no robot."""
        return self.agent(port, "--robot", "none", "--camera", "replay", "--source", str(source), *options)

    def station(self, port: int, *options: str, tracker: str = "phase", stdin: int = subprocess.DEVNULL) -> Program:
        """base-station run. Where the tracker does not matter it is the one that starts soonest."""
        return self.start(
            sys.executable,
            "-m",
            "base_station",
            "run",
            "--port",
            str(port),
            "--tracker",
            tracker,
            *options,
            stdin=stdin,
        )

    def close(self) -> None:
        for program in self._started:
            program.kill()


class TelemetryLog:
    """All telemetry of an agent, as it comes."""

    def __init__(self, port: int) -> None:
        self.messages: list[Telemetry] = []
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.linger = 0
        self._socket.subscribe(b"")
        self._socket.connect(f"tcp://{LOOPBACK}:{port + 2}")
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while not self._closing.is_set():
            if self._socket.poll(50):
                self.messages.append(decode_telemetry(self._socket.recv()))

    def wait_until_live(self) -> TelemetryLog:
        """From here on no message is missed."""
        self.wait_for(lambda message: True, what="anything at all")
        return self

    @property
    def last(self) -> Telemetry | None:
        return self.messages[-1] if self.messages else None

    def wait_for(
        self, condition: Callable[[Telemetry], bool], timeout_s: float = 10.0, *, since_s: float = 0.0, what: str = ""
    ) -> Telemetry:
        """The first message made after `since_s` (the agent's monotonic time) that satisfies the condition."""
        seen = 0

        def found() -> Telemetry | None:
            nonlocal seen
            while seen < len(self.messages):
                message = self.messages[seen]
                seen += 1
                if message.monotonic_s >= since_s and condition(message):
                    return message
            return None

        try:
            message = wait_until(found, timeout_s, what)
        except AssertionError:
            raise AssertionError(f"no telemetry within {timeout_s} s with {what}; the last is {self.last}") from None
        assert message is not None
        return message

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
        self._context.destroy(linger=0)


def driving(message: Telemetry) -> bool:
    """The wheels are asked to turn."""
    return message.wheels_asked != (0, 0)


def standing(message: Telemetry) -> bool:
    """The wheels are asked to stand, and where they are measured they do (5 motor units are 2 mm/s)."""
    measured = message.wheels_measured or (0, 0)
    return message.wheels_asked == (0, 0) and max(map(abs, measured)) <= 5


class Operator:
    """A client of the control port."""

    def __init__(self, port: int, *, source: str | None = None) -> None:
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._context.linger = 0
        via = f"{source}:0;" if source else ""
        self._address = f"tcp://{via}{LOOPBACK}:{port + 3}"

    def send_raw(self, data: bytes | list[bytes], timeout_s: float = 1.0, kind: int = zmq.REQ) -> bytes | None:
        """Send anything; what comes back, if anything does."""
        with self._context.socket(kind) as asking:
            asking.linger = 0
            asking.connect(self._address)
            asking.send_multipart(data if isinstance(data, list) else [data])
            return asking.recv() if asking.poll(int(timeout_s * 1000)) else None

    def ask(self, request: Request, timeout_s: float = 5.0) -> Reply:
        data = self.send_raw(encode(request), timeout_s)
        assert data is not None, f"no reply to {request.action} within {timeout_s} s"
        return decode_reply(data)

    def hello(self) -> Hello:
        hello = self.ask(Request(action="hello")).hello
        assert hello is not None
        return hello

    def close(self) -> None:
        self._context.destroy(linger=0)


class RawStation:
    """A station with the raw ports only, as listing A.2: connects to both, reads whole frames, writes two bytes."""

    def __init__(
        self, port: int, frame_bytes: int, *, source: str | None = None, receive_buffer: int | None = None
    ) -> None:
        self.frame_bytes = frame_bytes
        self.frames = connect(port, source=source, receive_buffer=receive_buffer)
        self.commands = connect(port + 1, source=source)
        self.address = "{}:{}".format(*self.frames.getsockname())

    def read_frame(self, timeout_s: float = 5.0) -> bytes:
        """The next frame. Raises ConnectionError when the agent closed before it was whole."""
        return read_exactly(self.frames, self.frame_bytes, timeout_s)

    def send(self, left: int, right: int) -> None:
        self.commands.sendall(bytes(Command(left, right)))

    def drain(self) -> None:
        """Take what has come, so that more can come, and look at none of it."""
        while select.select([self.frames], [], [], 0)[0] and self.frames.recv(65536):
            pass

    def close(self) -> None:
        self.frames.close()
        self.commands.close()

    def __enter__(self) -> RawStation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def connect(port: int, *, source: str | None = None, receive_buffer: int | None = None) -> socket.socket:
    """A TCP connection to a port on this machine, from the loopback address `source` if given."""
    connection = socket.socket()
    if receive_buffer is not None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
    if source is not None:
        connection.bind((source, 0))
    connection.settimeout(5.0)
    connection.connect((LOOPBACK, port))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def read_exactly(connection: socket.socket, count: int, timeout_s: float = 5.0) -> bytes:
    """Exactly so many bytes. Raises ConnectionError at an early end, AssertionError when they do not come."""
    data = bytearray()
    deadline_s = time.monotonic() + timeout_s
    while len(data) < count:
        left_s = deadline_s - time.monotonic()
        if left_s <= 0 or not select.select([connection], [], [], left_s)[0]:
            raise AssertionError(f"{len(data)} of {count} bytes within {timeout_s} s")
        received = connection.recv(count - len(data))
        if not received:
            raise ConnectionError(f"closed after {len(data)} of {count} bytes")
        data += received
    return bytes(data)


def closed_by_peer(connection: socket.socket, timeout_s: float = 2.0) -> bool:
    """Whether the other side closes this connection within the time, without having sent anything."""
    connection.settimeout(timeout_s)
    try:
        return connection.recv(1) == b""
    except TimeoutError:
        return False
    except ConnectionResetError:
        return True


class RawPeer:
    """A robot with the raw ports only, as listing A.1 (no hello, no telemetry): sends frames, takes commands."""

    def __init__(self, port: int) -> None:
        self._frames = socket.create_server((LOOPBACK, port))
        self._commands = socket.create_server((LOOPBACK, port + 1))

    @contextlib.contextmanager
    def station(self, timeout_s: float = 15.0) -> Iterator[tuple[socket.socket, socket.socket]]:
        """Wait for a station; its frame and its command connection."""
        self._frames.settimeout(timeout_s)
        self._commands.settimeout(timeout_s)
        with self._frames.accept()[0] as frames, self._commands.accept()[0] as commands:
            yield frames, commands

    def close(self) -> None:
        self._frames.close()
        self._commands.close()


def numbered_picture(number: int, width: int = 160, height: int = 120) -> np.ndarray:
    """A picture that tells its number (columns 0 and 1, low and high byte, in every row) in front of a scene that
    moves by a pixel per number. uint8, shape (height, width)."""
    noise = np.random.default_rng(0).uniform(0, 255, (height, width)).astype(np.float32)
    scene = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    picture = np.roll(scene, number, axis=1)
    picture[:, 0], picture[:, 1] = number % 256, number // 256
    return picture


def picture_number(frame: bytes) -> int:
    """The number that a numbered picture tells in its first row."""
    return frame[0] + 256 * frame[1]


def write_pictures(folder: Path, count: int, width: int = 160, height: int = 120) -> Path:
    """A folder with pictures number 1 to `count`, without loss."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(1, count + 1):
        assert cv2.imwrite(str(folder / f"{number:05d}.png"), numbered_picture(number, width, height))
    return folder
