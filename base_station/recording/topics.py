"""What a recording says besides its pictures: the topics, the fields of their messages, and the way back to our values.

Messages are JSON objects, each described by a JSON schema in the file, so that any program can read them. What is not
known is left out, and numbers are written so that reading gives the same bits: a replay compares them one by one.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from base_station.errors import StationError
from base_station.orders import Order
from base_station.station import Step
from base_station.types import Box, TrackerResult, TrackingState
from protocol import ProtocolError, Truth
from protocol.records import from_map

CAMERA, CALIBRATION, ANNOTATIONS = "/camera", "/camera/calibration", "/camera/annotations"
STEP, COMMAND, TRACKER, SHADOW, ORDERS = "/step", "/command", "/tracker", "/shadow", "/orders"
TELEMETRY, TRUTH = "/telemetry", "/truth"
TRUE_POSE, ODOMETRY_POSE, SLAM_POSE = "/pose/truth", "/pose/odometry", "/pose/slam"
TRANSFORMS = "/tf"
RUN, HELLO, END = "zservo:run", "zservo:hello", "zservo:end"
"""Names of the file's metadata records: what was asked for, what the robot said of itself, how the recording ended."""

MEASURES = (
    "shift_px", "shift_y_px", "bearing_rad", "elevation_rad", "zoom", "view_angle_rad", "range_m", "confidence",
    "compass_rad",
)  # fmt: skip
LONGEST_TEXT = 4096
LARGEST = sys.float_info.max
MOST_ORDERS = 10_000

Json = dict[str, Any]
Record = TypeVar("Record")


def _schema(title: str, **properties: Any) -> Json:
    kinds = {int: {"type": "integer"}, float: {"type": "number"}, str: {"type": "string"}, bool: {"type": "boolean"}}
    shown = {name: kinds[kind] if isinstance(kind, type) else kind for name, kind in properties.items()}
    return {"title": title, "type": "object", "properties": shown}


_NUMBERS = {"type": "array", "items": {"type": "number"}}
_TEXTS = {"type": "array", "items": {"type": "string"}}
_BOX = _schema("box", x=float, y=float, width=float, height=float)
_RESULT: dict[str, Any] = {
    "tracker": str, "state": str, "reason": str, "box": _BOX, "cam_from_world": _NUMBERS,
    **dict.fromkeys(MEASURES, float),
}  # fmt: skip
SCHEMAS: dict[str, Json] = {
    STEP: _schema(
        "zservo.Step", number=int, time_s=float, connection=str, width=int, height=int, first_row=int, full_height=int,
        picture=bool, tracker=str, shadow_tracker=str, behaviour=str, learned=bool, tracker_s=float,
        frame_to_command_s=float, pan_rad=float, left=int, right=int, notices=_TEXTS,
    ),
    COMMAND: _schema("zservo.Command", left=int, right=int, pan_rad=float, frame_to_command_s=float),
    TRACKER: _schema("zservo.TrackerResult", **_RESULT),
    SHADOW: _schema("zservo.TrackerResult", **_RESULT),
    ORDERS: _schema("zservo.Order", kind=str, name=str, box=_NUMBERS, forward=float, left=float),
    TELEMETRY: _schema(
        "zservo.Telemetry", sequence=int, monotonic_s=float, wall_s=float, proximity=_NUMBERS, wheels_asked=_NUMBERS,
        wheels_measured=_NUMBERS, battery_v=float, safety=str, reason=str, station=str, ended=bool, cpu_s=float,
        frame=_schema(
            "frame", connection=int, number=int, capture_s=float, dropped=int, pan_rad=float, tilt_rad=float,
            rows=_NUMBERS,
        ),
    ),
    TRUTH: _schema(
        "zservo.Truth", number=int, connection=str, robot=_NUMBERS, target=_NUMBERS, bearing_rad=float, range_m=float,
        in_view=bool, collisions=int,
    ),
}  # fmt: skip
"""By topic. Fields that are not known are missing in a message."""


def dumps(fields: Mapping[str, Any]) -> bytes:
    """As JSON; fields that are None are left out, and so are numbers that JSON does not know."""
    return json.dumps(_known(fields), default=float, allow_nan=False, separators=(",", ":")).encode()


def _known(fields: Mapping[str, Any]) -> Json:
    kept = {}
    for name, value in fields.items():
        if isinstance(value, Mapping):
            value = _known(value)
        if value is not None and not (isinstance(value, (float, np.floating)) and not math.isfinite(value)):
            kept[name] = value
    return kept


def result_fields(result: TrackerResult, tracker: str) -> Json:
    """Of a message on TRACKER or SHADOW."""
    box, pose = result.box, whole_pose(result)
    return {
        "tracker": tracker,
        "state": result.state.value,
        "reason": result.reason[:LONGEST_TEXT],
        "box": None if box is None else {"x": box.x, "y": box.y, "width": box.width, "height": box.height},
        "cam_from_world": None if pose is None else pose.ravel().tolist(),
        **{name: getattr(result, name) for name in MEASURES},
    }


