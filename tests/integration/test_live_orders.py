"""What an operator orders while the robot drives, and that frames and orders alone give the same results again."""

from __future__ import annotations

from pathlib import Path

import pytest

from base_station.kits import KitMaker
from base_station.link import Link
from base_station.orders import Order
from base_station.session import LinkSettings
from base_station.station import Station, StationSettings, Step
from base_station.types import Box, Frame, TrackingState
from base_station.watcher import Watcher
from protocol import STOP
from tests.helpers import Programs, free_ports

ORDERS = {
    10: [Order(kind="shadow", name="ncc")],
    40: [Order(kind="tracker", name="phase")],
    80: [Order(kind="behaviour", name="idle")],
    90: [Order(kind="behaviour", name="dance"), Order(kind="tracker", name="no-such")],
    100: [Order(kind="behaviour", name="teleop"), Order(kind="drive", forward=1.0)],
    120: [Order(kind="shadow"), Order(kind="learn", box=(90, 60, 60, 60))],
    130: [Order(kind="tracker", name="landmark:door")],
    135: [Order(kind="remember", name="door", box=(90, 60, 60, 60))],
}
"""What is ordered after which frame."""
FRAMES = 170


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> list[Step]:
    """A run of the simulated leader in which all this is ordered."""
    programs = Programs()
    make = KitMaker(memory=tmp_path_factory.mktemp("memory") / "landmarks.npz")
    steps: list[Step] = []
    remembered: list[str] = []

    def on_step(step: Step) -> None:
        steps.append(step)
        for order in ORDERS.get(step.frame.number, []):
            station.post(order)

    def remember(name: str, frame: Frame, box: Box | None) -> bool:
        remembered.append(f"{name} {box}")
        return True

    port = free_ports()
    try:
        programs.sim(port, "--rhythm", "lockstep", "--scenario", "leader", "--seed", "3", "--size", "320x240")
        link = Link(LinkSettings(port=port))
        station = Station(
            link,
            make("ztransform"),
            StationSettings(max_frames=FRAMES),
            make=make,
            remember=remember,
            on_step=on_step,
        )
        with link:
            station.run()
            station.close()
    finally:
        programs.close()
    assert remembered == ["door Box(x=90, y=60, width=60, height=60)"]
    return steps


def at(run: list[Step], kind: str, name: str = "") -> int:
    """The index of the step with which this order took effect."""
    frames = [index for index, step in enumerate(run) if (kind, name) in {(o.kind, o.name) for o in step.orders}]
    return frames[0]


def notices(run: list[Step]) -> list[str]:
    return [notice for step in run for notice in step.notices]


def test_the_first_order_is_the_simulated_operators(run: list[Step]) -> None:
    assert run[0].orders[0].kind == "learn" and run[0].orders[0].box is not None and run[0].learned


def test_another_tracker_learns_the_target_where_the_first_one_sees_it(run: list[Step]) -> None:
    index = at(run, "tracker", "phase")
    before, step = run[index - 1], run[index]
    assert step.learned and step.tracker == "phase" and before.tracker == "ztransform"
    assert step.result.state is TrackingState.TRACKING and before.result.box is not None
    assert step.result.box is not None
    assert abs(step.result.box.center_px[0] - before.result.box.center_px[0]) < 3


def test_a_shadow_comes_and_goes(run: list[Step]) -> None:
    seen = [step.shadow is not None for step in run]
    first, last = at(run, "shadow", "ncc"), at(run, "shadow")
    assert seen == [first <= number < last for number in range(len(run))]
    assert any(step.shadow.state is TrackingState.TRACKING for step in run[first:last] if step.shadow)


def test_behaviours_change_and_teleop_stops_when_nothing_is_held(run: list[Step]) -> None:
    idle, teleop = at(run, "behaviour", "idle"), at(run, "behaviour", "teleop")
    assert {step.command for step in run[idle:teleop]} == {STOP}
    moving = [step.frame.time_s for step in run[teleop:] if step.command != STOP]
    assert moving and moving[-1] - run[teleop].frame.time_s < 0.3
    assert run[-1].command == STOP


def test_what_cannot_be_done_is_said_and_changes_nothing(run: list[Step]) -> None:
    said = notices(run)
    assert any("dance" in notice and "idle" in notice for notice in said)
    assert any("no-such" in notice for notice in said)
    assert any("landmark:door" in notice for notice in said)
    assert not any(order.name in ("dance", "no-such", "landmark:door") for step in run for order in step.orders)
    assert "door is remembered as it looks now; the one of this name before is replaced" in said


def test_frames_and_orders_give_the_same_results_again(run: list[Step], tmp_path: Path) -> None:
    make = KitMaker(memory=tmp_path / "landmarks.npz")
    watcher = Watcher(make("ztransform"))
    for step in run:
        for order in step.orders:
            if order.kind == "learn":
                watcher.choose(order.target)
            elif order.kind == "tracker":
                watcher.exchange(make(order.name))
            elif order.kind == "shadow":
                watcher.exchange_shadow(make(order.name) if order.name else None)
        seen = watcher.look(step.frame)
        assert (seen.result, watcher.look_in_shadow(step.frame, seen)) == (step.result, step.shadow)
    watcher.close()
