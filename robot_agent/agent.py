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
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

import numpy as np

from protocol import FRAME_PORT, FrameFormat, ProtocolError, Scenario, Telemetry
from robot_agent.access import AllowList
from robot_agent.answers import Answers
from robot_agent.cameras.base import Camera, CameraFrame
from robot_agent.errors import AgentError, CameraError, EndOfRecording, UsageError
from robot_agent.outlet import Outlet
from robot_agent.pantilt.base import PanTilt
from robot_agent.ports import CommandReader, FrameWriter, Peer, StationPort
from robot_agent.robots.base import Robot
from robot_agent.safety import SafetySettings, SafetySupervisor
from robot_agent.stamps import Stamps
from robot_agent.wheels import Wheels

log = logging.getLogger(__name__)

SAFETY_PERIOD_S = 0.01
PEER_CHECK_S = 0.2
WAIT_S = 0.1
"""How long a thread waits before it looks whether the agent is to end."""
FLUSH_S = 0.5
"""At the end of a recording its last picture has this long to leave."""


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
        self._format = _frame_format(camera, self._settings.rows)
        self._stamps = Stamps(self._format, lambda: self._frame_port.peer)
        self._supervisor = SafetySupervisor(_safety_for(camera, robot, self._settings.safety))
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
            self._outlet = Outlet(
                host,
                port + 2,
                port + 3,
                allow=allow,
                answer=lambda request: self._answers.to(request),
                report=self._telemetry,
                guard=self._guard,
            )
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
        self._answers = Answers(
            camera,
            robot,
            pan_tilt,
            frames=self._format,
            rhythm=self._settings.rhythm,
            speed_scale=self._settings.speed_scale,
            scenario=scenario,
            stamps=self._stamps,
            wheels=self._wheels,
            supervisor=self._supervisor,
            frame_port=self._frame_port,
            station=self._station,
            clock=clock,
        )
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
        angles_rad = self._pan_tilt.angles_at(picture.capture_s) if self._pan_tilt is not None else None
        sent = self._stamps.stamp(peer.number, picture, replaced, angles_rad)
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

    # -- telemetry -------------------------------------------------------------------------------------------------

    def _station(self) -> str | None:
        peer = self._frame_port.peer or self._command_port.peer
        return peer.address if peer is not None else None

    def _telemetry(self) -> Telemetry:
        decision, state = self._wheels.decision, self._wheels.robot_state
        stamp, truth = self._stamps.current()
        self._sequence += 1  # the outlet asks for one at a time
        return Telemetry(
            sequence=self._sequence,
            monotonic_s=self._clock(),
            wall_s=time.time(),
            frame=stamp,
            proximity=state.proximity,
            wheels_asked=(decision.left, decision.right),
            wheels_measured=state.wheels_measured,
            battery_v=state.battery_v,
            safety=decision.state.value,
            reason=decision.reason,
            station=self._station(),
            ended=self._ended,
            cpu_s=time.process_time(),
            truth=truth,
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
