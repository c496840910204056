"""The golden files hold what the wire was declared to be: the code writes and reads exactly these bytes."""

from __future__ import annotations

import re

import pytest
from golden_messages import (
    FOLDER,
    FRAME_HEIGHT,
    FRAME_WIDTH,
    HELLO_REPLY,
    README,
    REFUSAL,
    REQUEST,
    TELEMETRY,
    dumps_in,
    golden_files,
    hexdump,
)

from protocol import (
    STOP,
    Command,
    CommandDecoder,
    FrameDecoder,
    FrameFormat,
    decode_reply,
    decode_request,
    decode_telemetry,
)


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
