"""The agent: camera to station, station to wheels, with the safety supervisor between.

Threads, each with one task: `frames` reads the camera and, in lockstep, also awaits the command; `sender` writes the
newest frame (free rhythm); `commands` reads commands (free rhythm); `safety` decides a hundred times a second and after
every command; `outlet` publishes telemetry and answers requests. What they share is small and behind one lock.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

import numpy as np

from protocol import (
    FRAME_PORT,
    PROTOCOL_VERSION,
    SIGHTS,
    FrameFormat,
    FrameStamp,
    Hello,
    Intrinsics,
    ProtocolError,
    Reply,
    Request,
    Scenario,
    ScenarioEvent,
    Telemetry,
    Truth,
)
from robot_agent import __version__
from robot_agent.access import AllowList
from robot_agent.bands import Bands
from robot_agent.cameras.base import Camera, CameraFrame
from robot_agent.errors import AgentError, CameraError, EndOfRecording, PanTiltError, UsageError
from robot_agent.outlet import Outlet
from robot_agent.pantilt.base import PanTilt
from robot_agent.ports import CommandReader, FrameWriter, Peer, StationPort
from robot_agent.robots.base import Robot
from robot_agent.safety import SafetySettings, SafetySupervisor
from robot_agent.wheels import Wheels

log = logging.getLogger(__name__)

SAFETY_PERIOD_S = 0.01
PEER_CHECK_S = 0.2
WAIT_S = 0.1
"""How long a thread waits before it looks whether the agent is to end."""
FLUSH_S = 0.5
"""At the end of a recording its last picture has this long to leave."""
ROUNDING_RAD = 1e-6
"""A station may ask for a limit itself, rounded."""


@dataclass(frozen=True, kw_only=True)
class AgentSettings:
    """How the agent serves. Ports are `port` (frames) and the three after it."""

    host: str = "127.0.0.1"
    port: int = FRAME_PORT
    allow: tuple[str, ...] = ()
    """Networks from which stations may connect; empty: all that reach `host`."""
    rhythm: str = "free"
    """"free": the newest frame goes out, commands come when they come. "lockstep": one frame, one command (the
    thesis)."""
    rows: tuple[int, int] | None = None
    """Send only these rows of the picture, first and past-last."""
    speed_scale: float = 1.0
    """Motor units per wire unit."""
    safety: SafetySettings = field(default_factory=SafetySettings)


class Agent:
    """Serves one station at a time with one camera, on a pan-tilt or fixed, and one robot.

    `clock` is what safety measures time with: the monotonic clock, or in a simulation that goes step by step the
    simulated time (`stepped`: then nothing changes between two commands, and no ticking is needed).
    Raises AgentError when a port cannot be opened or the rows do not lie in the picture.
    """

    def __init__(
        self,
        camera: Camera,
        robot: Robot,
        settings: AgentSettings | None = None,
        *,
        pan_tilt: PanTilt | None = None,
        scenario: Scenario | None = None,
        clock: Callable[[], float] = time.monotonic,
        stepped: bool = False,
    ) -> None:
        self._settings = settings or AgentSettings()
        self._camera, self._robot, self._pan_tilt = camera, robot, pan_tilt
        self._clock, self._stepped = clock, stepped
        self._scenario = scenario
        self._format = _frame_format(camera, self._settings.rows)
        self._bands = Bands(self._format)
        self._supervisor = SafetySupervisor(_safety_for(camera, robot, self._settings.safety))
        self._lock = threading.Lock()
        self._stamp: FrameStamp | None = None
        self._truth: Truth | None = None
        self._sequence = 0
        self._ended = False
        self._asked_to_stop = False
        self._stopping = threading.Event()
        self._failure: AgentError | None = None
        self._fresh = threading.Condition()
        self._newest: CameraFrame | None = None
        self._replaced = 0
        self._sending = False
        self._picture_s = time.monotonic()

        allow = AllowList(self._settings.allow)
        host, port = self._settings.host, self._settings.port
        with ExitStack() as opened:
            self._outlet = Outlet(host, port + 2, port + 3, allow=allow, answer=self._answer, report=self._telemetry)
            opened.callback(self._outlet.close)
            self._frame_port = StationPort(
                "frames",
                host,
                port,
                allow=allow,
                on_change=self._link_changed,
                partner_host=lambda: _host_of(self._command_port),
            )
            opened.callback(self._frame_port.close)
            self._command_port = StationPort(
                "commands",
                host,
                port + 1,
                allow=allow,
                on_change=self._link_changed,
                partner_host=lambda: _host_of(self._frame_port),
            )
            opened.callback(self._command_port.close)
            self._wheels = Wheels(
                robot,
                self._supervisor,
                frame_port=self._frame_port,
                command_port=self._command_port,
                speed_scale=self._settings.speed_scale,
                clock=clock,
                on_change=self._outlet.publish,
            )
            self._close_ports = opened.pop_all().close
        self._writer = FrameWriter(self._frame_port, lambda: not self._stopping.is_set())
        self._reader = CommandReader(self._command_port)

    # -- life ------------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Serve until `stop`, the end of a recording or a failure; then stop the wheels and let go of everything.

        Raises AgentError when camera or robot failed.
        """
        free = self._settings.rhythm == "free"
        tasks = {"frames": self._read_camera if free else self._serve_lockstep}
        if free:
            tasks |= {"sender": self._send_frames, "commands": self._read_commands}
        if not self._stepped:
            tasks["safety"] = self._watch
        threads = [
            threading.Thread(target=self._guard, args=(task,), name=name, daemon=True) for name, task in tasks.items()
        ]
        self._outlet.start()
        self._frame_port.start()
        self._command_port.start()
        for thread in threads:
            thread.start()
        try:
            while not (self._asked_to_stop or self._stopping.wait(PEER_CHECK_S)):
                self._look_around()
        finally:
            self._shut_down(threads)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Ask the agent to end; returns at once. Safe in a signal handler: it takes no lock."""
        self._asked_to_stop = True

    def _look_around(self) -> None:
        """What no thread notices by itself: stations that went silently, a robot that failed."""
        self._frame_port.drop_if_gone()
        self._command_port.drop_if_gone()
        if self._wheels.robot_failure:
            self._fail(AgentError(f"Stopped: {self._wheels.robot_failure}."))

    def _guard(self, task: Callable[[], None]) -> None:
        """Run a thread's task; whatever ends it unexpectedly stops the wheels first, then the agent."""
        try:
            task()
        except EndOfRecording:
            self._end_of_recording()
        except AgentError as error:
            self._fail(error)
        except Exception as error:
            log.exception("the agent failed")
            self._fail(AgentError(f"The agent failed ({type(error).__name__}: {error}); the wheels were stopped."))

    def _fail(self, error: AgentError) -> None:
        self._failure = self._failure or error
        self._stopping.set()
        self._wheels.forbid(str(error))

    def _end_of_recording(self) -> None:
        log.info("the recording has come to its end")
        deadline_s = time.monotonic() + FLUSH_S
        while (self._newest is not None or self._sending) and self._frame_port.peer and time.monotonic() < deadline_s:
            self._stopping.wait(0.005)
        self._ended = True
        self._wheels.forbid("the recording has come to its end")
        self._stopping.set()

    def _shut_down(self, threads: list[threading.Thread]) -> None:
        """Stop the wheels, then let go of everything, whatever fails on the way."""
        self._stopping.set()
        with ExitStack() as closing:  # the last one named is the first one called
            closing.callback(self._camera.close)
            if self._pan_tilt is not None:
                closing.callback(self._pan_tilt.close)
            closing.callback(self._robot.close)
            closing.callback(self._close_ports)
            for thread in threads:
                closing.callback(thread.join, 2.0)  # daemons: a camera that never returns does not keep the process
            closing.callback(self._outlet.publish)
            closing.callback(self._wheels.forbid, "the agent ends")

    # -- camera and frames -----------------------------------------------------------------------------------------

    def _next_picture(self) -> CameraFrame | None:
        """A picture from the camera, or None for now; keeps the time of the newest one for the supervisor."""
        picture = self._camera.read(WAIT_S)
        if picture is None:
            self._suspect_camera()
            return None
        if picture.image.shape != (self._format.full_height, self._format.width):
            size = "x".join(map(str, picture.image.shape[::-1]))
            raise CameraError(f"The camera changed its picture to {size}: start the agent again.")
        self._picture_s = time.monotonic()
        self._wheels.picture_came()
        if self._stepped:
            self._wheels.decide()  # nobody else asks while simulated time stands
        return picture

    def _suspect_camera(self) -> None:
        """A simulated clock that stands with its camera cannot tell that the camera hangs; the wall's can."""
        silent_s = time.monotonic() - self._picture_s
        if self._stepped and silent_s > self._supervisor.settings.frame_timeout_s:
            self._wheels.camera_is_silent(f"the camera hangs: no picture for {silent_s * 1000:.0f} ms")

    def _read_camera(self) -> None:
        while not self._stopping.is_set():
            picture = self._next_picture()
            if picture is None:
                continue
            with self._fresh:
                self._replaced += self._newest is not None
                self._newest = picture
                self._fresh.notify()

    def _take_newest(self) -> tuple[CameraFrame | None, int]:
        """The newest picture not yet taken, and how many were replaced before it was."""
        with self._fresh:
            self._fresh.wait_for(lambda: self._newest is not None, WAIT_S)
            taken, replaced = self._newest, self._replaced
            self._newest, self._replaced = None, 0
            self._sending = taken is not None
            return taken, replaced

    def _send_frames(self) -> None:
        served: Peer | None = None
        while not self._stopping.is_set():
            picture, replaced = self._take_newest()
            peer = self._frame_port.peer
            if picture is not None and peer is not None:
                if peer is not served:
                    served, replaced = peer, 0
                elif not self._writer.ready(peer):
                    self._put_back(picture, replaced)
                    continue
                rows = self._stamp_frame(peer, picture, replaced)
                self._writer.write(peer, _pixels(picture, rows))
            self._sending = False

    def _put_back(self, picture: CameraFrame, replaced: int) -> None:
        """The station is still busy with the frame before: keep this one unless a newer comes, and look again soon."""
        with self._fresh:
            self._replaced += replaced
            if self._newest is None:
                self._newest = picture
            else:
                self._replaced += 1
        self._stopping.wait(0.001)

    def _stamp_frame(self, peer: Peer, picture: CameraFrame, replaced: int) -> FrameFormat:
        """Number the frame and publish its telemetry, so that the station has it before the last byte. Returns what of
        the picture goes out under this number."""
        pan_tilt = self._pan_tilt
        pan_rad, tilt_rad = (None, None) if pan_tilt is None else pan_tilt.angles_at(picture.capture_s)
        with self._lock:
            before = self._stamp
            if before is None or before.connection != peer.number:
                before = FrameStamp(connection=peer.number, number=0, capture_s=0.0, dropped=0)
            sent = self._bands.of(peer.number)
            self._stamp = replace(
                before,
                number=before.number + 1,
                capture_s=picture.capture_s,
                dropped=before.dropped + replaced,
                pan_rad=pan_rad,
                tilt_rad=tilt_rad,
                rows=sent.rows if sent is not self._format else None,
            )
            self._truth = picture.truth
        self._outlet.publish()
        return sent

    # -- commands --------------------------------------------------------------------------------------------------

    def _read_commands(self) -> None:
        while not self._stopping.is_set():
            received = self._reader.read(WAIT_S)
            if received is not None:
                self._wheels.take_command(*received)

    def _serve_lockstep(self) -> None:
        """One frame, then one command, as listing A.1; begins when both ports are connected."""
        while not self._stopping.is_set():
            watcher, commander = self._frame_port.wait_for_peer(WAIT_S), self._command_port.wait_for_peer(WAIT_S)
            if watcher is None or commander is None:
                self._picture_s = time.monotonic()
                continue
            picture = self._next_picture()
            if picture is None or self._frame_port.peer is not watcher:
                continue
            rows = self._stamp_frame(watcher, picture, 0)
            if self._writer.write(watcher, _pixels(picture, rows)):
                self._await_command(watcher)

    def _await_command(self, watcher: Peer) -> None:
        with self._wheels.awaiting_command():
            while not self._stopping.is_set() and self._frame_port.peer is watcher and self._command_port.peer:
                received = self._reader.read(WAIT_S, one=True)
                if received is not None:
                    self._wheels.take_command(*received)
                    return

    # -- safety ----------------------------------------------------------------------------------------------------

    def _watch(self) -> None:
        while not self._stopping.wait(SAFETY_PERIOD_S):
            self._wheels.decide()

    def _link_changed(self) -> None:
        """A station came or went."""
        if self._frame_port.peer is not None:
            self._camera.begin()
        self._wheels.decide()

    # -- hello, control, telemetry ---------------------------------------------------------------------------------

    def _answer(self, request: Request) -> Reply:
        if request.action == "hello":
            return Reply(ok=True, hello=self._hello())
        if request.action == "exposure":
            return self._set_exposure(request.value)
        if request.action == "look":
            return self._look(request.pan_rad, request.tilt_rad)
        if request.action == "show":
            return self._show(request.text)
        if request.action == "rows":
            return self._send_rows(request.rows, request.station)
        if request.action == "stop":
            self._supervisor.emergency_stop(request.text)
        else:
            self._supervisor.release()
            log.warning("emergency stop released")
        self._wheels.decide()
        return Reply(ok=True)

    def _show(self, what: str) -> Reply:
        if what not in SIGHTS:
            return Reply(ok=False, error=f"a station sees one of {', '.join(SIGHTS)}, not {what[:40]!r}")
        if not hasattr(self._robot, "show"):
            return Reply(ok=False, error="this robot has no lights")
        self._wheels.station_sees(what)
        return Reply(ok=True)

    def _send_rows(self, rows: tuple[int, int] | None, station: str) -> Reply:
        """From the next frame on; its number, decided together with the frames' own, tells the station where its
        stream changes."""
        with self._lock:
            peer = self._frame_port.peer
            if peer is None or peer.address != station:
                return Reply(ok=False, error="only the station that gets the frames can choose their rows")
            try:
                self._bands.choose(rows, peer.number)
            except ProtocolError as error:
                return Reply(ok=False, error=str(error))
            begun = self._stamp is not None and self._stamp.connection == peer.number
            return Reply(ok=True, frame=1 + (self._stamp.number if begun and self._stamp is not None else 0))

    def _set_exposure(self, exposure_us: float) -> Reply:
        set_exposure = getattr(self._camera, "set_exposure", None)
        if set_exposure is None:
            return Reply(ok=False, error="this camera's exposure cannot be set")
        set_exposure(exposure_us)
        return Reply(ok=True)

    def _look(self, pan_rad: float, tilt_rad: float) -> Reply:
        if self._pan_tilt is None:
            return Reply(ok=False, error="this robot has no pan-tilt")
        limits = self._pan_tilt.limits
        if math.dist((pan_rad, tilt_rad), limits.clamped(pan_rad, tilt_rad)) > ROUNDING_RAD:
            (right, left), (low, high) = limits.pan_rad, limits.tilt_rad
            return Reply(
                ok=False,
                error=f"pan {pan_rad:.3f}, tilt {tilt_rad:.3f} rad is out of reach: pan goes from {right:.3f} to "
                f"{left:.3f}, tilt from {low:.3f} to {high:.3f}",
            )
        try:
            self._pan_tilt.look(pan_rad, tilt_rad)
        except PanTiltError as error:
            return Reply(ok=False, error=str(error))
        return Reply(ok=True)

    def _hello(self) -> Hello:
        scenario = self._scenario
        if scenario is not None and self._frame_port.connections:
            scenario = replace(scenario, events=())  # the operator's hand moves once, for the first station
        if scenario is not None:
            scenario = _shifted_events(scenario, self._format.first_row)
        capabilities = ["stop", "rows"]
        capabilities += ["exposure"] if hasattr(self._camera, "set_exposure") else []
        capabilities += ["pan-tilt"] if self._pan_tilt is not None else []
        capabilities += ["show"] if hasattr(self._robot, "show") else []
        return Hello(
            protocol=PROTOCOL_VERSION,
            agent=f"zservo robot-agent {__version__}",
            width=self._format.width,
            height=self._format.height,
            first_row=self._format.first_row,
            full_height=self._format.full_height,
            fps=self._camera.fps,
            rhythm=self._settings.rhythm,
            robot=self._robot.kind,
            camera=type(self._camera).__name__,
            intrinsics=_shifted(self._camera.intrinsics, self._format.first_row),
            limits=replace(self._robot.limits, speed_scale=self._settings.speed_scale),
            capabilities=tuple(capabilities),
            busy_with=self._station(),
            monotonic_s=self._clock(),
            scenario=scenario,
            pan_tilt=self._pan_tilt.limits if self._pan_tilt is not None else None,
        )

    def _station(self) -> str | None:
        peer = self._frame_port.peer or self._command_port.peer
        return peer.address if peer is not None else None

    def _telemetry(self) -> Telemetry:
        wheels, watcher = self._wheels, self._frame_port.peer
        decision, state = wheels.decision, wheels.robot_state
        with self._lock:
            self._sequence += 1
            current = self._stamp is not None and watcher is not None and self._stamp.connection == watcher.number
            return Telemetry(
                sequence=self._sequence,
                monotonic_s=self._clock(),
                wall_s=time.time(),
                frame=self._stamp if current else None,
                proximity=state.proximity,
                wheels_asked=(decision.left, decision.right),
                wheels_measured=state.wheels_measured,
                battery_v=state.battery_v,
                safety=decision.state.value,
                reason=decision.reason,
                station=self._station(),
                ended=self._ended,
                cpu_s=time.process_time(),
                truth=self._truth if current else None,
            )


