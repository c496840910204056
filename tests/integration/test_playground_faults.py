"""Faults of the whole stack, judged by where asebaplayground's Thymio really is: station, TCP, agent, D-Bus,
asebamedulla, the Aseba program in the robot. Two runs of the agent; the tests of a run share its start-up."""

from __future__ import annotations

import itertools
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from robot_agent.playground.bodies import find_bodies
from robot_agent.playground.description import from_playground
from robot_agent.robots.aseba import INTERFACE, OBJECT_PATH, SERVICE, BusCalls
from robot_agent.sim.courses import ROOM_HALF_SIZE_M
from robot_agent.sim.poses import Pose, wrapped
from robot_agent.sim.scenarios import FOLLOW_DISTANCE_M
from tests.helpers import ROOT, Program, Programs, RawStation, TelemetryLog, driving, wait_until
from tests.playground import agent_with_playground, awaits_client, needs_playground

pytestmark = [needs_playground, pytest.mark.alone]
WIDTH, HEIGHT = 160, 120
FULL_SPEED = 125
"""Wire units; with --speed-scale 4 the Thymio's limit of 500 motor units."""
FRONT_M = 0.08
"""From a Thymio's origin to its front: Enki's body reaches 7.7 cm, rounded up."""
STILL_M, STILL_RAD = 0.0003, 0.002
"""What a robot that stands moves between two looks at the most."""


@pytest.fixture
def agent(programs: Programs, port: int, folder: Path) -> Program:
    return agent_with_playground(programs, port, folder, "--size", f"{WIDTH}x{HEIGHT}")


class Onlooker:
    """Looks at the playground itself, on the agent's bus, whatever the agent believes."""

    def __init__(self, folder: Path) -> None:
        """Before the leader has moved: by their places the two robots are told apart."""
        (described,) = folder.glob("zservo-playground-*/world.playground")
        robots = {robot.get("name"): robot for robot in ElementTree.parse(described).iter("robot")}
        starts = [
            from_playground(*(float(robots[name].get(key, "")) for key in ("x", "y", "angle")))
            for name in ("follower", "leader")
        ]
        self._calls = BusCalls(f"unix:path={described.parent / 'bus'}")
        self.robot, self.leader = find_bodies(self._calls, starts)

    def left_target(self) -> int:
        """The variable in the robot. Takes a step of the simulation."""
        method = f"{INTERFACE}.GetVariable"
        return int(self._calls.call(SERVICE, OBJECT_PATH, method, "ss", "thymio-II", "motor.left.target")[0])

    def moved_until_s(self, still_s: float = 0.3, timeout_s: float = 3.0) -> float:
        """When the robot last moved (monotonic), looking until it has stood for so long."""
        last, moved_s = self.robot.pose(), time.monotonic()
        deadline_s = moved_s + timeout_s
        while (now_s := time.monotonic()) < moved_s + still_s:
            assert now_s < deadline_s, f"it still moves after {timeout_s} s"
            pose = self.robot.pose()
            if apart_m(pose, last) > STILL_M or abs(wrapped(pose.heading_rad - last.heading_rad)) > STILL_RAD:
                last, moved_s = pose, now_s
            time.sleep(0.01)
        return moved_s

    def close(self) -> None:
        self._calls.close()


def apart_m(one: Pose, other: Pose) -> float:
    return math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)


@pytest.fixture
def onlooker(agent: Program, folder: Path) -> Iterator[Onlooker]:
    looking = Onlooker(folder)
    yield looking
    looking.close()


def start_again(programs: Programs, agent: Program, name: str) -> None:
    """SIGKILL to a program of the agent's, then the same program anew, as its unit would on a robot."""
    children = Path(f"/proc/{agent.process.pid}/task/{agent.process.pid}/children").read_text().split()
    (process,) = [Path("/proc", pid) for pid in children if (Path("/proc", pid, "comm").read_text().strip() == name)]
    command = (process / "cmdline").read_text().rstrip("\0").split("\0")
    entries = (process / "environ").read_text().split("\0")
    environment = dict(entry.partition("=")[::2] for entry in entries if entry)
    os.kill(int(process.name), signal.SIGKILL)
    command[-1] = command[-1].partition(";sock=")[0]  # the agent's connection went with it: a new one of its own
    aseba_port = int(command[-1].rpartition(";")[2])
    wait_until(lambda: awaits_client(aseba_port), 2.0, "a playground that awaits a client")
    programs.start(*command, **environment)


