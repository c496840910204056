"""The doctor's reasoning: what a figure means and which command it leads to."""

from __future__ import annotations

import math
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_agent.access import AllowList
from robot_agent.cameras.base import CameraFrame
from robot_agent.cli import main
from robot_agent.doctor import link
from robot_agent.doctor.calibration import drive_straight, new_trim, wheel_ratio
from robot_agent.doctor.camera import check_camera
from robot_agent.doctor.cli import without_names
from robot_agent.doctor.findings import Finding, Verdict, examine, line, summary
from robot_agent.doctor.machine import check_clock, power_finding
from robot_agent.errors import AgentError, UsageError
from robot_agent.robots.aseba_messages import NODE_PRESENT, AsebaDecoder, AsebaMessage
from robot_agent.robots.base import RobotState
from robot_agent.safety import SafetySettings
from tests.helpers import free_ports

BASE_CM = 9.4


def ended_at(trim: float, way_cm: float) -> tuple[float, float]:
    """Where a robot ends, integrated step by step: its right wheel is `trim` times as fast as its left."""
    x = y = heading = 0.0
    steps = 20_000
    left = 2 * way_cm / (1 + trim) / steps
    right = trim * left
    for _ in range(steps):
        heading += (right - left) / BASE_CM / 2
        x += (left + right) / 2 * math.cos(heading)
        y += (left + right) / 2 * math.sin(heading)
        heading += (right - left) / BASE_CM / 2
    return x, y


@pytest.mark.parametrize("trim", [0.9, 0.97, 1.0, 1.01, 1.08])
def test_the_ratio_of_the_wheels_is_found_from_where_the_robot_ended(trim):
    ran_cm, veered_cm = ended_at(trim, 60.0)
    assert (veered_cm > 0) == (trim > 1)  # a faster right wheel turns the robot to the left
    assert wheel_ratio(ran_cm, veered_cm, BASE_CM) == pytest.approx(trim, abs=1e-4)


@pytest.mark.parametrize(
    ("ran", "veered"), [(0, 0), (-5, 1), (50, 50), (50, -80), (2000, 1), (math.nan, 1), (50, math.nan)]
)
def test_a_run_that_is_none_is_wrong_usage(ran, veered):
    with pytest.raises(UsageError):
        wheel_ratio(ran, veered, BASE_CM)


def test_the_whole_units_that_were_asked_of_the_right_wheel_count():
    """With trim 0.995 at 200 units the right wheel is asked for 201, not for 201.005."""
    assert new_trim(1.02, 1.0, 200) == pytest.approx(1.02)
    assert new_trim(1.0, 0.995, 200) == pytest.approx(200 / 201)
    with pytest.raises(AgentError, match="hardly turns"):
        new_trim(3.0, 1.0, 200)


class Floor:
    """A robot whose state a test tells, on a clock that sleeping moves."""

    def __init__(self, **troubles: RobotState) -> None:
        self.now_s, self.asked = 0.0, []
        self.trouble_at_s, self.trouble = 1.0, troubles.get("trouble")

    def set_wheels(self, left: int, right: int) -> None:
        self.asked.append((self.now_s, left, right))

    def state(self) -> RobotState:
        return self.trouble if self.trouble and self.now_s >= self.trouble_at_s else RobotState(proximity=(0,) * 7)

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds

    def drive(self, stopped=lambda: False) -> None:
        drive_straight(self, 200, 3.0, stopped, safety=SafetySettings(), clock=lambda: self.now_s, sleep=self.sleep)


def test_it_drives_for_as_long_as_it_should_with_equal_wheels_and_then_stands():
    floor = Floor()
    floor.drive()
    asked = [(left, right) for _, left, right in floor.asked[:-1]]
    assert all(left == right for left, right in asked)
    assert [left for left, _ in asked] == sorted(left for left, _ in asked)
    assert asked[0][0] <= 10, "it starts slowly"
    assert all(units == (200, 200) for (at_s, *_), units in zip(floor.asked, asked, strict=False) if at_s > 1.01)
    assert floor.asked[-1] == (pytest.approx(3.0, abs=0.03), 0, 0)


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        (RobotState(proximity=(0, 0, 3000, 0, 0, 0, 0)), "obstacle in front"),
        (RobotState(proximity=(0,) * 7, ground=(900, 20)), "edge"),
        (RobotState(proximity=(0,) * 7, acceleration=(0, 20, 5)), "picked up"),
        (RobotState(problem="the robot is away"), "the robot is away"),
        (RobotState(proximity=(0,) * 7, button=True), "button"),
    ],
)
def test_on_any_doubt_the_wheels_stop_at_once(trouble, said):
    floor = Floor(trouble=trouble)
    with pytest.raises(AgentError, match=said):
        floor.drive()
    assert floor.asked[-1] == (pytest.approx(1.0, abs=0.03), 0, 0)


