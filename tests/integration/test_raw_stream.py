"""The raw ports, byte for byte, with clients that know nothing else: whole frames, the newest first, both rhythms."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers import (
    Operator,
    Programs,
    RawStation,
    TelemetryLog,
    numbered_picture,
    picture_number,
    write_pictures,
)

FRAME_BYTES = 160 * 120


def test_lockstep_waits_for_the_command(programs: Programs, port: int, pictures: Path) -> None:
    """In lockstep the second frame comes after the first command, not before, and none is skipped."""
    programs.replay(port, pictures, "--rhythm", "lockstep")
    with RawStation(port, FRAME_BYTES) as station:
        for number in range(1, 31):
            assert picture_number(station.read_frame()) == number
            if number == 1:
                station.frames.settimeout(0.3)
                with pytest.raises(TimeoutError):
                    station.frames.recv(1)
            station.send(0, 0)


def test_lockstep_commands_sent_ahead_are_each_answered(programs: Programs, port: int, pictures: Path) -> None:
    """Ten commands in one packet are ten exchanges: a byte stream has no packets."""
    programs.replay(port, pictures, "--rhythm", "lockstep")
    with RawStation(port, FRAME_BYTES) as station:
        station.commands.sendall(b"\x0a\x0a" * 10)
        numbers = [picture_number(station.read_frame()) for _ in range(11)]
        assert numbers == list(range(1, 12))
        station.frames.settimeout(0.3)
        with pytest.raises(TimeoutError):
            station.frames.recv(1)


def test_slow_station_gets_fresh_whole_frames(
    programs: Programs, port: int, tmp_path: Path, listen: Callable[[], TelemetryLog]
) -> None:
    """After 3 s without reading there is no queue: two old frames at the most, then fresh ones; all whole; the rest is
    counted as dropped; and the n-th frame received is number n in telemetry."""
    width, height = 320, 240
    recording = write_pictures(tmp_path / "recording", 200, width, height)
    programs.replay(port, recording)
    telemetry = listen()
    with RawStation(port, width * height, receive_buffer=width * height // 2) as station:
        received = [station.read_frame() for _ in range(5)]
        time.sleep(3.0)
        late_s = time.monotonic()
        received += [station.read_frame() for _ in range(20)]
        took_s = time.monotonic() - late_s
        telemetry.wait_for(lambda message: message.frame is not None and message.frame.number >= 25, what="frame 25")

    numbers = [picture_number(frame) for frame in received]
    for number, frame in zip(numbers, received, strict=True):
        assert frame == numbered_picture(number, width, height).tobytes(), "a frame that is not whole"
    assert numbers == sorted(set(numbers))
    before_s_worth = numbers[4] + 80  # 3 s are 90 pictures
    old = [number for number in numbers[5:] if number < before_s_worth]
    assert len(old) <= 2, f"a queue: {numbers}"
    assert took_s > 0.4, "fresh frames come at the camera's pace"

    stamps = {m.frame.number: m.frame for m in telemetry.messages if m.frame is not None}
    for count, number in enumerate(numbers, 1):
        if count in stamps:
            assert stamps[count].capture_s == pytest.approx((number - 1) / 30, abs=1e-6)
    assert len(stamps.keys() & set(range(1, 26))) > 20
    missing = (numbers[-1] - numbers[0] + 1) - len(numbers)
    assert missing > 60
    assert stamps[25].dropped == missing


def test_numbers_begin_anew_with_each_connection(
    programs: Programs, port: int, pictures: Path, listen: Callable[[], TelemetryLog]
) -> None:
    """Frame numbers count what was written to this connection; drops of the one before are not carried on."""
    programs.replay(port, pictures)
    telemetry = listen()
    addresses = []
    for _ in range(2):
        with RawStation(port, FRAME_BYTES) as station:
            addresses.append(station.address)
            for _ in range(5):
                station.read_frame()
        telemetry.wait_for(
            lambda message: message.station is None and message.frame is None,
            since_s=time.monotonic(),
            what="no station",
        )
    for connection, address in enumerate(addresses, 1):
        stamps = [m.frame for m in telemetry.messages if m.station == address and m.frame is not None]
        stamps = [stamp for stamp in stamps if stamp.connection == connection]
        assert (stamps[0].number, stamps[0].dropped) == (1, 0)
        assert stamps[-1].number >= 5


def test_band_of_rows(programs: Programs, port: int, pictures: Path, operator: Operator) -> None:
    """--rows sends just these rows of each picture; hello tells which, in what picture."""
    programs.replay(port, pictures, "--rows", "40:56", "--rhythm", "lockstep")
    hello = operator.hello()
    assert (hello.width, hello.height, hello.first_row, hello.full_height) == (160, 16, 40, 120)
    with RawStation(port, 160 * 16) as station:
        for number in range(1, 6):
            assert station.read_frame() == numbered_picture(number)[40:56].tobytes()
            station.send(0, 0)


def test_other_size(programs: Programs, port: int, pictures: Path, operator: Operator) -> None:
    """--size scales the recording, and frames have that many bytes."""
    programs.replay(port, pictures, "--size", "80x60", "--rhythm", "lockstep")
    assert (operator.hello().width, operator.hello().height) == (80, 60)
    with RawStation(port, 80 * 60) as station:
        station.read_frame()
        station.send(0, 0)
        second = station.read_frame()
        station.frames.settimeout(0.2)
        with pytest.raises(TimeoutError):
            station.frames.recv(1)
    assert len(set(second)) > 50, "a picture, not a plain"
