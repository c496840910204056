"""The link to one robot: keeps connecting, hands out the newest frame, takes commands, and says how it stands.

A thread receives; the station's loop asks for `next_frame`. Frames that the loop has no time for are counted and passed
over: the newest wins. When the robot goes away the link says so and tries again until it is back.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import zmq

from base_station.errors import StationError
from base_station.frame_clock import FrameClock
from base_station.geometry import PinholeCamera
from base_station.sockets import Control, LinkLost, RawConnection, TelemetryFeed
from base_station.types import Frame
from protocol import Command, FrameFormat, Hello, ProtocolError, Reply, Request, ScenarioEvent, Telemetry

log = logging.getLogger(__name__)

RETRY_S = 0.25
BUSY_PATIENCE_S = 1.5
"""A robot just left by another station may take this long to notice."""


@dataclass(frozen=True, kw_only=True)
class LinkSettings:
    """Where the robot is, and what to assume when it cannot say (a peer with the raw ports only)."""

    host: str = "127.0.0.1"
    port: int = 31440
    width: int = 640
    height: int = 480
    signed_peer: bool = False
    """A peer without hello reads signed bytes; else commands to it are clamped to 0..127."""
    lockstep_wait_s: float = 2.0
    """In lockstep, how long a frame waits for its telemetry."""


class Link:
    """Use as a context manager. `on_telemetry` is called from a thread of the link with every message."""

    def __init__(
        self, settings: LinkSettings | None = None, *, on_telemetry: Callable[[Telemetry], None] | None = None
    ) -> None:
        self.settings = settings or LinkSettings()
        self.hello: Hello | None = None
        """What the robot said of itself; None for a peer with the raw ports only."""
        self.telemetry: Telemetry | None = None
        self.state = "connecting"
        """In words: how the link stands."""
        self.connections = 0
        self.skipped = 0
        """Frames that came and were replaced by newer ones before the loop asked."""
        self.ended = False
        """The robot replays a recording and has come to its end."""
        self.events: tuple[ScenarioEvent, ...] = ()
        """The simulated operator's events for this connection."""
        self._on_telemetry = on_telemetry
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._control = Control(self._context, self.settings.host, self.settings.port + 3)
        self._feed: TelemetryFeed | None = None
        self._raw: RawConnection | None = None
        self._assume()
        self._fresh = threading.Condition()
        self._newest: tuple[str, int, bytearray, float] | None = None
        self._failure: StationError | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)

    def __enter__(self) -> Link:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        if self._feed is not None:
            self._feed.close()
        self._context.destroy(linger=0)

    # -- the loop's side -------------------------------------------------------------------------------------------

    def next_frame(self, timeout_s: float) -> tuple[Frame, float] | None:
        """The newest frame not handed out yet, and when its last byte came (monotonic s). None when none came in time.

        Raises StationError when the link gave up for good.
        """
        with self._fresh:
            self._fresh.wait_for(lambda: self._newest is not None or self._failure is not None, timeout_s)
            if self._failure is not None:
                raise self._failure
            if self._newest is None:
                return None
            (connection, number, data, arrival_s), self._newest = self._newest, None
        time_s = self._clock.time_s((connection, number), arrival_s)
        image = np.frombuffer(data, np.uint8).reshape(self._format.height, self._format.width)
        image.flags.writeable = False
        frame = Frame(image=image, number=number, time_s=time_s, camera=self._camera, connection=connection)
        return frame, arrival_s

    def send(self, command: Command) -> float | None:
        """Send wheel speeds; returns when they were handed to the socket, None while there is no connection."""
        raw = self._raw
        if raw is None:
            return None
        if self.hello is None and not self.settings.signed_peer:
            command = Command.clamped(command.left, command.right, lowest=0)
        try:
            return raw.send(command)
        except LinkLost as error:
            log.debug("%s", error)  # the receiving thread meets the same end and says so
            return None

    def ask(self, request: Request) -> Reply | None:
        """Ask the agent on its control port. None when nobody answers there. Raises ProtocolError."""
        return self._control.ask(request)

    @property
    def connected(self) -> bool:
        """Whether frames can come and commands go now."""
        return self._raw is not None

    @property
    def uses_capture_times(self) -> bool:
        """Whether frames carry the time they were taken; else the time they arrived."""
        return self._clock.uses_capture_times

    # -- the receiving thread --------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            while not self._closing.is_set() and not self.ended:
                self._connect_and_receive()
                self._closing.wait(RETRY_S)
        except StationError as error:
            with self._fresh:
                self._failure = error
                self._fresh.notify_all()

    def _connect_and_receive(self) -> None:
        try:
            self._introduce()
            raw = RawConnection(self.settings.host, self.settings.port, self._format)
        except LinkLost as error:
            self._say(f"waiting for the robot: {error}")
            return
        except ProtocolError as error:
            raise StationError(f"The robot at {self.settings.host} answers, but not as it should: {error}") from error
        try:
            self.connections += 1
            self._raw = raw
            self._say(f"connected to {self.settings.host}:{self.settings.port}, frames {self._format}")
            while not self._closing.is_set():
                received = raw.receive(0.1)
                if received is not None:
                    self._offer(raw, *received)
        except LinkLost as error:
            self._say(f"lost the robot: {error}")
        finally:
            self._raw = None
            raw.close()

    def _introduce(self) -> None:
        """Ask who is there, and prepare frame format, camera and clock accordingly. Raises LinkLost, StationError."""
        hello = self._ask_hello()
        self.hello = hello
        if hello is None:
            self._assume()
            return
        self._format = hello.format
        self._camera = _camera_of(hello)
        self.events = hello.scenario.events if hello.scenario is not None else ()
        if self._feed is None:
            self._feed = TelemetryFeed(self._context, self.settings.host, self.settings.port + 2, self._take_telemetry)
        live = self._feed.wait_until_live(1.0)
        stepped = hello.rhythm == "lockstep"
        self._clock = FrameClock(stepped=stepped, wait_s=self.settings.lockstep_wait_s if stepped and live else 0.0)

    def _ask_hello(self) -> Hello | None:
        deadline_s = time.monotonic() + BUSY_PATIENCE_S
        while True:
            reply = self.ask(Request(action="hello"))
            hello = reply.hello if reply is not None else None
            if hello is None or hello.busy_with is None:
                return hello
            if time.monotonic() > deadline_s:
                busy = f"the robot is busy with {hello.busy_with}"
                if self.connections:
                    raise LinkLost(busy)
                raise StationError(
                    f"The robot at {self.settings.host}:{self.settings.port} is busy with the station "
                    f"{hello.busy_with}: end that one first."
                )
            self._closing.wait(RETRY_S)

    def _assume(self) -> None:
        """Nobody answers hello: take the stream for what the settings say."""
        self._format = FrameFormat(width=self.settings.width, height=self.settings.height)
        self._camera = PinholeCamera.with_fov(self.settings.width, self.settings.height)
        self._clock = FrameClock()
        self.events = ()

    def assumptions(self) -> str:
        """What is assumed of a peer without hello, in words; empty when it said hello."""
        if self.hello is not None:
            return ""
        signs = "signed" if self.settings.signed_peer else "cut to 0..127 (--signed-peer if it reads them signed)"
        return (
            f"No hello on port {self.settings.port + 3}: a peer with the raw ports only. Assuming frames of "
            f"{self._format} (--width, --height), arrival times, commands {signs}."
        )

    def _offer(self, raw: RawConnection, data: bytearray, arrival_s: float) -> None:
        with self._fresh:
            self.skipped += self._newest is not None
            self._newest = (raw.address, raw.frames_received, data, arrival_s)
            self._fresh.notify()

    def _take_telemetry(self, telemetry: Telemetry) -> None:
        self.telemetry = telemetry
        stamp = telemetry.frame
        if stamp is not None and telemetry.station is not None:
            self._clock.note((telemetry.station, stamp.number), stamp.capture_s)
        self.ended = self.ended or telemetry.ended
        if self._on_telemetry is not None:
            self._on_telemetry(telemetry)

    def _say(self, text: str) -> None:
        if text != self.state:
            self.state = text
            log.info("%s", text)
            if text.startswith("connected") and self.hello is None:
                log.warning("%s", self.assumptions())


def _camera_of(hello: Hello) -> PinholeCamera:
    known = hello.intrinsics
    if known is None:
        return PinholeCamera.with_fov(
            hello.width, hello.height, first_row=hello.first_row, full_height=hello.full_height
        )
    return PinholeCamera(width=hello.width, height=hello.height, fx=known.fx, fy=known.fy, cx=known.cx, cy=known.cy)
