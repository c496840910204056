"""What the raw ports cannot say: hello and control (port 31443, REQ/REP) and telemetry (port 31442, PUB).

Every message is one msgpack map. All of it is optional: a station works with a peer that has only the raw ports.
Angles are in radians, counter-clockwise seen from above (left is positive); lengths in metres; times in seconds of the
agent's monotonic clock unless a name says otherwise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from protocol.errors import ProtocolError
from protocol.frames import FrameFormat
from protocol.records import from_bytes, from_map, to_bytes, unpack_map

PROTOCOL_VERSION = 1
FRAME_PORT, COMMAND_PORT, TELEMETRY_PORT, CONTROL_PORT = 31440, 31441, 31442, 31443
"""The default ports. An agent on other ones keeps the order: base, base + 1, base + 2, base + 3."""

SERVICE_TYPE = "_zservo._tcp.local."
"""Under this an agent may announce itself (DNS-SD); the port is the first of the four."""

ACTIONS = ("hello", "stop", "release", "exposure", "look", "show", "rows")
SIGHTS = ("tracking", "lost", "idle")
"""What a station may see, for the robot's lights."""


def _check_positive(name: str, value: float) -> None:
    if not 0 < value < math.inf:
        raise ProtocolError(f"{name} must be positive, not {value}")


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """Pinhole camera of the frame as sent: focal lengths and principal point in px of the frame sent (a band of rows
    has its own `cy`); `distortion` holds OpenCV's k1, k2, p1, p2[, k3]."""

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.fx <= 0 or self.fy <= 0:
            raise ProtocolError(f"focal lengths must be positive, not {self.fx} and {self.fy}")


@dataclass(frozen=True, kw_only=True)
class ScenarioEvent:
    """A hand of the simulated operator. `kind` is "learn": at frame `frame` of the connection (from 1) the target in
    `box` (x, y, width, height in px of the frame sent) is to be learned, or with no box the whole view."""

    kind: str
    frame: int
    box: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A simulated scene and what its operator would do in it. Handed out once, to the first station."""

    name: str
    seed: int
    events: tuple[ScenarioEvent, ...] = ()
    course: tuple[tuple[float, float], ...] = ()
    """Waypoints (ahead m, left m) of a closed lap, from where the robot starts and looks; empty without a course."""


@dataclass(frozen=True, kw_only=True)
class RobotLimits:
    """How wire units become motion. `metres_per_unit_s`: speed of a wheel at one motor unit."""

    max_units: int = 500
    speed_scale: float = 1.0
    metres_per_unit_s: float = 0.000325
    wheel_base_m: float = 0.094

    def __post_init__(self) -> None:
        for name in ("max_units", "speed_scale", "metres_per_unit_s", "wheel_base_m"):
            _check_positive(name, getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class PanTiltLimits:
    """How far and how fast a camera on a pan-tilt turns. `pan_rad`: rightmost (negative) and leftmost, 0 is straight
    ahead; `tilt_rad`: lowest (negative) and highest, 0 is level; `slew_rad_s`: both axes' speed."""

    pan_rad: tuple[float, float]
    tilt_rad: tuple[float, float]
    slew_rad_s: float

    def __post_init__(self) -> None:
        for name, (low, high) in (("pan_rad", self.pan_rad), ("tilt_rad", self.tilt_rad)):
            if not -math.pi <= low <= 0 <= high <= math.pi:
                raise ProtocolError(f"{name}: {low}..{high} do not enclose 0 within half a turn to either side")
        _check_positive("slew_rad_s", self.slew_rad_s)

    def clamped(self, pan_rad: float, tilt_rad: float) -> tuple[float, float]:
        """The nearest angles within the limits."""
        (right, left), (low, high) = self.pan_rad, self.tilt_rad
        return max(right, min(left, pan_rad)), max(low, min(high, tilt_rad))


@dataclass(frozen=True, kw_only=True)
class Hello:
    """The agent's answer to hello."""

    protocol: int
    agent: str
    """Name and version of the agent's program."""
    width: int
    height: int
    first_row: int = 0
    full_height: int = 0
    fps: float
    rhythm: str
    """"free" or "lockstep"."""
    robot: str
    camera: str
    intrinsics: Intrinsics | None = None
    limits: RobotLimits = RobotLimits()
    capabilities: tuple[str, ...] = ()
    busy_with: str | None = None
    """Address of the station that is connected, None when the robot is free."""
    monotonic_s: float = 0.0
    scenario: Scenario | None = None
    pan_tilt: PanTiltLimits | None = None
    """Of the camera's pan-tilt; None when the camera is fixed."""

    def __post_init__(self) -> None:
        _check_positive("fps", self.fps)

    @property
    def format(self) -> FrameFormat:
        """The frames on port 31440. Raises ProtocolError when the numbers make no frame."""
        return FrameFormat(width=self.width, height=self.height, first_row=self.first_row, full_height=self.full_height)


