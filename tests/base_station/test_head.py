"""The camera's head as the station has it: the loop never waits, the newest goal wins, trouble is said once."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator

import pytest
import zmq

from base_station.head import HeadAngles, PanHead
from base_station.sockets import ControlLine
from protocol import FrameStamp, PanTiltLimits, Reply, Request, decode_request, encode
from tests.helpers import LOOPBACK, free_ports, wait_until

REACH = PanTiltLimits(pan_rad=(-1.5, 1.5), tilt_rad=(-0.9, 0.9), slew_rad_s=5.0)


class Agent:
    """A real REP socket that answers looks; `gate` holds its answers back."""

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

    def close(self) -> None:
        self.gate.set()
        self._closing.set()
        self._thread.join()


@pytest.fixture
def wired() -> Iterator[Callable[[], tuple[PanHead, Agent]]]:
    context, closing = zmq.Context(), []

    def make() -> tuple[PanHead, Agent]:
        port = free_ports()
        agent = Agent(context, port)
        head = PanHead(REACH, ControlLine(context, LOOPBACK, port))
        closing.extend((head.close, agent.close))
        return head, agent

    yield make
    for close in closing:
        close()
    context.destroy(linger=0)


def test_a_goal_reaches_the_robot_cut_to_the_limits(wired):
    head, agent = wired()
    head.look(9.0)
    assert head.settle(2.0)
    assert [(request.action, request.pan_rad, request.tilt_rad) for request in agent.asked] == [("look", 1.5, 0.0)]


def test_the_loop_never_waits_and_the_newest_goal_wins(wired):
    head, agent = wired()
    agent.gate.clear()
    head.look(0.01)
    wait_until(lambda: agent.asked, 2.0, "the first goal")
    begun_s = time.monotonic()
    for index in range(200):
        head.look(0.02 + index * 0.001)
    assert time.monotonic() - begun_s < 0.1
    assert not head.settle(0.02)
    agent.gate.set()
    assert head.settle(2.0)
    assert agent.pans == [0.01, pytest.approx(0.219)]


def test_at_the_end_the_camera_is_centred(wired):
    head, agent = wired()
    head.look(0.7)
    head.settle(2.0)
    head.close()
    assert agent.pans == [0.7, 0.0]


def test_a_refusal_is_said_once(wired, caplog):
    head, agent = wired()
    agent.reply = Reply(ok=False, error="the servos are gone")
    with caplog.at_level(logging.WARNING):
        for pan_rad in (0.1, 0.2, 0.3):
            head.look(pan_rad)
            assert head.settle(2.0)
    assert [record.message for record in caplog.records] == ["the robot does not turn its camera: the servos are gone"]


def test_a_robot_that_does_not_answer_is_asked_anew_later(wired, caplog):
    head, agent = wired()
    agent.gate.clear()
    with caplog.at_level(logging.WARNING):
        head.look(0.1)
        assert head.settle(2.0)  # given up after half a second
    assert "gives no answer" in caplog.text
    agent.gate.set()
    head.look(0.2)
    assert head.settle(2.0)
    assert agent.pans[-1] == 0.2


def stamp(number: int, pan_rad: float | None) -> FrameStamp:
    tilt_rad = None if pan_rad is None else 0.0
    return FrameStamp(connection=1, number=number, capture_s=0.0, dropped=0, pan_rad=pan_rad, tilt_rad=tilt_rad)


def test_angles_are_those_of_the_frame_and_late_ones_the_newest_of_the_connection():
    angles = HeadAngles()
    angles.note("a", stamp(1, 0.1))
    angles.note("a", stamp(2, 0.2))
    angles.note("b", stamp(1, 0.9))
    assert angles.of(("a", 1)) == (0.1, 0.0)
    assert angles.of(("a", 3)) == (0.2, 0.0)
    assert angles.of(("c", 1)) is None


def test_a_fixed_camera_has_no_angles_and_memory_is_bounded():
    angles = HeadAngles()
    angles.note("a", stamp(1, None))
    assert angles.of(("a", 1)) is None
    for number in range(2, 2000):
        angles.note("a", stamp(number, 0.1))
    assert len(angles._known) <= 256