def whole_pose(result: TrackerResult) -> np.ndarray | None:
    """The result's pose (4x4); None when it has none, or a tracker of the user's own made something else of it."""
    pose = None if result.cam_from_world is None else np.asarray(result.cam_from_world, float)
    return pose if pose is not None and pose.shape == (4, 4) and np.isfinite(pose).all() else None


def step_fields(step: Step, *, picture: bool) -> Json:
    """Of a message on STEP. `picture`: there is one in the recording."""
    frame = step.frame
    return {
        "number": frame.number,
        "time_s": frame.time_s,
        "connection": frame.connection,
        "width": frame.image.shape[1],
        "height": frame.image.shape[0],
        "first_row": frame.first_row,
        "full_height": frame.full_height,
        "picture": picture,
        "tracker": step.tracker,
        "shadow_tracker": step.shadow_tracker,
        "behaviour": step.behaviour,
        "learned": step.learned,
        "tracker_s": step.tracker_s,
        "frame_to_command_s": step.frame_to_command_s,
        "pan_rad": step.pan_rad,
        "left": step.command.left,
        "right": step.command.right,
        "notices": list(step.notices),
    }


def order_fields(order: Order) -> Json:
    """Of a message on ORDERS."""
    box = None if order.box is None else [float(side) for side in order.box]
    return {"kind": order.kind, "name": order.name, "box": box, "forward": order.forward, "left": order.left}


# -- and back; each raises StationError, naming the field ----------------------------------------------------------


def loads(topic: str, data: bytes) -> Json:
    """The fields of a message."""
    try:
        fields = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise StationError(f"{topic}: a message is no JSON") from error
    if not isinstance(fields, dict):
        raise StationError(f"{topic}: a message is no JSON object")
    return fields


def number(fields: Mapping[str, Any], name: str) -> float:
    """A finite number that must be there."""
    found = maybe_number(fields, name)
    if found is None:
        raise StationError(f"{name} is missing")
    return found


def maybe_number(fields: Mapping[str, Any], name: str) -> float | None:
    """A finite number, or None where it is left out."""
    value = fields.get(name)
    if value is None:
        return None
    known = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST
    if not known:
        raise StationError(f"{name} is {value!r:.40}, not a number")
    return float(value)


def whole(fields: Mapping[str, Any], name: str, low: int, high: int) -> int:
    """A whole number from `low` to `high`."""
    value = fields.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise StationError(f"{name} is {value!r:.40}, not {low}..{high}")
    return value


def text(fields: Mapping[str, Any], name: str) -> str:
    """Empty where it is left out."""
    value = fields.get(name, "")
    if not isinstance(value, str) or len(value) > LONGEST_TEXT:
        raise StationError(f"{name} is {value!r:.40}, not a text")
    return value


def numbers(fields: Mapping[str, Any], name: str, count: int) -> tuple[float, ...] | None:
    """So many finite numbers, or None where they are left out."""
    values = fields.get(name)
    if values is None:
        return None
    if not isinstance(values, list) or len(values) != count:
        raise StationError(f"{name} is {values!r:.40}, not {count} numbers")
    return tuple(number({name: value}, name) for value in values)


def result_of(fields: Mapping[str, Any]) -> TrackerResult:
    """The result that `result_fields` was made of."""
    box, pose = fields.get("box"), numbers(fields, "cam_from_world", 16)
    if box is not None and not isinstance(box, dict):
        raise StationError("box is no object")
    measured: dict[str, Any] = {name: maybe_number(fields, name) for name in MEASURES}
    measured["confidence"] = measured["confidence"] or 0.0
    try:
        return TrackerResult(
            state=TrackingState(text(fields, "state")),
            reason=text(fields, "reason"),
            box=None if box is None else Box(*(number(box, side) for side in ("x", "y", "width", "height"))),
            cam_from_world=None if pose is None else np.array(pose).reshape(4, 4),
            **measured,
        )
    except ValueError as error:
        raise StationError(f"a result is none: {error}") from error


def order_of(fields: Mapping[str, Any]) -> Order:
    """The order that `order_fields` was made of."""
    box = numbers(fields, "box", 4)
    try:
        return Order(
            kind=text(fields, "kind"),
            name=text(fields, "name"),
            box=None if box is None else (box[0], box[1], box[2], box[3]),
            forward=number(fields, "forward"),
            left=number(fields, "left"),
        )
    except ValueError as error:
        raise StationError(f"an order is none: {error}") from error


def record_of(kind: type[Record], fields: Mapping[str, Any]) -> Record:
    """A message of the wire, as `dataclasses.asdict` took it apart."""
    try:
        return from_map(kind, dict(fields))
    except ProtocolError as error:
        raise StationError(str(error)) from error


def truth_of(fields: Mapping[str, Any]) -> Truth:
    """Where things really were."""
    return record_of(Truth, fields)
