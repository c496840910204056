"""How a connection to a robot begins: what it says of itself, or else is assumed of it, and what its frames and
commands need from then on."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

from base_station.calibration.camera_file import camera_of
from base_station.errors import StationError
from base_station.geometry import PinholeCamera
from base_station.rows import NO_ROWS, RowSwitch
from base_station.sockets import Control, ControlLine, LinkLost, RawConnection
from protocol import FRAME_PORT, MIN_UNIT, FrameFormat, Hello, ProtocolError
from protocol.camera_file import CameraFile

log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class LinkSettings:
    """Where the robot is, and what to assume when it cannot say (a peer with the raw ports only)."""

    host: str = "127.0.0.1"
    port: int = FRAME_PORT
    width: int = 640
    height: int = 480
    signed_peer: bool = False
    """A peer without hello reads signed bytes; else commands to it are clamped to 0..127."""
    lockstep_wait_s: float = 2.0
    """In lockstep, how long a frame waits for its telemetry."""
    rows: bool = False
    """Ask the robot for bands of rows (`Link.want_rows`), if it knows them."""
    camera: CameraFile | None = None
    """The robot's camera as it was calibrated; None: as the robot says, or a usual field of view."""


@dataclass(frozen=True, eq=False)
class Session:
    """One connection, with all that its frames and commands need."""

    raw: RawConnection
    format: FrameFormat
    """Of frames that are no band of it."""
    camera: PinholeCamera
    lowest_unit: int
    rows: RowSwitch | None = None
    """None: this robot sends whole frames only."""
    stepped: bool = False
    """Lockstep. Other rows are asked for before a frame is handed out, not after: see `Link`."""


def open_known(settings: LinkSettings, hello: Hello, control_line: Callable[[], ControlLine]) -> Session:
    """To a robot that has said what it is. Raises LinkLost, StationError."""
    knows_rows = "rows" in hello.capabilities
    if settings.rows and not knows_rows:
        log.warning(NO_ROWS, f"{hello.agent} knows no bands of rows (an older agent)")
    camera = _calibrated(settings, hello.format) or _camera_of(hello)
    raw = RawConnection(settings.host, settings.port, hello.format)
    rows = RowSwitch(control_line(), hello.format, raw.address) if settings.rows and knows_rows else None
    return Session(raw, hello.format, camera, MIN_UNIT, rows, stepped=hello.rhythm == "lockstep")


def open_plain(settings: LinkSettings, control: Control) -> Session:
    """Nobody answers hello: the stream is taken for what the settings say. Raises LinkLost, StationError."""
    assumed = FrameFormat(width=settings.width, height=settings.height)
    camera = _calibrated(settings, assumed) or PinholeCamera.with_fov(assumed.width, assumed.height)
    raw = RawConnection(settings.host, settings.port, assumed)
    if control.listens():  # an agent that was just starting
        raw.close()
        raise LinkLost("it is just starting")
    log.warning("%s", assumptions(settings))
    if settings.rows:
        log.warning(NO_ROWS, "a peer with the raw ports only knows no bands of rows")
    return Session(raw, assumed, camera, MIN_UNIT if settings.signed_peer else 0)


def _calibrated(settings: LinkSettings, frames: FrameFormat) -> PinholeCamera | None:
    """What took these frames, where the settings tell. Raises StationError when that is another camera's."""
    if settings.camera is None:
        return None
    try:
        return camera_of(settings.camera, frames)
    except ProtocolError as error:
        raise StationError(f"--camera: {error}.", usage=True) from error


def assumptions(settings: LinkSettings) -> str:
    """What is assumed of a peer without hello, in words."""
    signs = "signed" if settings.signed_peer else "cut to 0..127 (--signed-peer if it reads them signed)"
    return (
        f"No hello on port {settings.port + 3}: a peer with the raw ports only. Assuming frames of "
        f"{settings.width}x{settings.height} (--width, --height), arrival times, commands {signs}."
    )


def _camera_of(hello: Hello) -> PinholeCamera:
    known = hello.intrinsics
    if known is None:
        return PinholeCamera.with_fov(
            hello.width, hello.height, first_row=hello.first_row, full_height=hello.full_height
        )
    return PinholeCamera(
        width=hello.width,
        height=hello.height,
        fx=known.fx,
        fy=known.fy,
        cx=known.cx,
        cy=known.cy,
        distortion=known.distortion if len(known.distortion) in (4, 5) else (),
    )