def test_a_hand_stops_it_and_a_driver_that_fails_is_told_to_stand():
    floor = Floor()
    with pytest.raises(AgentError, match="by hand"):
        floor.drive(stopped=lambda: floor.now_s > 0.5)
    assert floor.asked[-1] == (pytest.approx(0.5, abs=0.05), 0, 0)
    broken = Floor()
    broken.state = lambda: 1 / 0
    with pytest.raises(ZeroDivisionError):
        broken.drive()
    assert broken.asked == [(0.0, 0, 0)]


# -- figures and what they lead to -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("printed", "verdict", "said"),
    [
        ("throttled=0x0\n", Verdict.OK, "never throttled"),
        ("throttled=0x50000\n", Verdict.WARNING, "too little voltage since the start, was throttled"),
        ("throttled=0x50005\n", Verdict.FAILED, "too little voltage now"),
        ("VCHI initialization failed", Verdict.WARNING, "no answer"),
        ("", Verdict.WARNING, "no answer"),
    ],
)
def test_power_in_words(printed, verdict, said):
    finding = power_finding(printed)
    assert finding.verdict is verdict
    assert said in finding.said


def test_a_clock_without_a_battery_is_noticed():
    (finding,) = check_clock(now_s=0.0)
    assert finding.verdict is Verdict.WARNING
    assert "1970-01-01" in finding.said


WIFI = """Connected to 00:11:22:33:44:55 (on wlan0)
\tSSID: a name that is nobody's business
\tfreq: 2437
\tRX: 1342 bytes (12 packets)
\tsignal: -61 dBm
\trx bitrate: 65.0 MBit/s
\ttx bitrate: {} MBit/s
"""


@pytest.mark.parametrize(
    ("rate", "verdict", "mend"),
    [("433.3", Verdict.OK, ""), ("72.2", Verdict.WARNING, "--size 320x240"), ("6.5", Verdict.WARNING, "--fps 10")],
)
def test_wifi_against_what_the_frames_need(rate, verdict, mend):
    """640x480 at 30 takes 74 Mbit/s; a Pi 3 on 2.4 GHz has 72.2 on the air, half of it for TCP."""
    finding = link.wifi_finding("wlan0", WIFI.format(rate), link.needed_mbit_s(640, 480, 30.0))
    assert finding.verdict is verdict
    assert mend in finding.mend
    assert "74 needed" in finding.said
    assert "nobody" not in line(finding)
    assert "00:11" not in line(finding)


def test_wifi_that_is_not_connected():
    assert "not connected" in link.wifi_finding("wlan0", "Not connected.\n", 74.0).said


def test_a_link_is_measured_at_its_other_end(monkeypatch):
    """A real TCP connection; a sink that is slow is measured as slow."""
    monkeypatch.setattr(link, "MEASURE_S", 0.3)
    closing, told = threading.Event(), []
    with link.open_sink("127.0.0.1", 0) as listening:
        port = listening.getsockname()[1]
        arguments = (listening, AllowList(), closing.is_set, told.append)
        sink = threading.Thread(target=link.serve_sink, args=arguments)
        sink.start()
        try:
            (fast,) = link.check_link(("127.0.0.1", port), 74.0, 640 * 480)
            (slow,) = link.check_link(("127.0.0.1", port), 1e7, 640 * 480)
        finally:
            closing.set()
            sink.join()
    assert fast.verdict is Verdict.OK
    assert slow.verdict is Verdict.WARNING
    assert "--" in slow.mend
    assert len(told) == 2
    assert "Mbit/s from 127.0.0.1" in told[0]


