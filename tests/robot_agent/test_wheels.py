"""The wheels' master: commands die with their connection, and a robot that fails is stopped as far as it can be."""

from __future__ import annotations

import socket
from collections.abc import Callable

import pytest

from protocol import Command, RobotLimits
from robot_agent.access import AllowList
from robot_agent.ports import Peer, StationPort
from robot_agent.robots.base import RobotState
from robot_agent.safety import SafetyState, SafetySupervisor
from robot_agent.wheels import Wheels


class BreakableRobot:
    """The outermost edge, faked: notes what it is asked, and fails on request."""

    kind = "breakable"
    limits = RobotLimits()

    def __init__(self) -> None:
        self.asked: list[tuple[int, int]] = []
        self.broken: set[str] = set()
        self.senses = RobotState()

    def set_wheels(self, left: int, right: int) -> None:
        if "wheels" in self.broken:
            raise OSError("no such wheels")
        self.asked.append((left, right))

    def state(self) -> RobotState:
        if "state" in self.broken:
            raise OSError("no such sensors")
        return self.senses

    def close(self) -> None: ...


class Bench:
    """Wheels between two real ports and a breakable robot, at a time of the test's choosing."""

    def __init__(self) -> None:
        self.robot, self.now_s, self.changes = BreakableRobot(), 10.0, 0
        make: Callable[[str], StationPort] = lambda name: StationPort(  # noqa: E731
            name, "127.0.0.1", 0, allow=AllowList(), on_change=lambda: None, partner_host=lambda: None
        )
        self.frames, self.commands = make("frames"), make("commands")
        self.wheels = Wheels(
            self.robot,
            SafetySupervisor(),
            frame_port=self.frames,
            command_port=self.commands,
            speed_scale=2.0,
            clock=lambda: self.now_s,
            on_change=self._changed,
        )

    def _changed(self) -> None:
        self.changes += 1

    def connect(self, port: StationPort) -> Peer:
        """A station, as the port's accepting thread takes it in."""
        ours, self._theirs = socket.socketpair()
        assert port._admit(ours, "127.0.0.1", "127.0.0.1:1") == ""
        assert port.peer is not None
        return port.peer


@pytest.fixture
def bench():
    made = Bench()
    yield made
    made.frames.close()
    made.commands.close()


@pytest.fixture(autouse=True)
def tuning_is_for_tcp(monkeypatch):
    monkeypatch.setattr("robot_agent.ports._tune", lambda connection: connection.setblocking(False))


def test_a_command_is_scaled_and_obeyed(bench):
    peer = bench.connect(bench.commands)
    bench.wheels.picture_came()
    bench.wheels.take_command(Command(10, -20), peer)
    assert bench.robot.asked[-1] == (20, -40)
    assert bench.wheels.decision.state is SafetyState.OK


def test_a_command_of_a_station_that_went_never_moves_the_wheels_for_the_next_one(bench):
    """Not even when it is taken from the socket's buffer after its connection ended."""
    bench.wheels.picture_came()
    gone = bench.connect(bench.commands)
    bench.wheels.take_command(Command(50, 50), gone)
    bench.commands.drop(gone, "test")
    bench.connect(bench.commands)
    bench.wheels.decide()
    assert bench.robot.asked[-1] == (0, 0) and bench.wheels.decision.reason == "no command yet"
    bench.wheels.take_command(Command(60, 60), gone)
    assert bench.robot.asked[-1] == (0, 0)


def test_a_station_that_had_frames_and_loses_them_stops_one_that_never_asked_for_any_may_drive(bench):
    bench.wheels.picture_came()
    commander = bench.connect(bench.commands)
    bench.wheels.take_command(Command(5, 5), commander)
    assert bench.robot.asked[-1] == (10, 10)
    watcher = bench.connect(bench.frames)
    bench.wheels.decide()
    assert bench.robot.asked[-1] == (10, 10)
    bench.frames.drop(watcher, "test")
    bench.wheels.decide()
    assert bench.robot.asked[-1] == (0, 0)
    assert bench.wheels.decision.reason == "no station is connected"


@pytest.mark.parametrize("broken", ["state", "wheels"])
def test_a_robot_that_fails_is_told_to_stop_and_the_failure_is_kept(bench, broken):
    peer = bench.connect(bench.commands)
    bench.wheels.picture_came()
    bench.wheels.take_command(Command(50, 50), peer)
    bench.robot.broken = {broken}
    bench.wheels.decide()
    assert "OSError" in bench.wheels.robot_failure
    assert bench.wheels.decision.state is SafetyState.STOPPED
    if broken == "state":
        assert bench.robot.asked[-1] == (0, 0)


