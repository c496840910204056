"""The link to one robot: keeps connecting, hands out the newest frame, takes commands, and says how it stands.

A thread receives; the station's loop asks for `next_frame`. Frames that the loop has no time for are passed over:
the newest wins. When the robot goes away the link says so and tries again until it is back.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import zmq

from base_station.announcer import Announcer
from base_station.errors import StationError
from base_station.frame_clock import FrameClock
from base_station.geometry import FlatPose
from base_station.head import Angles, HeadAngles
from base_station.odometry import WheelOdometry
from base_station.rows import Rows
from base_station.session import LinkSettings, Session, open_known, open_plain
from base_station.sockets import Control, ControlLine, LinkLost, TelemetryFeed, UnknownHost
from base_station.types import Frame
from protocol import (
    Command,
    FrameFormat,
    Hello,
    ProtocolError,
    Reply,
    Request,
    ScenarioEvent,
    Telemetry,
)

log = logging.getLogger(__name__)

RETRY_S = 0.25
BUSY_PATIENCE_S = 1.5
"""A robot just left by another station may take this long to notice."""


@dataclass(frozen=True, eq=False)
class _Arrival:
    """One frame as it came."""

    session: Session
    number: int
    data: bytearray
    format: FrameFormat
    arrival_s: float


class Link:
    """Use as a context manager. `on_telemetry` is called from a thread of the link with every message."""

    def __init__(
        self, settings: LinkSettings | None = None, *, on_telemetry: Callable[[Telemetry], None] | None = None
    ) -> None:
        self.settings = settings or LinkSettings()
        self.hello: Hello | None = None
        """What the robot last said of itself; None for a peer with the raw ports only."""
        self.telemetry: Telemetry | None = None
        self.state = "connecting"
        """In words: how the link stands."""
        self.connections = 0
        self.ended = False
        """The robot replays a recording and has come to its end."""
        self.events: tuple[ScenarioEvent, ...] = ()
        """The simulated operator's events for this connection."""
        self._on_telemetry = on_telemetry
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._control = Control(self._context, self.settings.host, self.settings.port + 3)
        self._announcer: Announcer | None = None
        self._feed: TelemetryFeed | None = None
        self._session: Session | None = None
        self._clock = FrameClock()
        self._angles = HeadAngles()
        self._odometry = WheelOdometry()
        self._fresh = threading.Condition()
        self._newest: _Arrival | None = None
        self._failure: StationError | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)

    def __enter__(self) -> Link:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        if self._announcer is not None:
            self._announcer.close()
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
            arrival, self._newest = self._newest, None
        session, sent = arrival.session, arrival.format
        image = np.frombuffer(arrival.data, np.uint8).reshape(sent.height, sent.width)
        image.flags.writeable = False
        frame = Frame(
            image=image,
            first_row=sent.first_row - session.format.first_row,
            full_height=session.format.height,
            number=arrival.number,
            time_s=self._clock.time_s((session.raw.address, arrival.number), arrival.arrival_s),
            camera=session.camera,
            connection=session.raw.address,
            stepped=session.stepped,
        )
        return frame, arrival.arrival_s

    def want_rows(self, rows: Rows | None, connection: str) -> None:
        """The rows that are needed from now on, counted in whole frames; None: all. Returns at once; later frames have
        them, and `Frame.first_row` tells which do. Does nothing where the robot sends whole frames only."""
        session = self._session
        if session is not None and session.rows is not None and session.raw.address == connection:
            session.rows.want(rows)

    def send(self, command: Command, connection: str | None = None) -> float | None:
        """Send wheel speeds; returns when they were handed to the socket, None when that could not be.

        `connection`: the one whose frame is answered; when it is over, the answer goes nowhere.
        """
        session = self._session
        if session is None or connection not in (None, session.raw.address):
            return None
        try:
            return session.raw.send(Command.clamped(command.left, command.right, lowest=session.lowest_unit))
        except LinkLost as error:
            log.debug("%s", error)  # the receiving thread meets the same end and says so
            return None

    def ask(self, request: Request) -> Reply | None:
        """Ask the agent on its control port. None when nobody listens there. Raises LinkLost, ProtocolError."""
        return self._control.ask(request)

    def control_line(self) -> ControlLine:
        """A connection to the control port of one's own, so that an emergency stop never queues behind what is asked
        there. Close it before the link ends."""
        return ControlLine(self._context, self.settings.host, self.settings.port + 3)

    def camera_angles(self, frame: Frame) -> Angles | None:
        """Pan and tilt of the camera when the frame was taken; None when it is fixed, or nothing is known."""
        return self._angles.of((frame.connection, frame.number))

    def driven(self, frame: Frame) -> FlatPose | None:
        """Where the wheels say that the robot is, from where it was in the first message; None when they measure
        nothing."""
        return self._odometry.of((frame.connection, frame.number))

    def show(self, sight: str, connection: str) -> None:
        """Let the robot's lights, where it has any, tell what is seen (one of SIGHTS). Returns at once."""
        if self.hello is None or "show" not in self.hello.capabilities:
            return
        if self._announcer is None:
            self._announcer = Announcer(self.control_line())
        self._announcer.say(sight, connection)

    @property
    def connected(self) -> bool:
        """Whether frames can come and commands go now."""
        return self._session is not None

    # -- the receiving thread --------------------------------------------------------------------------------------

    def _run(self) -> None:
        failure: StationError | None = None
        try:
            while not self._closing.is_set() and not self.ended:
                self._connect_and_receive()
                self._closing.wait(RETRY_S)
        except StationError as error:
            failure = error
        except Exception as error:
            self._fail(error)
            return
        self._end(failure)

    def _fail(self, error: Exception) -> None:
        """A thread of the link met what nobody foresaw: the loop is told, and the run ends."""
        log.exception("the link failed")
        self._end(StationError(f"The link failed ({type(error).__name__}: {error})."))

    def _end(self, failure: StationError | None) -> None:
        with self._fresh:
            self._failure = self._failure or failure
            self._fresh.notify_all()

    def _connect_and_receive(self) -> None:
        try:
            session = self._open()
        except UnknownHost as error:
            if not self.connections:
                raise StationError(f"Cannot find the robot: {error}. Check --host.", usage=True) from error
            self._say(f"waiting for the robot: {error}")
            return
        except LinkLost as error:
            self._say(f"waiting for the robot: {error}")
            return
        except ProtocolError as error:
            raise StationError(f"The robot at {self.settings.host} answers, but not as it should: {error}") from error
        try:
            self.connections += 1
            self._session = session
            self._say(f"connected to {self.settings.host}:{self.settings.port}, frames {session.format}")
            while not self._closing.is_set():
                self._receive(session)
        except LinkLost as error:
            self._say("the recording has come to its end" if self.ended else f"lost the robot: {error}")
        finally:
            self._session = None
            session.raw.close()
            if session.rows is not None:
                session.rows.close()
            if not self.ended:  # the last pictures of a recording are still wanted, those of a lost robot are not
                self._offer_nothing()

    def _receive(self, session: Session) -> None:
        """A frame, and between two frames the question for other rows.

        It must not keep a frame from the loop, except in lockstep: there the robot waits for the answer to this frame,
        and asked now it always changes the rows in the next one, so that runs can be repeated.
        """
        received = session.raw.receive(0.1)
        if received is None:
            return
        arrival = _Arrival(session, session.raw.frames_received, *received)
        if session.rows is None:
            self._offer(arrival)
            return
        session.rows.check(arrival.number, arrival.format)
        if session.stepped:
            session.rows.act(session.raw)
            self._offer(arrival)
        else:
            self._offer(arrival)
            session.rows.act(session.raw)

    def _open(self) -> Session:
        """Ask who is there, and connect accordingly. Raises LinkLost, StationError, ProtocolError."""
        hello = self._ask_hello()
        if hello is None:
            if self.hello is not None:
                raise LinkLost("its control port does not answer yet")
            session = open_plain(self.settings, self._control)
            self._clock.begin()
            self.events = ()
            return session
        self.hello = hello
        self.events = hello.scenario.events if hello.scenario is not None else ()
        if self._feed is None:
            self._feed = TelemetryFeed(
                self._context, self.settings.host, self.settings.port + 2, self._take_telemetry, self._fail
            )
        live = self._feed.wait_until_live(1.0)
        if not live:
            log.warning("no telemetry on port %d: frames carry arrival times", self.settings.port + 2)
        stepped = hello.rhythm == "lockstep"
        self._clock.begin(
            stepped_period_s=1.0 / hello.fps if stepped and live else None,
            wait_s=self.settings.lockstep_wait_s if stepped and live else 0.0,
        )
        return open_known(self.settings, hello, self.control_line)

    def _ask_hello(self) -> Hello | None:
        deadline_s = time.monotonic() + BUSY_PATIENCE_S
        while True:
            reply = self.ask(Request(action="hello"))
            hello = reply.hello if reply is not None else None
            if hello is None or hello.busy_with is None:
                return hello
            if time.monotonic() > deadline_s or self._closing.is_set():
                if self.connections:
                    raise LinkLost(f"the robot is busy with {hello.busy_with}")
                raise StationError(
                    f"The robot at {self.settings.host}:{self.settings.port} is busy with the station "
                    f"{hello.busy_with}: end that one first."
                )
            self._closing.wait(RETRY_S)

    def _offer(self, arrival: _Arrival) -> None:
        with self._fresh:
            self._newest = arrival
            self._fresh.notify()

    def _offer_nothing(self) -> None:
        with self._fresh:
            self._newest = None

    def _take_telemetry(self, telemetry: Telemetry) -> None:
        self.telemetry = telemetry
        if self.hello is not None:
            self._odometry.note(telemetry, self.hello.limits)
        stamp = telemetry.frame
        if stamp is not None and telemetry.station is not None:
            self._angles.note(telemetry.station, stamp)  # first: in lockstep the loop waits for the time only
            session = self._session
            if session is not None and session.rows is not None and session.raw.address == telemetry.station:
                session.rows.note(stamp.number, stamp.rows)
            self._clock.note((telemetry.station, stamp.number), stamp.capture_s)
        self.ended = self.ended or telemetry.ended
        if self._on_telemetry is not None:
            self._on_telemetry(telemetry)

    def _say(self, text: str) -> None:
        if text != self.state:
            self.state = text
            log.info("%s", text)
