"""What a running station publishes, and what it is asked for: all that a console, or any other program, knows of it.

Every message is a frozen dataclass as one msgpack map (`protocol.records`), and is checked when it is read. Four
sockets lie in one private folder: `pictures` (PUB: a `Head`, then the frame's pixels as they came), `state` (PUB:
`State` ten times a second, `Map` twice, behind a byte that tells which), `orders` and `emergency` (REP: a `Wish` in, an
`Answer` out). The emergency stop has a socket of its own, so that it never queues behind anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from base_station.orders import Order
from protocol import Telemetry
from protocol.records import to_bytes

STATE, MAP = b"s", b"m"
"""The first byte of a message on the state's socket."""
MOST_POINTS = 2000
"""Of a map, that are published."""
MOST_KEYFRAMES = 300
MOST_FEATURES = 1000
MOST_NAMES = 1024


@dataclass(frozen=True)
class Addresses:
    """Where the sockets are, in the folder of one station."""

    folder: Path

    @property
    def pictures(self) -> str:
        return f"ipc://{self.folder}/pictures"

    @property
    def state(self) -> str:
        return f"ipc://{self.folder}/state"

    @property
    def orders(self) -> str:
        return f"ipc://{self.folder}/orders"

    @property
    def emergency(self) -> str:
        return f"ipc://{self.folder}/emergency"


@dataclass(frozen=True, kw_only=True)
class Seen:
    """A tracker's result; the fields mean what they do in `types.TrackerResult`."""

    state: str
    reason: str = ""
    shift_px: float | None = None
    bearing_rad: float | None = None
    zoom: float | None = None
    view_angle_rad: float | None = None
    range_m: float | None = None
    compass_rad: float | None = None
    confidence: float = 0.0
    box: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Head:
    """Of a picture: its size, and what was seen in it. `rows` of `width` pixels follow, 8-bit gray, from row
    `first_row` of a whole frame of `height` rows."""

    number: int
    """Counts the pictures that were published."""
    width: int
    height: int
    first_row: int
    rows: int
    arrived_s: float
    """When its last byte had come, in seconds of the station's wall clock."""
    focal_px: float
    center_px: float
    """Horizontal focal length and optical axis of the camera: bearings are drawn by them."""
    seen: Seen
    shadow: Seen | None = None
    features: bytes = b""
    """What the tracker follows: uint16 x, y in px of the whole frame, little endian, one after the other."""
    bands: int = 0
    """The tracker reads the box in so many bands of rows; 0: it does not."""


@dataclass(frozen=True, kw_only=True)
class Notice:
    """Something that a person should know. Numbers count up."""

    number: int
    text: str


@dataclass(frozen=True, kw_only=True)
class Signature:
    """By what a tracker knows its target: the numbers of now and those learned, float32, little endian."""

    now: bytes
    learned: bytes


@dataclass(frozen=True, kw_only=True)
class State:
    """How the station, its robot and its link stand."""

    link: str
    """In words."""
    connected: bool
    robot: str = ""
    """Robot, camera and scene, in words; empty for one that says no hello."""
    controllable: bool = False
    """It has a control port: an emergency stop latches in the robot."""
    telemetry: Telemetry | None = None
    speed_limit: int = 500
    """The largest wheel speed, in motor units."""
    loop_hz: float = 0.0
    frame_to_command_ms: float | None = None
    """Median and 95th percentile of the last two seconds."""
    frame_to_command_p95_ms: float | None = None
    tracker_ms: float | None = None
    passed_over: int = 0
    """Frames of this connection that came while the loop was busy, so that it took a newer one."""
    learned: bool = False
    seen: Seen | None = None
    """In the newest frame; None while no frames come."""
    shadow: Seen | None = None
    command: tuple[int, int] = (0, 0)
    pan_rad: float | None = None
    tracker: str = ""
    shadow_tracker: str | None = None
    behaviour: str = ""
    outcome: str = ""
    """How the behaviour's journey ended; empty while it goes on."""
    trackers: tuple[str, ...] = ()
    """That can be chosen; the same for the next two."""
    behaviours: tuple[str, ...] = ()
    landmarks: tuple[str, ...] = ()
    orders: bool = True
    """Orders are taken; not by the replay of a recording."""
    over: bool = False
    """A replay has come to its end: nothing changes any more."""
    signature: Signature | None = None
    notices: tuple[Notice, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Map:
    """A tracker's map, in its own unit: axes as the camera's in its first picture (x right, y down, z ahead). float32,
    little endian. Empty as long as there is none."""

    tracker: str = ""
    """Whose, as in `State`."""
    points: bytes = b""
    """x, y, z of each."""
    keyframes: bytes = b""
    """x, y, z of each camera that is remembered, the oldest first."""
    camera: tuple[float, ...] | None = None
    """world_from_cam now, 4x4 row by row; None while the pose is not known."""
    keyframe_count: int = 0
    point_count: int = 0


@dataclass(frozen=True, kw_only=True)
class Wish:
    """One of two: an order, or a landmark to forget."""

    order: Order | None = None
    forget: str = ""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """`error`: why not, in words for a person; empty when all is well."""

    error: str = ""


def encode(message: State | Head | Map | Wish | Answer) -> bytes:
    """The message as it goes over a socket; a state or a map without its first byte."""
    return to_bytes(message)
