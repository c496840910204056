"""What is asked of the robot beside the loop: the loop never waits, the newest request wins, trouble is said once."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterator
from contextlib import closing

import pytest
import zmq

from base_station.announcer import Announcer
from base_station.courier import Courier
from base_station.head import PanHead
from base_station.sockets import ControlLine
from protocol import PanTiltLimits, Reply, Request, decode_request, encode
from tests.helpers import LOOPBACK, free_ports, wait_until

REACH = PanTiltLimits(pan_rad=(-1.5, 1.5), tilt_rad=(-0.9, 0.9), slew_rad_s=5.0)


class Robot:
    """A real REP socket that answers requests; `gate` holds its answers back."""

    def __init__(self, context: zmq.Context, port: int) -> None:
        self.asked: list[Request] = []
        self.reply = Reply(ok=True)
        self.gate = threading.Event()
        self.gate.set()
        self._closing = threading.Event()
        self._socket = context.socket(zmq.REP)
        self._socket.linger = 0
        self._socket.bind(f"tcp://{LOOPBACK}:{port}")
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def _serve(self) -> None:
        while not self._closing.is_set():
            if self._socket.poll(20):
                self.asked.append(decode_request(self._socket.recv()))
                self.gate.wait(5.0)
                self._socket.send(encode(self.reply))
        self._socket.close()

    @property
    def pans(self) -> list[float]:
        return [request.pan_rad for request in self.asked]

    @property
    def shown(self) -> list[str]:
        return [request.text for request in self.asked if request.action == "show"]

    def close(self) -> None:
        self.gate.set()
        self._closing.set()
        self._thread.join()


@pytest.fixture
def wired() -> Iterator[tuple[ControlLine, Robot]]:
    """A line to a robot."""
    context, port = zmq.Context(), free_ports()
    with closing(Robot(context, port)) as robot:
        yield ControlLine(context, LOOPBACK, port), robot
    context.destroy(linger=0)


def look(pan_rad: float) -> Request:
    return Request(action="look", pan_rad=pan_rad)


def test_the_loop_never_waits_and_the_newest_request_wins(wired):
    line, robot = wired
    with closing(Courier(line)) as courier:
        robot.gate.clear()
        courier.send(look(0.01))
        wait_until(lambda: robot.asked, 2.0, "the first request")
        begun_s = time.monotonic()
        for index in range(200):
            courier.send(look(0.02 + index * 0.001))
        assert time.monotonic() - begun_s < 0.1
        assert not courier.settle(0.02)
        robot.gate.set()
        assert courier.settle(2.0)
    assert robot.pans == [0.01, pytest.approx(0.219)]


def test_a_refusal_is_said_once_and_as_loud_as_asked(wired, caplog):
    line, robot = wired
    robot.reply = Reply(ok=False, error="the servos are gone")
    with caplog.at_level(logging.INFO), closing(Courier(line, complain_at=logging.INFO)) as courier:
        for pan_rad in (0.1, 0.2, 0.3):
            courier.send(look(pan_rad))
            assert courier.settle(2.0)
    (record,) = caplog.records
    assert (record.levelname, record.message) == ("INFO", "the robot refuses to look: the servos are gone")


def test_a_robot_that_does_not_answer_is_asked_anew_later(wired, caplog):
    line, robot = wired
    robot.gate.clear()
    with caplog.at_level(logging.WARNING), closing(Courier(line)) as courier:
        courier.send(look(0.1))
        assert courier.settle(2.0)  # given up after half a second
        assert "cannot be asked to look" in caplog.text
        robot.gate.set()
        courier.send(look(0.2))
        assert courier.settle(2.0)
    assert robot.pans[-1] == 0.2


def test_the_camera_s_goal_reaches_the_robot_cut_to_the_limits_and_it_is_centred_at_the_end(wired):
    line, robot = wired
    with closing(PanHead(REACH, line)) as head:
        head.look(9.0)
        assert head.settle(2.0)
    assert [(request.action, request.pan_rad, request.tilt_rad) for request in robot.asked] == [
        ("look", 1.5, 0.0),
        ("look", 0.0, 0.0),
    ]


def test_the_lights_are_told_changes_only_and_a_new_connection_is_told_again(wired):
    line, robot = wired
    with closing(Announcer(line)) as announcer:
        announcer.say("tracking", "a")
        wait_until(lambda: robot.shown == ["tracking"], 2.0, "the first word")
        announcer.say("tracking", "a")
        announcer.say("lost", "a")
        wait_until(lambda: robot.shown == ["tracking", "lost"], 2.0, "the change")
        announcer.say("lost", "b")
        wait_until(lambda: robot.shown == ["tracking", "lost", "lost"], 2.0, "the new connection's")
        announcer.say("lost", "b")
    assert len(robot.shown) == 3
