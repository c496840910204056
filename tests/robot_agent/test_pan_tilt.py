"""The pan-tilt: limits and slew as pure logic, ServoBlaster through a real FIFO, and what is told when it fails."""

from __future__ import annotations

import contextlib
import math
import os
import random
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from protocol import PanTiltLimits
from robot_agent.errors import PanTiltError, UsageError
from robot_agent.pantilt.servoblaster import ServoBlaster, ServoBlasterSettings
from robot_agent.pantilt.slew import PI_PAN, SERVO_LAG_S, Slew

LIMITS = PanTiltLimits(pan_rad=(-1.5, 1.0), tilt_rad=(-0.5, 0.75), slew_rad_s=2.0)


# -- slew --------------------------------------------------------------------------------------------------------------


def test_the_pi_pan_turns_by_180_and_110_degrees():
    assert [math.degrees(angle) for angle in PI_PAN.pan_rad] == pytest.approx([-90, 90])
    assert [math.degrees(angle) for angle in PI_PAN.tilt_rad] == pytest.approx([-55, 55])


def test_each_axis_runs_to_its_goal_at_the_slew_rate_and_stays():
    slew = Slew(LIMITS)
    slew.look(10.0, 0.8, -0.2)
    assert slew.at(9.0) == slew.at(10.0) == (0.0, 0.0)
    assert slew.at(10.05) == pytest.approx((0.1, -0.1))
    assert slew.at(10.2) == pytest.approx((0.4, -0.2))
    assert slew.arrival_s() == pytest.approx(10.4)
    assert slew.at(10.4) == slew.at(1e6) == pytest.approx((0.8, -0.2))


def test_a_new_goal_begins_where_the_camera_is_and_the_past_stays_what_it_was():
    slew = Slew(LIMITS)
    slew.look(0.0, 0.8, 0.0)
    slew.look(0.2, -0.4, 0.1)
    assert slew.at(0.1)[0] == pytest.approx(0.2)
    assert slew.at(0.2)[0] == pytest.approx(0.4)
    assert slew.at(0.3) == pytest.approx((0.2, 0.1))
    assert slew.at(0.6)[0] == pytest.approx(-0.4)


def test_asked_the_same_again_and_again_it_goes_on():
    slew = Slew(LIMITS)
    for tick in range(1000):
        slew.look(tick * 0.001, 0.8, 0.0)
    assert slew.at(0.1)[0] == pytest.approx(0.2)
    assert slew.at(1.0)[0] == pytest.approx(0.8)


def test_goals_beyond_the_limits_are_cut():
    slew = Slew(LIMITS)
    slew.look(0.0, 99.0, -99.0)
    assert slew.at(100.0) == (1.0, -0.5)
    slew.look(100.0, -99.0, 99.0)
    assert slew.at(200.0) == (-1.5, 0.75)


@pytest.mark.parametrize("wrong", [(math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0), (0.0, -math.inf)])
def test_what_is_no_angle_is_refused_and_changes_nothing(wrong):
    slew = Slew(LIMITS)
    slew.look(0.0, 0.5, 0.1)
    with pytest.raises(ValueError, match="cannot look"):
        slew.look(1.0, *wrong)
    with pytest.raises(ValueError, match="cannot look"):
        slew.look(math.nan, 0.0, 0.0)
    assert slew.at(2.0) == pytest.approx((0.5, 0.1))


def test_whatever_is_asked_it_never_leaves_the_limits_nor_outruns_the_slew_rate():
    rng, slew = random.Random(1), Slew(LIMITS)
    now_s, before = 0.0, (0.0, 0.0)
    for _ in range(3000):
        step_s = rng.uniform(0.0, 0.05)
        now_s += step_s
        pan, tilt = slew.at(now_s)
        assert LIMITS.clamped(pan, tilt) == pytest.approx((pan, tilt), abs=1e-9)
        assert max(abs(pan - before[0]), abs(tilt - before[1])) <= LIMITS.slew_rad_s * step_s + 1e-9
        before = pan, tilt
        if rng.random() < 0.3:
            slew.look(now_s, rng.uniform(-3, 3), rng.uniform(-3, 3))


