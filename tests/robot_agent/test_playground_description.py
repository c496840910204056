"""The playground's file and the simulator's model come from one stage and cannot disagree."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import pytest

from robot_agent.playground.description import from_playground, playground_file, to_playground
from robot_agent.sim.poses import Pose, wrapped
from robot_agent.sim.scenarios import build_stage


@pytest.mark.parametrize("heading_rad", [0.0, 1.0, -1.0, math.pi, -3.0, 7.0])
def test_poses_come_back_as_they_went(heading_rad: float) -> None:
    pose = Pose(x_m=-1.25, y_m=2.5, heading_rad=heading_rad)
    x_cm, y_cm, angle_rad = to_playground(pose)
    back = from_playground(x_cm, y_cm, angle_rad)
    assert (x_cm, y_cm) == pytest.approx((175.0, 550.0)) and 0.0 <= angle_rad < math.tau
    assert (back.x_m, back.y_m) == pytest.approx((pose.x_m, pose.y_m))
    assert wrapped(back.heading_rad - pose.heading_rad) == pytest.approx(0.0, abs=1e-12)


def test_the_robots_stand_where_the_stage_puts_them() -> None:
    stage = build_stage("leader", 5)
    assert stage.leader is not None
    world = ElementTree.fromstring(playground_file(stage, follower_port=1001, leader_port=1002))
    robots = {robot.attrib["name"]: robot.attrib for robot in world.findall("robot")}
    for name, pose, port in (("follower", stage.robot_start, "1001"), ("leader", stage.leader(0.0), "1002")):
        there = tuple(float(robots[name][key]) for key in ("x", "y", "angle"))
        assert there == to_playground(pose)
        assert robots[name]["port"] == port and robots[name]["type"] == "thymio2"
    room = world.find("world")
    assert room is not None and float(room.attrib["w"]) == float(room.attrib["h"]) == 600.0


def test_a_scene_without_a_leader_has_one_robot_and_a_screen_is_a_wall() -> None:
    poster = ElementTree.fromstring(playground_file(build_stage("poster", 1), follower_port=1, leader_port=2))
    assert [robot.attrib["name"] for robot in poster.findall("robot")] == ["follower"]
    plain = ElementTree.fromstring(playground_file(build_stage("plain", 1), follower_port=1, leader_port=2))
    assert len(plain.findall("wall")) == 1
