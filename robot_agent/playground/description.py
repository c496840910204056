"""A stage as asebaplayground's own file: the same description that MuJoCo's model is made from, in the other's terms.

The playground counts centimetres from a corner of its world, the simulator metres from the middle of the room; angles
are radians in both, the origin of a Thymio lies below the middle of its axle in both.
"""

from __future__ import annotations

import math

from robot_agent.sim.courses import ROOM_HALF_SIZE_M
from robot_agent.sim.poses import Pose
from robot_agent.sim.scenarios import Stage

ROBOT_TYPE = "thymio2"
CM_PER_M = 100.0
_FLOOR_LIGHT = 0.9


def to_playground(pose: Pose) -> tuple[float, float, float]:
    """x and y in cm, angle in rad in 0..2 pi."""
    x_cm, y_cm = (CM_PER_M * (value + ROOM_HALF_SIZE_M) for value in (pose.x_m, pose.y_m))
    return x_cm, y_cm, pose.heading_rad % math.tau


def from_playground(x_cm: float, y_cm: float, angle_rad: float) -> Pose:
    """The pose in the room."""
    x_m, y_m = (value / CM_PER_M - ROOM_HALF_SIZE_M for value in (x_cm, y_cm))
    return Pose(x_m=x_m, y_m=y_m, heading_rad=angle_rad)


def playground_file(stage: Stage, *, follower_port: int, leader_port: int) -> str:
    """The room, the screen, the follower and, where the stage has one, the leader. The ports are TCP ports of their
    Aseba nodes."""
    side_cm = 2.0 * ROOM_HALF_SIZE_M * CM_PER_M
    parts = [
        f'<world w="{side_cm}" h="{side_cm}" color="light"/>',
        _robot("follower", stage.robot_start, follower_port),
    ]
    if stage.leader is not None:
        parts.append(_robot("leader", stage.leader(0.0), leader_port))
    if stage.screen is not None:
        screen = stage.screen
        x_cm, y_cm, angle_rad = to_playground(screen.pose)
        length_cm, thickness_cm, height_cm = (
            CM_PER_M * metres for metres in (screen.length_m, screen.thickness_m, screen.height_m)
        )
        parts.append(
            f'<wall x="{x_cm!r}" y="{y_cm!r}" l1="{length_cm}" l2="{thickness_cm}" h="{height_cm}"'
            f' angle="{angle_rad!r}" color="light"/>'
        )
    content = "\n ".join(parts)
    light = f'<color name="light" r="{_FLOOR_LIGHT}" g="{_FLOOR_LIGHT}" b="{_FLOOR_LIGHT}"/>'
    return f"<!DOCTYPE aseba-playground>\n<aseba-playground>\n {light}\n {content}\n</aseba-playground>\n"


def _robot(name: str, pose: Pose, port: int) -> str:
    x_cm, y_cm, angle_rad = to_playground(pose)
    return f'<robot type="{ROBOT_TYPE}" x="{x_cm!r}" y="{y_cm!r}" angle="{angle_rad!r}" port="{port}" name="{name}"/>'
