"""What a Thymio's variables mean to the agent: the class that both drivers share, with a driver of lists and no bus."""

from __future__ import annotations

import logging

import pytest

from robot_agent.errors import AgentError
from robot_agent.robots.thymio_node import DARK, LEFT_SPEED, RIGHT_SPEED, ThymioNode
from robot_agent.safety import LinkState, SafetyState, SafetySupervisor, WheelCommand


class ListedThymio(ThymioNode):
    """The outermost edge, faked: notes what would be written, and answers what the test says."""

    kind = "listed"

    def __init__(self, *, trim: float = 1.0, obeys: bool = True) -> None:
        self.now_s, self.obeys, self.connected = 100.0, obeys, True
        super().__init__(trim=trim, clock=lambda: self.now_s)
        self.written: list[tuple[tuple[int, int], tuple[int, int, int]]] = []
        self.has_come()
        for name, values in (("prox.horizontal", [0] * 7), ("prox.ground.delta", [900, 900]), ("acc", [0, 0, 22])):
            self.keep(name, values)

    def _write_soon(self) -> None:
        self.written.append(self.wanted())

    def _read_back(self) -> None:
        left, right = self.wanted()[0] if self.obeys else (40, 40)
        self.targets_read_back([left], [right])

    def _disconnect(self) -> None:
        self.connected = False


def allowed(robot: ListedThymio, left: float = 100.0, right: float = 100.0) -> tuple[SafetyState, str, int, int]:
    """What the supervisor makes of the robot's state when everything else is well."""
    state, now_s = robot.state(), 100.0
    decision = SafetySupervisor().step(
        now_s,
        WheelCommand(left, right, now_s),
        state.proximity,
        LinkState(connected=True, last_frame_s=now_s, problem=state.problem),
        ground=state.ground,
        acceleration=state.acceleration,
    )
    return decision.state, decision.reason, decision.left, decision.right


def test_a_level_robot_on_a_light_floor_drives():
    assert allowed(ListedThymio()) == (SafetyState.OK, "", 100, 100)


@pytest.mark.parametrize("ground", [[20, 900], [900, 20], [0, 0]])
def test_it_stops_at_an_edge_and_may_turn_and_back_off(ground):
    robot = ListedThymio()
    robot.keep("prox.ground.delta", ground)
    assert allowed(robot) == (SafetyState.LIMITED, "an edge in front", 0, 0)
    assert allowed(robot, -50, -50)[:1] == (SafetyState.OK,)
    assert allowed(robot, 0, 100)[2:] == (-50, 50)


@pytest.mark.parametrize("acc", [[16, 0, 16], [-16, 0, 16], [0, 16, 16], [0, -16, 16], [0, 0, -22], [22, 0, 0]])
def test_it_stops_when_it_is_picked_up(acc):
    robot = ListedThymio()
    robot.keep("acc", acc)
    state, reason, left, right = allowed(robot)
    assert (state, left, right) == (SafetyState.STOPPED, 0, 0) and "picked up" in reason


def test_the_centre_button_is_the_state_s():
    robot = ListedThymio()
    assert not robot.state().button
    robot.keep("button.center", [1])
    assert robot.state().button
    robot.now_s += 1.1
    assert not robot.state().button, "what was long ago says nothing"


def test_the_battery_is_in_volts_and_stays_known_for_long():
    """The firmware lights three battery lights from 3.9 V on, which is a sum of 1551."""
    robot = ListedThymio()
    assert robot.state().battery_v is None
    robot.keep("_vbat", [775, 776])
    assert robot.state().battery_v == pytest.approx(3.9, abs=0.005)
    robot.now_s += 20
    assert robot.state().battery_v is not None
    robot.now_s += 20
    assert robot.state().battery_v is None


def test_a_robot_that_tells_too_little_tells_nothing():
    robot = ListedThymio()
    for name, values in (("prox.ground.delta", [900]), ("acc", [0, 0]), ("_vbat", [775]), ("button.center", [])):
        robot.keep(name, values)
    state = robot.state()
    assert (state.ground, state.acceleration, state.battery_v, state.button) == (None, None, None, False)


def test_a_silent_robot_and_one_that_went_are_problems():
    robot = ListedThymio()
    robot.now_s += 0.7
    assert "does not answer, its wheels are unknown" in robot.state().problem
    assert allowed(robot)[0] is SafetyState.STOPPED
    robot.set_wheels(50, 50)
    robot.has_gone("it was unplugged")
    assert robot.state().problem == "the robot is away, its wheels are unknown: it was unplugged"
    assert robot.wanted()[0] == (0, 0), "what was wanted is not wanted on its return"
    robot.has_come()
    robot.keep("prox.horizontal", [0] * 7)
    assert robot.state().problem == ""


@pytest.mark.parametrize(
    ("trim", "asked", "targets"),
    [
        (1.0, (100, 100), (100, 100)),
        (1.25, (100, 100), (100, 80)),
        (0.8, (100, 100), (100, 125)),
        (0.8, (500, 500), (400, 500)),
        (0.5, (-500, 500), (-250, 500)),
        (2.0, (500, -500), (500, -250)),
    ],
)
def test_the_trim_makes_equal_speeds_and_keeps_the_curve_at_the_limit(trim, asked, targets):
    robot = ListedThymio(trim=trim)
    robot.set_wheels(*asked)
    assert robot.wanted()[0] == targets
    robot.keep(LEFT_SPEED, [targets[0]])
    robot.keep(RIGHT_SPEED, [targets[1]])
    left, right = robot.state().wheels_measured
    assert left / right == pytest.approx(asked[0] / asked[1]), "told in the units that were asked in"


@pytest.mark.parametrize("trim", [0.49, 2.01, float("nan"), 0.0, -1.0])
def test_a_trim_out_of_range_is_refused(trim):
    with pytest.raises(AgentError, match=r"from 0\.5 to 2"):
        ListedThymio(trim=trim)


def test_only_a_change_is_written():
    robot = ListedThymio()
    for _ in range(3):
        robot.set_wheels(10, 20)
    robot.set_wheels(10, 21)
    assert [targets for targets, _ in robot.written] == [(10, 20), (10, 21)]


def test_the_lights():
    robot = ListedThymio()
    colours = set()
    for what in ("tracking", "lost", "idle", "stopped"):
        robot.show(what)
        colours.add(robot.wanted()[1])
    assert len(colours) == 4 and DARK not in colours
    robot.close()
    assert robot.wanted()[1] == DARK


def test_at_its_end_it_stops_and_asks_whether_it_stands(caplog):
    robot = ListedThymio()
    robot.set_wheels(40, 40)
    with caplog.at_level(logging.ERROR):
        robot.close()
    assert robot.wanted()[0] == (0, 0) and not robot.connected and not caplog.records


def test_a_robot_that_does_not_stop_is_told_at_the_end(caplog, monkeypatch):
    monkeypatch.setattr("robot_agent.robots.thymio_node.CONFIRM_S", 0.3)
    robot = ListedThymio(obeys=False)
    with caplog.at_level(logging.ERROR):
        robot.close()
    assert "did not confirm that its wheels stand" in caplog.text and not robot.connected
