"""Messages of ports 31442 and 31443: they survive the wire, peers of other ages are understood, garbage is refused."""

from __future__ import annotations

import dataclasses
import random
import types
from typing import Any, Union, get_args, get_origin, get_type_hints

import msgpack
import pytest
from golden_messages import HELLO_REPLY, LOOK, REFUSAL, REQUEST, TELEMETRY
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol import (
    COMMAND_PORT,
    CONTROL_PORT,
    FRAME_PORT,
    TELEMETRY_PORT,
    FrameFormat,
    Hello,
    PanTiltLimits,
    ProtocolError,
    Reply,
    Request,
    RobotLimits,
    Telemetry,
    decode_reply,
    decode_request,
    decode_telemetry,
    encode,
)
from protocol.messages import ACTIONS
from protocol.records import MAX_ITEMS, MAX_MESSAGE_BYTES, MAX_TEXT

DECODERS = {Request: decode_request, Reply: decode_reply, Telemetry: decode_telemetry}
EXAMPLES = (REQUEST, LOOK, HELLO_REPLY, REFUSAL, TELEMETRY)
HELLO = HELLO_REPLY.hello
LEAST_TELEMETRY = {"sequence": 1, "monotonic_s": 0.5, "wall_s": 2.0}
LEAST_HELLO = {
    "protocol": 1, "agent": "a", "width": 4, "height": 3, "fps": 30, "rhythm": "free", "robot": "none", "camera": "c",
}  # fmt: skip


def packed(value: Any) -> bytes:
    return msgpack.packb(value)


def test_the_ports_are_the_thesis_s_two_and_the_next_two():
    assert (FRAME_PORT, COMMAND_PORT, TELEMETRY_PORT, CONTROL_PORT) == (31440, 31441, 31442, 31443)


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)
def test_a_message_survives_the_wire(message):
    assert DECODERS[type(message)](encode(message)) == message