def _host_of(port: StationPort) -> str | None:
    return port.peer.host if port.peer is not None else None


def _pixels(picture: CameraFrame, sent: FrameFormat) -> memoryview:
    """The bytes to send: a view of the camera's picture where its memory allows, without a copy."""
    return np.ascontiguousarray(picture.image[slice(*sent.rows)]).data.cast("B")


def _frame_format(camera: Camera, rows: tuple[int, int] | None) -> FrameFormat:
    first, past_last = rows or (0, camera.height)
    if not 0 <= first < past_last <= camera.height:
        raise UsageError(f"--rows {first}:{past_last}: the picture has rows 0:{camera.height}.")
    try:
        return FrameFormat(width=camera.width, height=past_last - first, first_row=first, full_height=camera.height)
    except ProtocolError as error:
        raise UsageError(f"These pictures cannot be sent ({error}): give another size with --size.") from error


def _safety_for(camera: Camera, robot: Robot, settings: SafetySettings) -> SafetySettings:
    """A slow camera hangs only after three of its own periods; the wheels keep to the robot's own limit."""
    return replace(
        settings,
        frame_timeout_s=max(settings.frame_timeout_s, 3.0 / camera.fps),
        limit_units=min(settings.limit_units, robot.limits.max_units),
    )


def _shifted(intrinsics: Intrinsics | None, first_row: int) -> Intrinsics | None:
    """The camera of a band of rows."""
    return None if intrinsics is None else replace(intrinsics, cy=intrinsics.cy - first_row)


def _shifted_events(scenario: Scenario, first_row: int) -> Scenario:
    """The operator's boxes in the band of rows that is sent."""

    def shifted(event: ScenarioEvent) -> ScenarioEvent:
        if event.box is None:
            return event
        x, y, width, height = event.box
        return replace(event, box=(x, y - first_row, width, height))

    return replace(scenario, events=tuple(shifted(event) for event in scenario.events))
