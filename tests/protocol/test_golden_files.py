"""The golden files hold what the wire was declared to be: the code writes and reads exactly these bytes."""

from __future__ import annotations

import dataclasses
import re

import pytest
from golden_messages import (
    FOLDER,
    FRAME_HEIGHT,
    FRAME_WIDTH,
    HELLO_REPLY,
    LOOK,
    README,
    REFUSAL,
    REQUEST,
    TELEMETRY,
    dumps_in,
    golden_files,
    hexdump,
)

from protocol import (
    COMMAND_PORT,
    CONTROL_PORT,
    FRAME_PORT,
    PROTOCOL_VERSION,
    STOP,
    TELEMETRY_PORT,
    Command,
    CommandDecoder,
    FrameDecoder,
    FrameFormat,
    FrameStamp,
    Hello,
    Intrinsics,
    PanTiltLimits,
    Reply,
    Request,
    RobotLimits,
    Scenario,
    ScenarioEvent,
    Telemetry,
    Truth,
    decode_reply,
    decode_request,
    decode_telemetry,
)
from protocol.frames import MAX_SIDE_PX
from protocol.messages import ACTIONS
from protocol.records import MAX_ITEMS, MAX_MESSAGE_BYTES, MAX_TEXT

MESSAGES = (
    Telemetry, FrameStamp, Truth, Request, Reply, Hello, Intrinsics, RobotLimits, PanTiltLimits, Scenario,
    ScenarioEvent,
)  # fmt: skip
PORTS = (FRAME_PORT, COMMAND_PORT, TELEMETRY_PORT, CONTROL_PORT)


def golden(name: str) -> bytes:
    return (FOLDER / name).read_bytes()


def commands_in(data: bytes) -> list[Command]:
    decoder = CommandDecoder()
    commands = [decoder.feed(data[place : place + 2]) for place in range(0, len(data), 2)]
    decoder.end()
    return [command for command in commands if command is not None]


@pytest.mark.parametrize("name", sorted(golden_files()))
def test_the_code_writes_the_golden_bytes(name):
    assert golden_files()[name].hex(" ") == golden(name).hex(" ")


def test_no_golden_file_is_left_over():
    assert {path.name for path in FOLDER.iterdir()} == set(golden_files())


def test_the_golden_frame_is_row_major_with_row_0_first():
    (frame,) = FrameDecoder(FrameFormat(width=FRAME_WIDTH, height=FRAME_HEIGHT)).feed(golden("frame_6x4.bin"))
    for row in range(FRAME_HEIGHT):
        for column in range(FRAME_WIDTH):
            assert frame[row * FRAME_WIDTH + column] == 16 * row + column


def test_the_golden_commands_are_signed():
    assert commands_in(golden("commands.bin")) == [Command(127, -128), STOP, Command(-68, 100), Command(-1, 1)]


def test_the_golden_drive_is_listing_a2_s():
    drive = commands_in(golden("commands_listing_a2.bin"))
    assert len(drive) == 40
    assert drive[:15] == [Command(100, 100)] * 15
    assert drive[15:20] == [Command(-68, 100)] * 5
    assert drive[20:25] == [Command(100, -68)] * 5
    assert drive[25:] == [Command(-100, -100)] * 15


def test_the_golden_messages_are_read():
    assert decode_request(golden("request.bin")) == REQUEST
    assert decode_request(golden("request_look.bin")) == LOOK
    assert decode_reply(golden("reply_hello.bin")) == HELLO_REPLY
    assert decode_reply(golden("reply_refused.bin")) == REFUSAL
    assert decode_telemetry(golden("telemetry.bin")) == TELEMETRY


def test_the_specification_shows_every_golden_file_as_it_is():
    dumps = dumps_in(README.read_text(encoding="utf-8"))
    assert set(dumps) == set(golden_files())
    for name, dump in dumps.items():
        assert dump == hexdump(golden(name)), f"{name}: see golden_messages.py on how to write the dumps anew"


def test_the_hexdump_itself_is_right():
    first, last = hexdump(bytes(range(48, 66))).splitlines()[:2]
    assert first == "00000000  30 31 32 33 34 35 36 37  38 39 3a 3b 3c 3d 3e 3f  |0123456789:;<=>?|"
    assert re.fullmatch(r"00000010  40 41 {45}\|@A\|", last)


def tables_in(text: str) -> dict[str, list[list[str]]]:
    """The rows of the field tables, by the heading above them."""
    tables: dict[str, list[list[str]]] = {}
    heading = ""
    for line in text.splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        elif line.startswith("| `"):
            tables.setdefault(heading, []).append([cell.strip() for cell in line.strip("|").split("|")])
    return tables


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_the_specification_lists_every_field_with_its_default(kind):
    rows = tables_in(README.read_text(encoding="utf-8"))[kind.__name__]
    assert [row[0] for row in rows] == [f"`{field.name}`" for field in dataclasses.fields(kind)]
    for field, (_, _, default, meaning) in zip(dataclasses.fields(kind), rows, strict=True):
        assert default == shown_default(field), field.name
        assert len(meaning) > 5, field.name


def shown_default(field: dataclasses.Field) -> str:
    if field.default is dataclasses.MISSING:
        return "required"
    if dataclasses.is_dataclass(field.default):
        return "all defaults"
    if field.default is None:
        return "nil"
    if field.default is False:
        return "false"
    return f'"{field.default}"' if isinstance(field.default, str) else str(field.default)


def test_the_specification_names_ports_actions_bounds_and_the_version():
    text = README.read_text(encoding="utf-8")
    for value in (*PORTS, MAX_MESSAGE_BYTES, MAX_TEXT, MAX_ITEMS, MAX_SIDE_PX):
        assert str(value) in text
    assert f"now {PROTOCOL_VERSION})" in text
    actions = next(row for row in tables_in(text)["Request"] if row[0] == "`action`")
    assert re.findall(r'"(\w+)"', actions[3]) == list(ACTIONS)


def test_the_specification_s_table_of_the_drive_is_the_golden_file():
    drive = golden("commands_listing_a2.bin")
    rows = re.findall(
        r"^\| (\d+)\.\.(\d+) \| (-?\d+), (-?\d+) \| `(..) (..)` ", README.read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(rows) == 4
    told = b"".join(bytes.fromhex(row[4] + row[5]) * (int(row[1]) - int(row[0]) + 1) for row in rows)
    assert told == drive
    for _, _, left, right, *pair in rows:
        assert bytes(Command(int(left), int(right))) == bytes.fromhex("".join(pair))
