"""What the agent answers on its control port: hello, and to what a station asks for while it drives."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace

from protocol import (
    PROTOCOL_VERSION,
    SIGHTS,
    FrameFormat,
    Hello,
    Intrinsics,
    ProtocolError,
    Reply,
    Request,
    Scenario,
    ScenarioEvent,
)
from robot_agent import __version__
from robot_agent.cameras.base import Camera
from robot_agent.errors import PanTiltError
from robot_agent.pantilt.base import PanTilt
from robot_agent.ports import StationPort
from robot_agent.robots.base import Robot
from robot_agent.safety import SafetySupervisor
from robot_agent.stamps import Stamps
from robot_agent.wheels import Wheels

log = logging.getLogger(__name__)

ROUNDING_RAD = 1e-6
"""A station may ask for a limit itself, rounded."""
LONGEST_EXPOSURE_US = 1_000_000
"""Beyond it no robot drives by its pictures; well before, the supervisor takes the camera for hanging."""


class Answers:
    """Answers one request at a time. `station`: who drives, as host:port; `clock` as safety measures time."""

    def __init__(
        self,
        camera: Camera,
        robot: Robot,
        pan_tilt: PanTilt | None,
        *,
        frames: FrameFormat,
        rhythm: str,
        speed_scale: float,
        scenario: Scenario | None,
        stamps: Stamps,
        wheels: Wheels,
        supervisor: SafetySupervisor,
        frame_port: StationPort,
        station: Callable[[], str | None],
        clock: Callable[[], float],
    ) -> None:
        self._camera, self._robot, self._pan_tilt = camera, robot, pan_tilt
        self._frames, self._rhythm, self._speed_scale = frames, rhythm, speed_scale
        self._scenario, self._stamps = scenario, stamps
        self._wheels, self._supervisor, self._frame_port = wheels, supervisor, frame_port
        self._station, self._clock = station, clock

    def to(self, request: Request) -> Reply:
        """Do what is asked, or say why not."""
        match request.action:
            case "hello":
                return Reply(ok=True, hello=self._hello())
            case "exposure":
                return self._set_exposure(request.value)
            case "look":
                return self._look(request.pan_rad, request.tilt_rad)
            case "show":
                return self._show(request.text)
            case "rows":
                return self._send_rows(request.rows, request.station)
            case "stop":
                self._supervisor.emergency_stop(request.text)
            case "release":
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
        """From the next frame on; its number tells the station where its stream changes."""
        try:
            return Reply(ok=True, frame=self._stamps.choose_rows(rows, station))
        except ProtocolError as error:
            return Reply(ok=False, error=str(error))

    def _set_exposure(self, exposure_us: float) -> Reply:
        set_exposure = getattr(self._camera, "set_exposure", None)
        if set_exposure is None:
            return Reply(ok=False, error="this camera's exposure cannot be set")
        if not 0 <= exposure_us <= LONGEST_EXPOSURE_US:
            return Reply(
                ok=False, error=f"an exposure is 0 (automatic) to {LONGEST_EXPOSURE_US} us, not {exposure_us:g}"
            )
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
            scenario = _shifted_events(scenario, self._frames.first_row)
        capabilities = ["stop", "rows"]
        capabilities += ["exposure"] if hasattr(self._camera, "set_exposure") else []
        capabilities += ["pan-tilt"] if self._pan_tilt is not None else []
        capabilities += ["show"] if hasattr(self._robot, "show") else []
        return Hello(
            protocol=PROTOCOL_VERSION,
            agent=f"zservo robot-agent {__version__}",
            width=self._frames.width,
            height=self._frames.height,
            first_row=self._frames.first_row,
            full_height=self._frames.full_height,
            fps=self._camera.fps,
            rhythm=self._rhythm,
            robot=self._robot.kind,
            camera=type(self._camera).__name__,
            intrinsics=_shifted(self._camera.intrinsics, self._frames.first_row),
            limits=replace(self._robot.limits, speed_scale=self._speed_scale),
            capabilities=tuple(capabilities),
            busy_with=self._station(),
            monotonic_s=self._clock(),
            scenario=scenario,
            pan_tilt=self._pan_tilt.limits if self._pan_tilt is not None else None,
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
