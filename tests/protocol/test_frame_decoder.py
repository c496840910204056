"""Frames come out of the byte stream as they went in, however the network cuts it."""

from __future__ import annotations

import doctest
import itertools

import pytest
from golden_messages import FRAME_HEIGHT, FRAME_WIDTH, frame_bytes
from hypothesis import given, settings
from hypothesis import strategies as st

import protocol.frames
from protocol import FrameDecoder, FrameFormat, ProtocolError, TruncatedError
from protocol.frames import MAX_SIDE_PX

FORMAT = FrameFormat(width=FRAME_WIDTH, height=FRAME_HEIGHT)
FRAME = frame_bytes()
NEXT_FRAME = bytes(255 - byte for byte in FRAME)


def decoded(decoder: FrameDecoder, *chunks: bytes) -> list[bytes]:
    return [bytes(frame) for chunk in chunks for frame in decoder.feed(chunk)]


def test_a_whole_frame_comes_out_as_it_went_in():
    decoder = FrameDecoder(FORMAT)
    assert decoded(decoder, FRAME) == [FRAME]
    assert (decoder.frames, decoder.pending) == (1, 0)
    decoder.end()


def test_byte_by_byte_each_frame_appears_with_its_last_byte_and_not_before():
    decoder = FrameDecoder(FORMAT)
    for number, frame in ((1, FRAME), (2, NEXT_FRAME)):
        for index in range(len(frame) - 1):
            assert decoder.feed(frame[index : index + 1]) == []
            assert decoder.pending == index + 1
        assert decoded(decoder, frame[-1:]) == [frame]
        assert decoder.frames == number


def test_split_at_every_place_two_frames_stay_the_same_two():
    stream = FRAME + NEXT_FRAME
    for place in range(len(stream) + 1):
        assert decoded(FrameDecoder(FORMAT), stream[:place], stream[place:]) == [FRAME, NEXT_FRAME], place


def test_trailing_bytes_wait_for_the_rest_of_their_frame():
    decoder = FrameDecoder(FORMAT)
    assert decoded(decoder, FRAME + NEXT_FRAME[:5]) == [FRAME]
    assert decoder.pending == 5
    assert decoded(decoder, NEXT_FRAME[5:]) == [NEXT_FRAME]


def test_an_end_between_frames_is_clean_and_one_inside_a_frame_says_how_much_came():
    decoder = FrameDecoder(FORMAT)
    decoder.end()
    decoder.feed(FRAME)
    decoder.end()
    decoder.feed(NEXT_FRAME[:7])
    with pytest.raises(TruncatedError, match=r"inside frame 2: 7 of 24 bytes"):
        decoder.end()


def test_the_buffer_to_fill_never_reaches_beyond_the_frame_so_memory_is_bounded():
    decoder = FrameDecoder(FORMAT)
    for filled in range(FORMAT.size_bytes):
        assert len(decoder.writable()) == FORMAT.size_bytes - filled
        decoder.writable()[:1] = FRAME[filled : filled + 1]
        frame = decoder.advance(1)
    assert frame is not None
    assert bytes(frame) == FRAME
    assert len(decoder.writable()) == FORMAT.size_bytes


def test_a_frame_handed_out_is_never_written_to_again():
    decoder = FrameDecoder(FORMAT)
    (first,) = decoder.feed(FRAME)
    decoder.feed(NEXT_FRAME)
    assert bytes(first) == FRAME


@pytest.mark.parametrize("count", [-1, 25])
def test_advancing_beyond_the_room_there_is_is_the_callers_mistake(count):
    with pytest.raises(ValueError, match="room for 24"):
        FrameDecoder(FORMAT).advance(count)


@given(
    width=st.integers(1, 9),
    height=st.integers(1, 5),
    frames=st.integers(0, 4),
    rest=st.integers(0, 44),
    cuts=st.lists(st.integers(0, 250)),
    seed=st.randoms(use_true_random=False),
)
@settings(derandomize=True, max_examples=60, deadline=None)
def test_any_cutting_of_any_stream_gives_its_whole_frames_and_keeps_the_rest(width, height, frames, rest, cuts, seed):
    frame_format = FrameFormat(width=width, height=height)
    size = frame_format.size_bytes
    stream = seed.randbytes(frames * size + rest % size)
    places = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    decoder = FrameDecoder(frame_format)
    chunks = [stream[start:end] for start, end in itertools.pairwise(places)]
    assert decoded(decoder, *chunks) == [stream[i * size : (i + 1) * size] for i in range(frames)]
    assert (decoder.frames, decoder.pending) == (frames, rest % size)