def test_following_again_and_standing_soon(
    programs: Programs, port: int, agent: Program, onlooker: Onlooker, listen: Callable[[], TelemetryLog]
) -> None:
    """asebamedulla killed and started again: the robot follows again within 3 s. Station killed: it stands within
    700 ms. Both by the robot's pose in the playground."""
    telemetry = listen()
    station = programs.station(port, tracker="ztransform")
    start = onlooker.robot.pose()
    telemetry.wait_for(lambda message: driving(message) and message.frame is not None, 15.0, what="driving")
    wait_until(lambda: apart_m(onlooker.robot.pose(), start) > 0.1, 15.0, "a robot on its way")

    start_again(programs, agent, "asebamedulla")
    again_s = time.monotonic()
    away = telemetry.wait_for(lambda message: "asebamedulla" in message.reason, 2.0, what="the robot being away")
    assert away.wheels_asked == (0, 0)
    halted = onlooker.robot.pose()
    telemetry.wait_for(
        lambda message: message.safety == "ok" and driving(message), 3.0, since_s=again_s, what="commands obeyed again"
    )
    wait_until(lambda: apart_m(onlooker.robot.pose(), halted) > 0.02, 3.0, "a robot that moves")
    following_s = time.monotonic() - again_s
    assert following_s <= 3.0

    def caught_up() -> bool:
        truth = telemetry.last.truth if telemetry.last is not None else None
        if truth is None or truth.bearing_rad is None or truth.range_m is None:
            return False
        return abs(truth.bearing_rad) < math.radians(3.0) and abs(truth.range_m / FOLLOW_DISTANCE_M - 1.0) < 0.12

    wait_until(caught_up, 8.0, "the leader straight ahead at its distance")

    wait_until(lambda: telemetry.last is not None and sum(telemetry.last.wheels_asked) > 200, 8.0, "a brisk leader")
    before = onlooker.robot.pose()
    time.sleep(0.2)
    assert apart_m(onlooker.robot.pose(), before) > 0.003, "it stood already"
    station.signal(signal.SIGKILL)
    killed_s = time.monotonic()
    stood_s = onlooker.moved_until_s() - killed_s
    assert stood_s <= 0.7
    assert onlooker.left_target() == 0


def test_obstacle_and_the_thesiss_station(
    programs: Programs, port: int, agent: Program, onlooker: Onlooker, listen: Callable[[], TelemetryLog], folder: Path
) -> None:
    """At full speed towards the room's wall: it stops before contact, and drives away backwards when told. After that
    listing A.2's program drives its cycle, and each of its four speeds arrives in the robot."""
    wall_m = ROOM_HALF_SIZE_M
    with RawStation(port, WIDTH * HEIGHT) as station:
        station.read_frame()
        leader = onlooker.leader.pose()
        y_m = -2.0 if leader.y_m > 0 else 2.0
        onlooker.robot.place(Pose(x_m=wall_m - FRONT_M - 0.5, y_m=y_m, heading_rad=0.0))
        drive(station, 1.0, FULL_SPEED, FULL_SPEED)
        assert onlooker.left_target() == 500, "not at full speed"
        drive(station, 3.0, FULL_SPEED, FULL_SPEED)
        stopped = onlooker.robot.pose()
        gap_m = wall_m - (stopped.x_m + FRONT_M)
        assert stopped.x_m > wall_m - FRONT_M - 0.3, "it never drove"
        assert gap_m > 0.005, f"contact: {100 * gap_m:.1f} cm"
        drive(station, 1.5, -40, -40)
        assert onlooker.robot.pose().x_m < stopped.x_m - 0.02, "it did not back off"

    onlooker.robot.place(Pose(x_m=1.5, y_m=y_m, heading_rad=math.pi))
    telemetry = listen()
    telemetry.wait_for(lambda message: message.station is None, what="a robot that is free")
    script = str(ROOT / "tests/thesis_station.py")
    thesis = programs.start(sys.executable, script, *map(str, (port, WIDTH, HEIGHT, 2, folder / "frames.bin")))
    seen: list[int] = []
    while thesis.alive:
        seen.append(onlooker.left_target())
    assert thesis.exit_code() == 0, thesis.stderr
    changes = [target for target, _ in itertools.groupby(seen) if target != 0]
    assert changes == [400, -272, 400, -400] * 2


def drive(station: RawStation, seconds: float, left: int, right: int) -> None:
    """A command per frame, as a station gives them."""
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        station.read_frame()
        station.send(left, right)