def strategy(kind: Any) -> st.SearchStrategy:
    """Any valid value of a field's type."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, types.UnionType):
        (inner,) = (argument for argument in arguments if argument is not type(None))
        return st.none() | strategy(inner)
    if origin is tuple and arguments[-1] is Ellipsis:
        return st.lists(strategy(arguments[0]), max_size=5).map(tuple)
    if origin is tuple:
        return st.tuples(*map(strategy, arguments))
    if kind is PanTiltLimits:  # its numbers depend on each other
        to_one_side = st.floats(0.0, 3.1)
        span = st.tuples(to_one_side.map(lambda side: -side), to_one_side)
        return st.builds(kind, pan_rad=span, tilt_rad=span, slew_rad_s=st.floats(0.001, 1e9))
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        special = {
            (Request, "action"): st.sampled_from(ACTIONS),
            (Hello, "protocol"): st.just(1),
            (RobotLimits, "max_units"): st.integers(1, 2**63),
        }
        fields = {}
        for field in dataclasses.fields(kind):
            positive = field.name in ("fx", "fy", "fps", "speed_scale", "metres_per_unit_s", "wheel_base_m")
            fields[field.name] = (
                st.floats(0.001, 1e9) if positive else special.get((kind, field.name), strategy(hints[field.name]))
            )
        return st.builds(kind, **fields)
    return {
        bool: st.booleans(),
        int: st.integers(-(2**63), 2**64 - 1),
        float: st.floats(allow_nan=False, allow_infinity=False),
        str: st.text(max_size=40),
    }[kind]


@given(st.one_of(strategy(Request), strategy(Reply), strategy(Telemetry)))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_every_valid_message_survives_the_wire(message):
    assert DECODERS[type(message)](encode(message)) == message


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)
def test_cut_off_anywhere_it_is_refused_and_so_it_is_with_trailing_bytes(message):
    data, decode = encode(message), DECODERS[type(message)]
    for length in range(len(data)):
        with pytest.raises(ProtocolError):
            decode(data[:length])
    with pytest.raises(ProtocolError):
        decode(data + b"\x00")


def test_unknown_keys_are_passed_over_at_every_depth():
    fields = dataclasses.asdict(TELEMETRY) | {"battery": {"volts": 3.7}}
    fields["frame"]["exposure_us"] = 8000
    assert decode_telemetry(packed(fields)) == TELEMETRY


def test_telemetry_of_an_older_agent_is_read_and_a_newer_one_s_by_an_older_station():
    """The battery came later: a message without it says that it is not known, one with it keeps all the rest."""
    fields = msgpack.unpackb(encode(TELEMETRY))
    del fields["battery_v"]
    old = decode_telemetry(msgpack.packb(fields))
    assert old.battery_v is None
    assert dataclasses.replace(old, battery_v=TELEMETRY.battery_v) == TELEMETRY


def test_missing_keys_take_their_defaults():
    telemetry = decode_telemetry(packed(LEAST_TELEMETRY))
    assert telemetry == Telemetry(sequence=1, monotonic_s=0.5, wall_s=2.0)
    assert (telemetry.safety, telemetry.wheels_asked, telemetry.frame) == ("stopped", (0, 0), None)
    hello = decode_reply(packed({"ok": True, "hello": LEAST_HELLO})).hello
    assert hello is not None
    assert hello.format == FrameFormat(width=4, height=3)
    assert hello.limits.max_units == 500
    assert hello.limits.speed_scale == 1.0


@pytest.mark.parametrize("name", ["sequence", "monotonic_s", "wall_s"])
def test_a_missing_key_without_default_is_named(name):
    fields = {key: value for key, value in LEAST_TELEMETRY.items() if key != name}
    with pytest.raises(ProtocolError, match=f"^{name} is missing$"):
        decode_telemetry(packed(fields))


@pytest.mark.parametrize("name", list(LEAST_HELLO))
def test_a_hello_without_one_of_the_keys_it_must_have_is_refused(name):
    fields = {key: value for key, value in LEAST_HELLO.items() if key != name}
    with pytest.raises(ProtocolError):
        decode_reply(packed({"ok": True, "hello": fields}))


@pytest.mark.parametrize(
    ("fields", "path"),
    [
        ({"sequence": "1"}, "sequence"),
        ({"sequence": 1.0}, "sequence"),
        ({"sequence": True}, "sequence"),
        ({"sequence": None}, "sequence"),
        ({"monotonic_s": float("nan")}, "monotonic_s"),
        ({"monotonic_s": float("inf")}, "monotonic_s"),
        ({"monotonic_s": False}, "monotonic_s"),
        ({"ended": 1}, "ended"),
        ({"reason": b"bytes"}, "reason"),
        ({"reason": "x" * (MAX_TEXT + 1)}, "reason"),
        ({"proximity": [0, 0, "near"]}, r"proximity\[2\]"),
        ({"proximity": 7}, "proximity"),
        ({"proximity": [0] * (MAX_ITEMS + 1)}, "proximity"),
        ({"wheels_asked": [1]}, "wheels_asked: 2 items are expected, 1 came"),
        ({"frame": [1]}, "frame: a map is expected"),
        ({"frame": {"connection": 1, "number": "9", "capture_s": 0, "dropped": 0}}, "frame.number"),
        ({"truth": {"robot": [0, 0]}}, "truth.robot"),
    ],
)
def test_a_wrong_type_is_refused_and_the_field_named(fields, path):
    with pytest.raises(ProtocolError, match=path):
        decode_telemetry(packed(LEAST_TELEMETRY | fields))


def test_an_integer_will_do_for_a_float():
    telemetry = decode_telemetry(packed(LEAST_TELEMETRY | {"monotonic_s": 3}))
    assert telemetry.monotonic_s == 3.0
    assert isinstance(telemetry.monotonic_s, float)


def test_texts_and_lists_up_to_their_bounds_pass():
    fields = {"reason": "x" * MAX_TEXT, "proximity": [0] * MAX_ITEMS}
    telemetry = decode_telemetry(packed(LEAST_TELEMETRY | fields))
    assert (len(telemetry.reason), len(telemetry.proximity or ())) == (MAX_TEXT, MAX_ITEMS)


def test_a_message_of_more_than_64_kib_is_not_even_unpacked():
    assert MAX_MESSAGE_BYTES == 64 * 1024
    largest = packed(LEAST_TELEMETRY | {"padding": b""})
    room = MAX_MESSAGE_BYTES - len(largest) - 1  # a longer text needs one more byte for its length
    fits = packed(LEAST_TELEMETRY | {"padding": b" " * room})
    assert MAX_MESSAGE_BYTES - 2 <= len(fits) <= MAX_MESSAGE_BYTES
    assert decode_telemetry(fits).sequence == 1
    with pytest.raises(ProtocolError, match="at most 65536"):
        decode_telemetry(fits + b" " * 3)


@pytest.mark.parametrize("value", [None, 1, "hello", [1, 2], {1: 2}, {b"sequence": 1}])
def test_what_is_no_map_with_text_keys_is_refused(value):
    with pytest.raises(ProtocolError):
        decode_telemetry(packed(value))


def test_an_unknown_action_is_refused_with_the_list_of_those_there_are():
    with pytest.raises(ProtocolError, match="'dance'; there are hello, stop, release, exposure, look, show"):
        decode_request(packed({"action": "dance"}))


def test_a_focal_length_must_be_positive():
    for fx in (0, -500):
        intrinsics = {"fx": fx, "fy": 500, "cx": 0, "cy": 0}
        with pytest.raises(ProtocolError, match="positive"):
            decode_reply(packed({"ok": True, "hello": LEAST_HELLO | {"intrinsics": intrinsics}}))


@pytest.mark.parametrize("wrong", [0, -1, float("inf"), float("nan")])
@pytest.mark.parametrize("name", ["fps", "max_units", "speed_scale", "metres_per_unit_s", "wheel_base_m"])
def test_what_a_station_divides_by_must_be_positive(name, wrong):
    hello = LEAST_HELLO | ({"fps": wrong} if name == "fps" else {"limits": {name: wrong}})
    with pytest.raises(ProtocolError, match=name if wrong == 0 else None):
        decode_reply(packed({"ok": True, "hello": hello}))


def test_another_version_of_the_protocol_is_named_even_when_its_fields_have_changed():
    with pytest.raises(ProtocolError, match="version 2, this station 1"):
        decode_reply(packed({"ok": True, "hello": {"protocol": 2, "robot": ["changed"]}}))


@pytest.mark.parametrize(
    "changes", [{"width": 0}, {"width": 8193}, {"height": 2**63}, {"first_row": 3, "full_height": 4}]
)
def test_a_hello_whose_numbers_make_no_frame_says_so_when_the_format_is_asked(changes):
    hello = decode_reply(packed({"ok": True, "hello": LEAST_HELLO | changes})).hello
    assert hello is not None
    with pytest.raises(ProtocolError):
        _ = hello.format


def test_the_format_in_hello_is_that_of_the_band_of_rows():
    assert HELLO is not None
    assert HELLO.format == FrameFormat(width=640, height=64, first_row=208, full_height=480)


def only_protocol_errors(data: bytes) -> None:
    for decode in DECODERS.values():
        try:
            decode(data)
        except ProtocolError as error:
            assert str(error)


@given(st.binary(max_size=300))
@settings(derandomize=True, max_examples=200, deadline=None)
def test_garbage_raises_protocol_errors_only(data):
    only_protocol_errors(data)


MSGPACK = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=8)
    | st.binary(max_size=8),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
KEYS = st.sampled_from(
    sorted({field.name for kind in (Request, Reply, Telemetry, Hello) for field in dataclasses.fields(kind)})
)


@given(st.dictionaries(KEYS, MSGPACK, max_size=8), st.dictionaries(KEYS, MSGPACK, max_size=8))
@settings(derandomize=True, max_examples=150, deadline=None)
def test_known_keys_with_any_values_raise_protocol_errors_only(fields, hello):
    only_protocol_errors(packed(LEAST_TELEMETRY | fields))
    only_protocol_errors(packed({"ok": True, "hello": LEAST_HELLO | hello} | fields))


def test_any_one_byte_changed_raises_protocol_errors_only():
    rng = random.Random(0)
    for message in EXAMPLES:
        data = encode(message)
        for place in range(len(data)):
            for _ in range(4):
                only_protocol_errors(data[:place] + bytes([rng.randrange(256)]) + data[place + 1 :])


@pytest.mark.parametrize("depth", [100, 500, 1000, 30_000])
def test_deep_nesting_raises_protocol_errors_only(depth):
    key = packed("reason")
    for opened in (b"\x91", b"\x81\xa1a"):
        only_protocol_errors(b"\x81" + key + opened * depth + b"\xc0")
        only_protocol_errors(b"\x84" + packed(LEAST_TELEMETRY)[1:] + key + opened * depth + b"\xc0")


def test_a_timestamp_or_an_extension_raises_protocol_errors_only():
    for value in (msgpack.Timestamp(1, 2), msgpack.ExtType(5, b"x")):
        only_protocol_errors(packed(LEAST_TELEMETRY | {"reason": value}))


def without(fields: dict[str, Any], *names: str) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if name not in names}


def test_peers_from_before_the_pan_tilt_are_understood():
    """Their messages lack its keys: the camera is fixed."""
    old = dataclasses.asdict(TELEMETRY)
    old["frame"] = without(old["frame"], "pan_rad", "tilt_rad")
    stamp = decode_telemetry(packed(old)).frame
    assert stamp is not None and (stamp.pan_rad, stamp.tilt_rad) == (None, None)
    hello = decode_reply(packed({"ok": True, "hello": without(dataclasses.asdict(HELLO), "pan_tilt")})).hello
    assert hello is not None and hello.pan_tilt is None
    assert decode_request(packed(without(dataclasses.asdict(REQUEST), "pan_rad", "tilt_rad"))) == REQUEST


@pytest.mark.parametrize(
    "wrong",
    [
        {"pan_rad": (0.1, 1.0)},
        {"pan_rad": (-4.0, 1.0)},
        {"tilt_rad": (-1.0, -0.1)},
        {"tilt_rad": (1.0, -1.0)},
        {"slew_rad_s": 0.0},
        {"slew_rad_s": -1.0},
    ],
    ids=str,
)
def test_limits_that_make_no_pan_tilt_are_refused(wrong):
    limits = {"pan_rad": (-1.0, 1.0), "tilt_rad": (-1.0, 1.0), "slew_rad_s": 2.0} | wrong
    with pytest.raises(ProtocolError):
        decode_reply(packed({"ok": True, "hello": LEAST_HELLO | {"pan_tilt": limits}}))


@pytest.mark.parametrize("angle", [float("nan"), float("inf"), "left", None, True])
@pytest.mark.parametrize("name", ["pan_rad", "tilt_rad"])
def test_a_look_must_be_at_numbers(name, angle):
    with pytest.raises(ProtocolError, match=name):
        decode_request(packed({"action": "look", name: angle}))


def test_the_nearest_angles_within_the_limits():
    limits = PanTiltLimits(pan_rad=(-1.5, 1.25), tilt_rad=(-0.5, 0.75), slew_rad_s=3.0)
    assert limits.clamped(0.1, -0.2) == (0.1, -0.2)
    assert limits.clamped(-9.0, 9.0) == (-1.5, 0.75)
    assert limits.clamped(9.0, -9.0) == (1.25, -0.5)