def test_the_largest_frame_is_allowed_and_one_pixel_more_is_not():
    assert FrameFormat(width=MAX_SIDE_PX, height=MAX_SIDE_PX).size_bytes == 8192 * 8192
    for sides in ({"width": 8193, "height": 1}, {"width": 1, "height": 8193}):
        with pytest.raises(ProtocolError, match=r"must be 1\.\.8192"):
            FrameFormat(**sides)


@pytest.mark.parametrize("sides", [(0, 4), (4, 0), (-1, 4), (4, -1)])
def test_a_side_below_one_is_refused(sides):
    with pytest.raises(ProtocolError):
        FrameFormat(width=sides[0], height=sides[1])


def test_a_band_of_rows_has_the_bytes_of_its_rows_only_and_must_lie_in_the_picture():
    band = FrameFormat(width=640, height=64, first_row=208, full_height=480)
    assert band.size_bytes == 640 * 64
    assert str(band) == "640x64 (rows 208:272)"
    assert FrameFormat(width=640, height=64, first_row=416, full_height=480).first_row == 416
    for first_row in (-1, 417):
        with pytest.raises(ProtocolError):
            FrameFormat(width=640, height=64, first_row=first_row, full_height=480)


def test_a_band_of_frames_keeps_to_their_rows_and_says_which_there_are():
    whole = FrameFormat(width=640, height=480)
    assert whole.band((208, 272)) == FrameFormat(width=640, height=64, first_row=208, full_height=480)
    assert whole.band(None) is whole
    narrow = whole.band((100, 300))
    assert narrow.band((100, 300)) == narrow
    for rows in ((99, 200), (200, 301), (200, 200), (250, 200), (-1, 200), (-(2**63), 2**63)):
        with pytest.raises(ProtocolError, match=r"cannot be sent: the frames have rows 100:300"):
            narrow.band(rows)


@given(
    heights=st.lists(st.integers(1, 5), min_size=1, max_size=5),
    ahead=st.lists(st.integers(0, 2), min_size=5, max_size=5),
    cuts=st.lists(st.integers(0, 80)),
    seed=st.randoms(use_true_random=False),
)
@settings(derandomize=True, max_examples=60, deadline=None)
def test_told_from_which_frame_on_the_rows_change_it_misreads_no_frame_however_the_stream_is_cut(
    heights, ahead, cuts, seed
):
    """Two frames of each height; the switch to the next height is told that many frames ahead, or just in time."""
    whole = FrameFormat(width=3, height=5)
    formats = [whole.band((0, height)) for height in heights for _ in range(2)]
    sent = [seed.randbytes(frame_format.size_bytes) for frame_format in formats]
    stream = b"".join(sent)
    places = [0, *sorted(min(cut, len(stream)) for cut in cuts), len(stream)]
    decoder, frames = FrameDecoder(formats[0]), []
    switches = [(2 * n + 1, max(2 * n - ahead[n], 2 * n - 1)) for n in range(1, len(heights))]

    def tell():
        for number, when in switches:
            if decoder.frames == when and not decoder.pending:
                decoder.switch(formats[number - 1], number)

    for start, end in itertools.pairwise(places):
        part = stream[start:end]
        while part:
            tell()
            count = min(len(part), len(decoder.writable()))
            decoder.writable()[:count] = part[:count]
            frame = decoder.advance(count)
            frames += [bytes(frame)] if frame is not None else []
            part = part[count:]
    assert frames == sent


def test_a_switch_that_comes_too_late_is_told_and_changes_nothing():
    decoder = FrameDecoder(FORMAT)
    decoder.feed(FRAME + NEXT_FRAME[:5])
    for number in (0, 1, 2):
        with pytest.raises(ProtocolError, match="has begun to come"):
            decoder.switch(FORMAT.band((0, 1)), number)
    assert decoded(decoder, NEXT_FRAME[5:]) == [NEXT_FRAME]
    decoder.switch(FORMAT.band((0, 1)), 3)
    assert decoded(decoder, FRAME[:FRAME_WIDTH]) == [FRAME[:FRAME_WIDTH]]


def test_without_a_full_height_the_frame_is_the_whole_picture():
    assert FrameFormat(width=640, height=480).full_height == 480
    assert str(FrameFormat(width=640, height=480)) == "640x480"


def test_the_example_in_the_documentation_is_true():
    results = doctest.testmod(protocol.frames)
    assert results.attempted >= 3
    assert results.failed == 0
