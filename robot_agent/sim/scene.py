"""A stage of a scenario with the engine that draws it: what every world shares that shows one to a camera.

The simulated world moves its robot by physics, the playground's world puts it where another program says; picture,
noise and truth come from here for both, so that they cannot differ.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from protocol import Scenario, ScenarioEvent, Truth
from robot_agent.errors import AgentError
from robot_agent.sim.engine import Engine
from robot_agent.sim.model import build_model
from robot_agent.sim.noise import NoiseBank
from robot_agent.sim.poses import Pose, wrapped
from robot_agent.sim.projection import pinhole, user_box
from robot_agent.sim.scenarios import build_stage

_LONGEST_STEP_S = 0.002


class Scene:
    """One seed of a scenario, robot and leader at their start. Locks nothing: the world that owns it does.

    Every kind of chance (course, textures, noise, slip, losses) has its own stream of the seed: one fault leaves the
    others' luck alone.
    """

    def __init__(
        self,
        *,
        scenario: str,
        seed: int,
        width: int,
        height: int,
        fps: float,
        noise_sigma: float,
        pan_tilt: bool = False,
    ) -> None:
        """`pan_tilt`: the camera stands on its joints.

        Raises AgentError for an unknown scenario (listing the valid ones), a negative seed, or without MuJoCo.
        """
        if seed < 0:
            raise AgentError(f"The seed must not be negative, but is {seed}.")
        self.width, self.height = width, height
        self.intrinsics = pinhole(width, height)
        course_seed, texture_seed, noise_seed, self.slip_seed, self.loss_seed = _streams(seed)
        self.stage = build_stage(scenario, course_seed)
        self.step_s = 1.0 / (fps * math.ceil(1.0 / (fps * _LONGEST_STEP_S)))
        """The engine's time step: a whole number of them per frame, so that frames fall exactly on steps."""
        model = build_model(
            self.stage,
            texture_seed=texture_seed,
            timestep_s=self.step_s,
            width=width,
            height=height,
            intrinsics=self.intrinsics,
            pan_tilt=pan_tilt,
        )
        self.engine = Engine(model, width=width, height=height)
        self._noise = NoiseBank(sigma=noise_sigma, width=width, height=height, seed=noise_seed)
        self.engine.place_robot(self.stage.robot_start)
        if self.stage.leader is not None:
            self.engine.place_leader(self.stage.leader(0.0))
        self.engine.refresh()
        self.announcement = Scenario(name=scenario, seed=seed, events=(self._learn_event(),), course=self.stage.course)
        """What hello says of it."""

    def move_background(self, time_s: float) -> None:
        """Bring what moves in the background, and a calibration board, to this scenario time; takes effect at the next
        `refresh`.

        They keep off the robot, so it is enough to do so when a picture is taken.
        """
        if self.stage.clutter is not None:
            self.engine.place_boards([board.pose(time_s) for board in self.stage.clutter.boards])
        if self.stage.board is not None:
            self.engine.hold_board(self.stage.board(time_s))

    def noisy(self, image: np.ndarray) -> np.ndarray:
        """The picture (uint8, height x width) with the camera's noise."""
        return self._noise.add_to(image)

    def truth(self, collisions: int) -> Truth:
        """Where things are, as of the engine's last `refresh`."""
        robot, view, target = self.engine.robot_pose, self.engine.picture_view(), self.engine.picture_pose
        if view is None or target is None:
            bearing = wrapped(self.stage.robot_start.heading_rad - self.engine.mount_heading_rad)
            half_view_rad = math.atan2(self.width / 2, self.intrinsics.fx)
            in_view = abs(bearing) <= half_view_rad  # half of the learned view, or more
            return Truth(robot=_flat(robot), bearing_rad=bearing, in_view=in_view, collisions=collisions)
        in_view = view.is_framed(self.intrinsics, self.width, self.height) and all(
            self.engine.sees(point) for point in (view.centre, *view.corners)
        )
        return Truth(
            robot=_flat(robot),
            target=_flat(target),
            bearing_rad=self.engine.picture_bearing_rad,
            range_m=view.range_m,
            in_view=in_view,
            collisions=collisions,
        )

    def _learn_event(self) -> ScenarioEvent:
        view = self.engine.picture_view()
        box = None if view is None else user_box(view, self.intrinsics)
        return ScenarioEvent(kind="learn", frame=1, box=box)


def _streams(seed: int) -> Sequence[int]:
    return [int(part.generate_state(1)[0]) for part in np.random.SeedSequence(seed).spawn(5)]


def _flat(pose: Pose) -> tuple[float, float, float]:
    return pose.x_m, pose.y_m, wrapped(pose.heading_rad)