def test_waiting_for_a_slow_station_is_not_blamed_on_the_camera(bench):
    peer = bench.connect(bench.commands)
    bench.wheels.picture_came()
    with bench.wheels.awaiting_command():
        bench.wheels.take_command(Command(5, 5), peer)
        bench.now_s += 3.0
        bench.wheels.decide()
        assert bench.wheels.decision.reason.startswith("no command for")
    bench.wheels.take_command(Command(5, 5), peer)
    assert "camera hangs" in bench.wheels.decision.reason


def test_a_camera_found_silent_stops_until_a_picture_comes(bench):
    peer = bench.connect(bench.commands)
    bench.wheels.picture_came()
    bench.wheels.camera_is_silent("the camera hangs")
    bench.wheels.take_command(Command(5, 5), peer)
    assert bench.robot.asked[-1] == (0, 0) and bench.wheels.decision.reason == "the camera hangs"
    bench.wheels.picture_came()
    bench.wheels.decide()
    assert bench.robot.asked[-1] == (10, 10)


def test_news_are_told_once_and_not_for_every_new_figure_in_a_reason(bench):
    peer = bench.connect(bench.commands)
    bench.wheels.picture_came()
    bench.wheels.take_command(Command(5, 5), peer)
    told = bench.changes
    for _ in range(5):
        bench.now_s += 0.6
        bench.wheels.picture_came()
        bench.wheels.decide()
    assert bench.changes == told + 1, "no command for 600 ms, 1200 ms, ... is one piece of news"


def test_what_is_forbidden_stays_forbidden_for_the_first_reason(bench):
    peer = bench.connect(bench.commands)
    bench.wheels.picture_came()
    bench.wheels.forbid("the agent ends")
    bench.wheels.forbid("later")
    bench.wheels.take_command(Command(50, 50), peer)
    assert bench.robot.asked[-1] == (0, 0) and bench.wheels.decision.reason == "the agent ends"


def test_the_robots_own_button_stops_and_releases(bench):
    peer = bench.connect(bench.commands)
    bench.wheels.picture_came()

    def press() -> None:
        for held in (True, True, False):  # held over several looks is one press
            bench.robot.senses = RobotState(button=held)
            bench.wheels.take_command(Command(5, 5), peer)

    press()
    assert bench.robot.asked[-1] == (0, 0)
    assert bench.wheels.decision.reason == "emergency stop: the robot's button"
    press()
    assert bench.robot.asked[-1] == (10, 10)


def test_a_robot_that_is_away_is_not_driven_until_it_is_back(bench):
    peer = bench.connect(bench.commands)
    bench.wheels.picture_came()
    bench.robot.senses = RobotState(problem="the robot is away")
    bench.wheels.take_command(Command(5, 5), peer)
    assert bench.robot.asked[-1] == (0, 0) and bench.wheels.decision.reason == "the robot is away"
    bench.robot.senses = RobotState()
    bench.wheels.decide()
    assert bench.robot.asked[-1] == (10, 10)


class LitRobot(BreakableRobot):
    """One with lights."""

    def __init__(self) -> None:
        super().__init__()
        self.shown: list[str] = []

    def show(self, what: str) -> None:
        if "lights" in self.broken:
            raise OSError("no such lights")
        self.shown.append(what)


@pytest.fixture
def lit(bench):
    """The bench with a robot that has lights."""
    bench.robot = LitRobot()
    bench.wheels._robot = bench.robot
    return bench


def test_the_lights_tell_what_the_station_sees_while_the_wheels_may_turn(lit):
    lit.wheels.decide()
    peer = lit.connect(lit.commands)
    lit.wheels.picture_came()
    lit.wheels.take_command(Command(5, 5), peer)
    lit.wheels.station_sees("tracking")
    for _ in range(3):
        lit.wheels.decide()
    lit.now_s += 0.6
    lit.wheels.decide()
    assert lit.robot.shown == ["stopped", "idle", "tracking", "stopped"], "each change once"


def test_the_next_station_does_not_inherit_what_the_last_one_saw(lit):
    peer = lit.connect(lit.commands)
    lit.wheels.picture_came()
    lit.wheels.take_command(Command(5, 5), peer)
    lit.wheels.station_sees("lost")
    lit.commands.drop(peer, "test")
    lit.wheels.decide()
    lit.wheels.take_command(Command(5, 5), lit.connect(lit.commands))
    assert lit.robot.shown == ["idle", "lost", "stopped", "idle"]


def test_lights_that_fail_are_a_robot_that_failed(lit):
    peer = lit.connect(lit.commands)
    lit.wheels.picture_came()
    lit.robot.broken.add("lights")
    lit.wheels.take_command(Command(5, 5), peer)
    assert "no such lights" in lit.wheels.robot_failure and lit.robot.asked[-1] == (0, 0)