def test_its_memory_is_bounded_and_older_times_give_the_oldest_place_known():
    slew = Slew(LIMITS)
    for index in range(2000):
        slew.look(index * 0.1, 0.1 * (-1) ** index, 0.0)
    assert len(slew._legs) <= 256
    assert abs(slew.at(0.0)[0]) <= 0.1


# -- ServoBlaster ------------------------------------------------------------------------------------------------------


class Servod:
    """The reading end of a real FIFO, opened as servod does, and the pulses that came through it."""

    def __init__(self, path: Path) -> None:
        os.mkfifo(path)
        self._path = path
        self._descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        self._rest = b""
        self.lines: list[str] = []

    def read(self) -> list[str]:
        """All lines so far, whole ones."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._descriptor, 4096):
                *lines, self._rest = (self._rest + data).split(b"\n")
                self.lines += [line.decode() for line in lines]
        return self.lines

    def pulses(self, servo: str) -> list[int]:
        return [int(line.partition("=")[2].removesuffix("us")) for line in self.read() if line.startswith(f"{servo}=")]

    def wait_for(self, *lines: str, timeout_s: float = 2.0) -> None:
        deadline_s = time.monotonic() + timeout_s
        while not set(lines) <= set(self.read()):
            assert time.monotonic() < deadline_s, (lines, self.lines)
            time.sleep(0.005)

    def end(self) -> None:
        os.close(self._descriptor)
        self._path.unlink()


@pytest.fixture
def servod(tmp_path: Path) -> Iterator[Servod]:
    daemon = Servod(tmp_path / "servoblaster")
    yield daemon
    with contextlib.suppress(OSError):
        daemon.end()


@pytest.fixture
def settings(tmp_path: Path) -> ServoBlasterSettings:
    return ServoBlasterSettings(device=str(tmp_path / "servoblaster"), pan_servo="2", tilt_servo="P1-7")


def test_angles_become_pulses_between_those_at_the_limits():
    settings = ServoBlasterSettings(pan_pulse_us=(600, 2400), tilt_pulse_us=(2000, 1000))
    assert settings.pulses_us(0.0, 0.0) == {"0": 1500, "1": 1500}
    assert settings.pulses_us(math.radians(90), math.radians(55)) == {"0": 2400, "1": 1000}
    assert settings.pulses_us(math.radians(-45), math.radians(-55)) == {"0": 1050, "1": 2000}


def test_pulses_are_whole_steps_of_servod_and_the_angle_told_is_the_one_they_make():
    settings = ServoBlasterSettings(pan_pulse_us=(600, 2400), tilt_pulse_us=(2000, 1000))
    for degrees, pulse in ((10.4, 1600), (10.6, 1610), (-0.6, 1490)):
        assert settings.pulses_us(math.radians(degrees), 0.0)["0"] == pulse
        assert settings.angles_rad(math.radians(degrees), 0.0) == pytest.approx((math.radians((pulse - 1500) / 10), 0))


@pytest.mark.parametrize(
    "wrong",
    [
        {"pan_servo": "left"},
        {"pan_servo": "0=1500us\n1"},
        {"tilt_servo": "P9-1"},
        {"pan_servo": "1"},
        {"pan_pulse_us": (400, 2400)},
        {"tilt_pulse_us": (1000, 2600)},
        {"tilt_pulse_us": (1500, 1500)},
    ],
    ids=str,
)
def test_what_servoblaster_would_not_understand_is_wrong_usage(wrong):
    with pytest.raises(UsageError):
        ServoBlasterSettings(**wrong)


def test_it_centres_walks_to_the_goal_at_the_slew_rate_and_centres_at_the_end(servod, settings):
    head = ServoBlaster(settings)
    servod.wait_for("2=1500us", "P1-7=1500us")
    begun_s = time.monotonic()
    head.look(math.radians(60), math.radians(-11))
    assert time.monotonic() - begun_s < 0.05
    servod.wait_for("2=2100us", "P1-7=1390us")
    pan = servod.pulses("2")
    assert pan == sorted(pan) and len(pan) >= 4  # 60 degrees at 300 a second are 0.2 s, ten periods
    time.sleep(SERVO_LAG_S + 0.01)
    assert head.angles_at(time.monotonic()) == pytest.approx((math.radians(60), math.radians(-11)))
    head.close()
    head.close()
    assert (servod.pulses("2")[-1], servod.pulses("P1-7")[-1]) == (1500, 1500)
    back = servod.pulses("2")[len(pan) :]
    assert back == sorted(back, reverse=True) and len(back) >= 4
    assert all(500 <= pulse <= 2500 for pulse in servod.pulses("2") + servod.pulses("P1-7"))


def test_at_rest_nothing_is_written(servod, settings):
    head = ServoBlaster(settings)
    servod.wait_for("2=1500us")
    count = len(servod.read())
    head.look(0.0, 0.0)
    time.sleep(0.1)
    assert len(servod.read()) == count
    head.close()


def test_it_tells_where_the_camera_looked_when_the_picture_was_taken(servod, settings):
    class Clock:
        now_s = 100.0

    head = ServoBlaster(settings, clock=lambda: Clock.now_s)
    head.look(math.radians(90), 0.0)
    Clock.now_s = 100.2 + SERVO_LAG_S
    at = [math.degrees(head.angles_at(100.0 + SERVO_LAG_S + after_s)[0]) for after_s in (-0.01, 0.0, 0.1, 0.2)]
    assert at == pytest.approx([0.0, 0.0, 30.0, 60.0])
    assert head.angles_at(5.0) == head.angles_at(Clock.now_s)  # a recording's time
    threading.Timer(0.1, setattr, (Clock, "now_s", 200.0)).start()
    head.close()
    assert servod.pulses("2")[-1] == 1500


@pytest.mark.parametrize("kind", ["nothing", "a file", "no reader", "a folder"])
def test_a_device_that_is_none_is_one_clear_sentence_at_once(tmp_path, settings, kind):
    device = Path(settings.device)
    if kind == "a file":
        device.touch()
    elif kind == "no reader":
        os.mkfifo(device)
    elif kind == "a folder":
        device.mkdir()
    begun_s = time.monotonic()
    with pytest.raises(PanTiltError) as told:
        ServoBlaster(settings)
    assert time.monotonic() - begun_s < 0.2
    text = str(told.value)
    assert str(device) in text and "\n" not in text
    assert kind == "a folder" or "start ServoBlaster (sudo servod)" in text


def test_a_full_fifo_holds_nobody_up_and_gets_the_newest_pulse_later(servod, settings):
    head = ServoBlaster(settings)
    servod.wait_for("2=1500us")
    stuffing = os.open(settings.device, os.O_WRONLY | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(stuffing, b"#" * 4095 + b"\n")
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(stuffing, b"\n")
    begun_s = time.monotonic()
    head.look(math.radians(90), 0.0)
    assert time.monotonic() - begun_s < 0.05
    time.sleep(0.4)
    servod.wait_for("2=2400us")
    assert servod.pulses("2") == [1500, 2400]
    os.close(stuffing)
    head.close()


def test_a_reader_that_never_reads_does_not_hold_up_the_end(servod, settings):
    head = ServoBlaster(settings)
    stuffing = os.open(settings.device, os.O_WRONLY | os.O_NONBLOCK)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(stuffing, b"\n" * 512)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(stuffing, b"\n")
    head.look(math.radians(30), 0.0)
    begun_s = time.monotonic()
    head.close()
    assert time.monotonic() - begun_s < 2.0
    os.close(stuffing)


def test_a_daemon_that_ends_is_told_and_found_again_when_it_is_back(servod, settings, tmp_path):
    head = ServoBlaster(settings)
    servod.wait_for("2=1500us")
    servod.end()
    head.look(0.5, 0.0)
    deadline_s = time.monotonic() + 2.0
    with pytest.raises(PanTiltError, match="servo"):
        while time.monotonic() < deadline_s:
            head.look(0.5, 0.0)
            time.sleep(0.01)
    again = Servod(tmp_path / "servoblaster")
    again.wait_for("P1-7=1500us", f"2={settings.pulses_us(0.5, 0.0)['2']}us")
    head.look(0.0, 0.0)
    again.wait_for("2=1500us")
    head.close()
    again.end()