@dataclass(frozen=True, kw_only=True)
class Request:
    """What a station may ask on the control port.

    `hello`: who are you; `stop`: emergency stop, latched, with the reason in `text`; `release`: end it;
    `exposure`: set the camera's exposure to `value` microseconds, 0 for automatic; `look`: turn the camera's pan-tilt
    to `pan_rad` (left positive) and `tilt_rad` (up positive); `show`: the station sees `text`, one of SIGHTS, which a
    robot with lights shows; `rows`: send the `station` only these `rows` (first, past-last) of the camera's picture,
    None for all that hello names.
    """

    action: str
    text: str = ""
    value: float = 0.0
    pan_rad: float = 0.0
    tilt_rad: float = 0.0
    rows: tuple[int, int] | None = None
    station: str = ""
    """The station's own end of its frame connection, host:port: nobody else changes what it gets."""

    def __post_init__(self) -> None:
        if self.action not in ACTIONS:
            raise ProtocolError(f"unknown action {self.action!r}; there are {', '.join(ACTIONS)}")


@dataclass(frozen=True, kw_only=True)
class Reply:
    """The answer to any request. `error` says why not, in words for a person; `hello` is there for hello only, `frame`
    for rows only: the number of the first frame that has them."""

    ok: bool
    error: str = ""
    hello: Hello | None = None
    frame: int = 0


@dataclass(frozen=True, kw_only=True)
class FrameStamp:
    """The newest frame written. `number` counts frames written to connection number `connection`, from 1."""

    connection: int
    number: int
    capture_s: float
    dropped: int
    """Frames of this connection that were captured but not sent, so that the newest could go first."""
    pan_rad: float | None = None
    """Where the camera's pan-tilt looked when the picture was taken, as far as the agent knows; left positive, None
    when the camera is fixed."""
    tilt_rad: float | None = None
    """The same upwards."""
    rows: tuple[int, int] | None = None
    """First and past-last row of the camera's picture that it shows; None: those that hello names."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Truth:
    """Simulation only: where things really are when the stamped frame was taken. For summaries, never for control.

    `robot` and `target` are (x m, y m, heading rad). `bearing_rad` is the direction of the picture's centre, seen from
    the camera, from the robot's heading (the optical axis of a fixed camera, and of one that pans by 0), `range_m` its
    distance from the camera, both None without a picture (then the bearing is that of the heading at the start).
    `in_view`: the whole picture is in the frame and not hidden (without a picture: half of the view at the start is).
    """

    robot: tuple[float, float, float]
    target: tuple[float, float, float] | None = None
    bearing_rad: float | None = None
    range_m: float | None = None
    in_view: bool = False
    collisions: int = 0


@dataclass(frozen=True, kw_only=True)
class Telemetry:
    """The agent's state, published with every frame (before its bytes) and at least ten times a second."""

    sequence: int
    monotonic_s: float
    wall_s: float
    frame: FrameStamp | None = None
    proximity: tuple[int, ...] | None = None
    """Thymio II: five front sensors left to right, two rear; 0 far, about 4500 at contact."""
    wheels_asked: tuple[int, int] = (0, 0)
    """Left, right in motor units, after safety."""
    wheels_measured: tuple[int, int] | None = None
    battery_v: float | None = None
    """Voltage of the robot's battery."""
    safety: str = "stopped"
    """"ok", "limited" (an obstacle bends the command) or "stopped"."""
    reason: str = ""
    station: str | None = None
    ended: bool = False
    """The recording that is replayed has come to its end: no more frames will follow."""
    cpu_s: float = 0.0
    """Processor time of the agent's process since its start."""
    truth: Truth | None = None


def encode(message: Request | Reply | Telemetry) -> bytes:
    """The message as it goes over the wire."""
    return to_bytes(message)


def decode_request(data: bytes) -> Request:
    """Raises ProtocolError."""
    return from_bytes(Request, data)


def decode_reply(data: bytes) -> Reply:
    """Raises ProtocolError; also when the agent speaks another version of this protocol, saying which."""
    fields = unpack_map(data)
    hello = fields.get("hello")
    version = hello.get("protocol") if isinstance(hello, dict) else PROTOCOL_VERSION
    if version != PROTOCOL_VERSION:
        raise ProtocolError(
            f"the agent speaks protocol version {version}, this station {PROTOCOL_VERSION}: update the older"
        )
    return from_map(Reply, fields)


def decode_telemetry(data: bytes) -> Telemetry:
    """Raises ProtocolError."""
    return from_bytes(Telemetry, data)