def test_a_peer_that_is_no_sink_is_told_how_to_become_one(capsys):
    with pytest.raises(AgentError, match="doctor --sink"):
        link.measure("127.0.0.1", free_ports(), 1000, 0.1)


def test_ports_that_an_agent_holds_are_told_apart_from_free_ones():
    port = free_ports()
    (free,) = link.check_ports("127.0.0.1", port, "zservo-agent.service")
    assert free.verdict is Verdict.OK
    with link.open_sink("127.0.0.1", port + 1):
        (taken,) = link.check_ports("127.0.0.1", port, "zservo-agent.service")
    assert taken.verdict is Verdict.FAILED
    assert f"{port + 1} in use" in taken.said
    assert "systemctl --user stop zservo-agent.service" in taken.mend
    (elsewhere,) = link.check_ports("192.0.2.77", port, "zservo-agent.service")
    assert "cannot be listened on" in elsewhere.said


class StillCamera:
    """Gives the same picture every 1/15 s."""

    def __init__(self, gray: int) -> None:
        self.picture = np.full((24, 32), gray, np.uint8)

    def begin(self) -> None: ...

    def read(self, timeout_s: float) -> CameraFrame:
        time.sleep(1 / 15)
        return CameraFrame(self.picture, time.monotonic())

    def close(self) -> None: ...


def test_a_slow_camera_with_its_lid_on():
    rate, picture = check_camera(StillCamera(3), 30.0)
    assert rate.verdict is Verdict.WARNING
    assert "--fps 1" in rate.mend
    assert picture.verdict is Verdict.WARNING
    assert "lid" in picture.mend


def test_a_check_that_breaks_is_a_finding_and_the_others_go_on():
    def broken():
        yield Finding("a", Verdict.OK, "first")
        raise KeyError("x")

    told = []
    found = examine([("a", broken), ("b", lambda: [Finding("b", Verdict.OK, "fine")])], told.append)
    assert [finding.verdict for finding in found] == [Verdict.OK, Verdict.FAILED, Verdict.OK]
    assert told == found
    assert summary(found).startswith("1 to mend (a)")


def test_a_report_may_be_sent():
    text = without_names("/home/pi/x 192.168.0.7 127.0.0.1 0.0.0.0 tcp:lab-pc;33333 pi", "/home/pi", "pi")
    assert text == "~/x (address) 127.0.0.1 0.0.0.0 tcp:(host);33333 USER"


@given(st.lists(st.binary(max_size=300)), st.integers(0, 65535), st.binary(min_size=2, max_size=40))
def test_aseba_messages_come_out_as_they_went_in_however_they_are_cut(pieces, source, payload):
    messages = [AsebaMessage(source, NODE_PRESENT, payload)] + [AsebaMessage(1, 0x9000, piece) for piece in pieces]
    stream, decoder, found = b"".join(map(bytes, messages)), AsebaDecoder(), []
    for start in range(0, len(stream), 7):
        found += decoder.receive_data(stream[start : start + 7])
    assert found == messages
    assert found[0].protocol_version == int.from_bytes(payload[:2], "little")
    for message in found[1:]:
        assert message.protocol_version is None or 0 <= message.protocol_version < 65536


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--calibrate-wheels",), "on the floor"),
        (("--calibrate-wheels", "--robot", "thymio", "--ran-cm", "90"), "belong together"),
        (("--calibrate-wheels", "--robot", "thymio", "--run-s", "100"), "at most 60 s"),
        (("--calibrate-wheels", "--robot", "thymio", "--run-speed", "400"), "1 to 250"),
        (("--report", "/nowhere/report.txt"), "no folder"),
    ],
)
def test_wrong_usage(capsys, options, said):
    assert main(["doctor", *options]) == 2
    assert said in capsys.readouterr().err


def test_a_run_done_before_is_stored_without_driving(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    run = ("--calibrate-wheels", "--robot", "thymio", "--ran-cm", "100", "--veered-cm", "5")
    assert main(["doctor", *run]) == 0
    stored = (tmp_path / "zservo/robot.json").read_text()
    assert '"trim": 1.0094' in stored  # R = (100^2 + 5^2) / 10 = 1002.5 cm; (R + 4.7) / (R - 4.7)
