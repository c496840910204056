"""Commands: two signed bytes, and the newest of what came counts."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol import MAX_UNIT, MIN_UNIT, STOP, Command, CommandDecoder, ProtocolError, TruncatedError

UNITS = st.integers(MIN_UNIT, MAX_UNIT)


@pytest.mark.parametrize(
    ("left", "right", "data"),
    [(0, 0, "0000"), (1, -1, "01ff"), (127, -128, "7f80"), (-68, 100, "bc64"), (-100, -100, "9c9c")],
)
def test_wheels_are_twos_complement_left_first(left, right, data):
    assert bytes(Command(left, right)).hex() == data
    assert Command.from_bytes(bytes.fromhex(data)) == Command(left, right)


def test_minus_100_is_the_byte_that_listing_a1_reads_as_156():
    assert list(bytes(Command(-100, -100))) == [156, 156]


@given(UNITS, UNITS)
@settings(derandomize=True, deadline=None)
def test_every_command_survives_the_wire(left, right):
    assert Command.from_bytes(bytes(Command(left, right))) == Command(left, right)


@pytest.mark.parametrize("pair", [(128, 0), (0, 128), (-129, 0), (0, -129)])
def test_one_beyond_a_byte_is_refused_and_the_wheel_named(pair):
    with pytest.raises(ProtocolError, match=("left" if pair[0] else "right") + r" wheel command is -?12\d"):
        Command(*pair)


def test_another_length_than_two_bytes_is_refused_as_too_short_or_too_long():
    for short in (b"", b"a"):
        with pytest.raises(TruncatedError, match=f"{len(short)} came"):
            Command.from_bytes(short)
    with pytest.raises(ProtocolError, match="not 3") as caught:
        Command.from_bytes(b"abc")
    assert not isinstance(caught.value, TruncatedError)


def test_split_at_every_place_the_last_command_is_the_same():
    commands = [Command(1, 2), Command(-3, 4), Command(5, -6)]
    stream = b"".join(map(bytes, commands))
    for place in range(len(stream) + 1):
        decoder = CommandDecoder()
        newest = [decoder.feed(stream[:place]), decoder.feed(stream[place:])]
        assert [command for command in newest if command is not None][-1] == commands[-1], place
        assert (decoder.commands, decoder.pending) == (3, 0)


def test_byte_by_byte_no_command_is_lost():
    decoder = CommandDecoder()
    stream = bytes(Command(1, 2)) + bytes(Command(-3, 4))
    assert [decoder.feed(stream[i : i + 1]) for i in range(4)] == [None, Command(1, 2), None, Command(-3, 4)]


def test_trailing_half_command_waits_for_its_other_byte():
    decoder = CommandDecoder()
    assert decoder.feed(b"\x01\x02\x03") == Command(1, 2)
    assert decoder.pending == 1
    assert decoder.feed(b"\x04") == Command(3, 4)


def test_nothing_in_nothing_out():
    decoder = CommandDecoder()
    assert decoder.feed(b"") is None
    decoder.end()


def test_an_end_inside_a_command_says_which():
    decoder = CommandDecoder()
    decoder.feed(b"\x01\x02\x03")
    with pytest.raises(TruncatedError, match="inside command 2"):
        decoder.end()


@given(st.lists(st.binary(max_size=9), max_size=12))
@settings(derandomize=True, deadline=None)
def test_any_cutting_gives_the_newest_command_of_each_chunk_and_never_holds_more_than_a_byte(chunks):
    decoder, stream = CommandDecoder(), b""
    for chunk in chunks:
        before = len(stream) // 2
        stream += chunk
        after = len(stream) // 2
        expected = Command.from_bytes(stream[2 * after - 2 : 2 * after]) if after > before else None
        assert decoder.feed(chunk) == expected
        assert decoder.commands == after
        assert decoder.pending == len(stream) % 2


def test_a_flood_is_skipped_to_its_last_command():
    decoder = CommandDecoder()
    assert decoder.feed(b"\x7f" * 100_000 + bytes(Command(-5, 6))) == Command(-5, 6)
    assert decoder.commands == 50_001


def test_bytearrays_and_memoryviews_are_bytes_too():
    data = bytearray(b"\x01\x02\x03")
    assert CommandDecoder().feed(memoryview(data)) == Command(1, 2)
    assert CommandDecoder().feed(data) == Command(1, 2)


FINITE = st.floats(-1e6, 1e6)


@given(FINITE, FINITE)
@settings(derandomize=True, deadline=None)
def test_clamping_keeps_the_ratio_of_the_wheels_to_within_rounding(left, right):
    command = Command.clamped(left, right)
    largest = max(abs(left), abs(right))
    scale = max(abs(command.left), abs(command.right)) / largest if largest else 0.0
    if largest <= 127:
        scale = 1.0
    assert command.left == pytest.approx(left * scale, abs=1.01)
    assert command.right == pytest.approx(right * scale, abs=1.01)


@pytest.mark.parametrize(
    ("asked", "given_"),
    [
        ((0.4, -0.4), (0, 0)),
        ((127.4, 0), (127, 0)),
        ((254, 127), (127, 64)),
        ((-256, 128), (-128, 64)),
        ((-128, 127), (-128, 127)),
        ((1e9, -1e9), (127, -127)),
    ],
)
def test_clamping_known_answers(asked, given_):
    command = Command.clamped(*asked)
    assert (command.left, command.right) == given_


def test_towards_a_peer_that_reads_bytes_unsigned_no_wheel_goes_backwards():
    assert Command.clamped(-50, 100, lowest=0) == Command(0, 100)
    assert Command.clamped(-50, -100, lowest=0) == STOP
    assert Command.clamped(50, 100, lowest=0) == Command(50, 100)


@given(FINITE, FINITE)
@settings(derandomize=True, deadline=None)
def test_what_an_unsigned_peer_is_sent_means_the_same_read_either_way(left, right):
    command = Command.clamped(left, right, lowest=0)
    assert list(bytes(command)) == [command.left, command.right]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_never_becomes_a_command(bad):
    with pytest.raises((ValueError, OverflowError)):
        Command.clamped(bad, 0.0)
