"""A camera that goes where it likes in a scenario's room, without a robot: for measurements of what sees.

The same pictures, noise included, for the same seed and the same order of calls.
"""

from __future__ import annotations

import math

import numpy as np

from robot_agent.sim import thymio
from robot_agent.sim.courses import ClosedCourse
from robot_agent.sim.poses import Pose
from robot_agent.sim.scene import Scene


class FreeCamera:
    """In the room of scenario `loop` or another one. Raises AgentError as `Scene` does."""

    def __init__(
        self, *, seed: int, scenario: str = "loop", width: int = 640, height: int = 480, noise_sigma: float = 2.0
    ) -> None:
        self._scene = Scene(
            scenario=scenario, seed=seed, width=width, height=height, fps=30.0, noise_sigma=noise_sigma
        )  # fmt: skip
        self.intrinsics = self._scene.intrinsics
        start, places = self._scene.stage.robot_start, self._scene.stage.course
        ways = [start.moved(ahead_m=ahead, left_m=left) for ahead, left in (*places, *places[:1])]
        self.lap = ClosedCourse(np.array([p.x_m for p in ways]), np.array([p.y_m for p in ways])) if places else None
        """What a robot is to drive in this room; None where the scenario has no course."""

    def on_lap(self, distance_m: float, left_m: float = 0.0, turned_rad: float = 0.0) -> np.ndarray:
        """The pose (see `level`) after so many metres of the lap, moved and turned to the left. Raises ValueError
        without a lap."""
        if self.lap is None:
            raise ValueError("this scenario has no lap")
        return level(self.lap.at(distance_m).moved(left_m=left_m, turned_rad=turned_rad))

    def view(self, world_from_camera: np.ndarray) -> np.ndarray:
        """The picture from there, with noise: uint8 (height, width). `world_from_camera`: 4x4, see `level`."""
        engine = self._scene.engine
        engine.aim_from(world_from_camera)
        return self._scene.noisy(engine.draw())

    def close(self) -> None:
        """Free the drawing resources."""
        self._scene.engine.close()


def level(pose: Pose, height_m: float = thymio.CAMERA_HEIGHT_M, pitch_rad: float = 0.0) -> np.ndarray:
    """world_from_camera, 4x4, of a camera that stands there and looks along the heading, `pitch_rad` upwards; its axes
    are right, down, forwards."""
    c, s = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    up, along = math.sin(pitch_rad), math.cos(pitch_rad)
    matrix = np.eye(4)
    matrix[:3, :3] = np.array([[s, c * up, c * along], [-c, s * up, s * along], [0.0, -along, up]])
    matrix[:3, 3] = pose.x_m, pose.y_m, height_m
    return matrix
