"""The agent: camera to station, station to wheels, with the safety supervisor between.

Threads, each with one task: `frames` reads the camera and, in lockstep, also awaits the command; `sender` writes the
newest frame (free rhythm); `commands` reads commands (free rhythm); `safety` decides a hundred times a second and after
every command; `outlet` publishes telemetry and answers requests. What they share is small and behind one lock.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from protocol import (
    PROTOCOL_VERSION,
    Command,
    FrameFormat,
    FrameStamp,
    Hello,
    Intrinsics,
    ProtocolError,
    Reply,
    Request,
    Scenario,
    Telemetry,
    Truth,
)
from robot_agent import __version__
from robot_agent.access import AllowList
from robot_agent.cameras.base import Camera, CameraFrame
from robot_agent.errors import AgentError, CameraError, EndOfRecording, UsageError
from robot_agent.outlet import Outlet
from robot_agent.ports import CommandReader, FrameWriter, StationPort
from robot_agent.robots.base import Robot
from robot_agent.safety import Decision, LinkState, SafetySettings, SafetyState, SafetySupervisor, WheelCommand

log = logging.getLogger(__name__)

SAFETY_PERIOD_S = 0.01
PEER_CHECK_S = 0.2
WAIT_S = 0.1
"""How long a thread waits before it looks whether the agent is to end."""


@dataclass(frozen=True, kw_only=True)
class AgentSettings:
    """How the agent serves. Ports are `port` (frames) and the three after it."""

    host: str = "127.0.0.1"
    port: int = 31440
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
    """Serves one station at a time with one camera and one robot.

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
        scenario: Scenario | None = None,
        clock: Callable[[], float] = time.monotonic,
        stepped: bool = False,
    ) -> None:
        self._settings = settings or AgentSettings()
        self._camera, self._robot = camera, robot
        self._clock, self._stepped = clock, stepped
        self._scenario = scenario
        self._format = _frame_format(camera, self._settings.rows)
        self._supervisor = SafetySupervisor(_safety_for(camera, robot, self._settings.safety))
        self._lock = threading.RLock()
        self._command: WheelCommand | None = None
        self._decision = Decision(0, 0, SafetyState.STOPPED, "starting")
        self._last_frame_s: float | None = None
        self._had_frame_peer = False
        self._problem = ""
        self._ended = False
        self._stamp: FrameStamp | None = None
        self._truth: Truth | None = None
        self._sequence = 0
        self._stopping = threading.Event()
        self._failure: AgentError | None = None
        self._fresh = threading.Condition()
        self._newest: CameraFrame | None = None
        self._replaced = 0

        allow = AllowList(self._settings.allow)
        host, port = self._settings.host, self._settings.port
        self._outlet = Outlet(host, port + 2, port + 3, allow=allow, answer=self._answer, report=self._telemetry)
        self._ports: list[StationPort] = []
        try:
            self._frame_port = StationPort("frames", host, port, allow, self._link_changed)
            self._ports.append(self._frame_port)
            self._command_port = StationPort("commands", host, port + 1, allow, self._link_changed)
            self._ports.append(self._command_port)
        except AgentError:
            self._close_ports()
            raise
        self._writer = FrameWriter(self._frame_port, self._format.size_bytes, lambda: not self._stopping.is_set())
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
        for port in self._ports:
            port.start()
        for thread in threads:
            thread.start()
        try:
            while not self._stopping.wait(PEER_CHECK_S):
                for port in self._ports:
                    port.drop_if_gone()
        finally:
            self._shut_down(threads)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """Ask the agent to end; returns at once. Any thread and signal handlers may call it."""
        self._stopping.set()

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
        with self._lock:
            self._problem = str(error)
            self._failure = self._failure or error
        self._decide()
        self._outlet.publish()
        self.stop()

    def _end_of_recording(self) -> None:
        log.info("the recording has come to its end")
        self._flush()
        with self._lock:
            self._problem, self._ended = "the recording has come to its end", True
        self._decide()
        self._outlet.publish()
        self.stop()

    def _flush(self) -> None:
        """Give the last picture half a second to leave."""
        deadline_s = time.monotonic() + 0.5
        while self._newest is not None and self._frame_port.peer is not None and time.monotonic() < deadline_s:
            self._stopping.wait(0.005)

    def _shut_down(self, threads: list[threading.Thread]) -> None:
        with self._lock:
            self._problem = self._problem or "the agent ends"
        self._stopping.set()
        self._decide()
        self._outlet.publish()
        for thread in threads:
            thread.join(timeout=2.0)  # daemons: a camera that never returns does not keep the process
        self._robot.close()
        self._camera.close()
        self._close_ports()

    def _close_ports(self) -> None:
        for port in self._ports:
            port.close()
        self._outlet.close()

    # -- camera and frames -----------------------------------------------------------------------------------------

    def _next_picture(self) -> CameraFrame | None:
        """A picture from the camera, or None for now; keeps the time of the newest one for the supervisor."""
        picture = self._camera.read(WAIT_S)
        if picture is not None:
            if picture.image.shape != (self._format.full_height, self._format.width):
                size = "x".join(map(str, picture.image.shape[::-1]))
                raise CameraError(f"The camera changed its picture to {size}: start the agent again.")
            with self._lock:
                self._last_frame_s = self._clock()
        return picture

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
            return taken, replaced

    def _send_frames(self) -> None:
        served = 0
        while not self._stopping.is_set():
            picture, replaced = self._take_newest()
            peer = self._frame_port.peer
            if picture is None or peer is None:
                continue
            if self._frame_port.connections != served:
                served, replaced = self._frame_port.connections, 0
                self._writer.prepare(peer)
            elif not self._writer.ready(peer):
                self._put_back(picture, replaced)
                continue
            self._stamp_frame(served, picture, replaced)
            self._writer.write(peer, self._pixels(picture))

    def _put_back(self, picture: CameraFrame, replaced: int) -> None:
        """The station is still busy with the frame before: keep this one unless a newer comes, and look again soon."""
        with self._fresh:
            self._replaced += replaced
            if self._newest is None:
                self._newest = picture
            else:
                self._replaced += 1
        self._stopping.wait(0.001)

    def _stamp_frame(self, connection: int, picture: CameraFrame, replaced: int) -> None:
        """Number the frame and publish its telemetry, so that the station has it before the last byte."""
        with self._lock:
            before = self._stamp
            same = before is not None and before.connection == connection
            number = before.number + 1 if before is not None and same else 1
            dropped = before.dropped + replaced if before is not None and same else replaced
            self._stamp = FrameStamp(connection=connection, number=number, capture_s=picture.capture_s, dropped=dropped)
            self._truth = picture.truth
        self._outlet.publish()

    def _pixels(self, picture: CameraFrame) -> memoryview:
        """The bytes to send: a view of the camera's picture where its memory allows, without a copy."""
        first = self._format.first_row
        return np.ascontiguousarray(picture.image[first : first + self._format.height]).data.cast("B")

    # -- commands --------------------------------------------------------------------------------------------------

    def _read_commands(self) -> None:
        while not self._stopping.is_set():
            command = self._reader.read(WAIT_S)
            if command is not None:
                self._take_command(command)

    def _take_command(self, command: Command) -> None:
        scale = self._settings.speed_scale
        with self._lock:
            self._command = WheelCommand(command.left * scale, command.right * scale, self._clock())
        self._decide()

    def _serve_lockstep(self) -> None:
        """One frame, then one command, as listing A.1; begins when both ports are connected."""
        served = 0
        while not self._stopping.is_set():
            peer = self._frame_port.wait_for_peer(WAIT_S)
            if peer is None or self._command_port.wait_for_peer(WAIT_S) is None:
                continue
            picture = self._next_picture()
            if picture is None:
                continue
            if self._frame_port.connections != served:
                served = self._frame_port.connections
                self._writer.prepare(peer)
            self._stamp_frame(served, picture, 0)
            if self._writer.write(peer, self._pixels(picture)):
                self._await_command()

    def _await_command(self) -> None:
        while not self._stopping.is_set() and self._frame_port.peer and self._command_port.peer:
            command = self._reader.read(WAIT_S, one=True)
            if command is not None:
                self._take_command(command)
                return

    # -- safety ----------------------------------------------------------------------------------------------------

    def _watch(self) -> None:
        while not self._stopping.wait(SAFETY_PERIOD_S):
            self._decide()

    def _decide(self) -> None:
        """Ask the supervisor and turn the wheels accordingly."""
        with self._lock:
            before = self._decision
            state = self._robot.state()
            self._decision = self._supervisor.step(self._clock(), self._command, state.proximity, self._link())
            self._robot.set_wheels(self._decision.left, self._decision.right)
            after = self._decision
        if after.state is not before.state:
            log.info("wheels %s%s", after.state.value, f": {after.reason}" if after.reason else "")

    def _link(self) -> LinkState:
        connected = self._command_port.peer is not None and (
            self._frame_port.peer is not None or not self._had_frame_peer
        )
        return LinkState(connected=connected, last_frame_s=self._last_frame_s, problem=self._problem)

    def _link_changed(self) -> None:
        """A station came or went. A command never outlives the connection that brought it."""
        with self._lock:
            if self._command_port.peer is None:
                self._command, self._had_frame_peer = None, False
            if self._frame_port.peer is not None:
                self._had_frame_peer = True
                self._camera.begin()
        self._decide()

    # -- hello, control, telemetry ---------------------------------------------------------------------------------

    def _answer(self, request: Request) -> Reply:
        if request.action == "hello":
            return Reply(ok=True, hello=self._hello())
        if request.action == "exposure":
            return self._set_exposure(request.value)
        if request.action == "stop":
            self._supervisor.emergency_stop(request.text)
        else:
            self._supervisor.release()
        log.warning("%s", "emergency stop" if request.action == "stop" else "emergency stop released")
        self._decide()
        self._outlet.publish()
        return Reply(ok=True)

    def _set_exposure(self, exposure_us: float) -> Reply:
        set_exposure = getattr(self._camera, "set_exposure", None)
        if set_exposure is None:
            return Reply(ok=False, error="this camera's exposure cannot be set")
        set_exposure(exposure_us)
        return Reply(ok=True)

    def _hello(self) -> Hello:
        scenario = self._scenario
        if scenario is not None and self._frame_port.connections:
            scenario = replace(scenario, events=())  # the operator's hand moves once, for the first station
        capabilities = ["stop"] + (["exposure"] if hasattr(self._camera, "set_exposure") else [])
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
            busy_with=self._frame_port.address or self._command_port.address,
            monotonic_s=self._clock(),
            scenario=scenario,
        )

    def _telemetry(self) -> Telemetry:
        state = self._robot.state()
        with self._lock:
            self._sequence += 1
            return Telemetry(
                sequence=self._sequence,
                monotonic_s=self._clock(),
                wall_s=time.time(),
                frame=self._stamp,
                proximity=state.proximity,
                wheels_asked=(self._decision.left, self._decision.right),
                wheels_measured=state.wheels_measured,
                safety=self._decision.state.value,
                reason=self._decision.reason,
                station=self._frame_port.address or self._command_port.address,
                ended=self._ended,
                cpu_s=time.process_time(),
                truth=self._truth,
            )


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
