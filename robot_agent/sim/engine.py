"""The one place that talks to MuJoCo: bodies, wheels, contacts, rays and the camera's picture.

Positions go in and out as plain numbers. Nothing here locks: the world does. Only `draw` may run without the world's
lock, because it works on the scene that `aim` copied; both belong to the thread of the camera.
"""

from __future__ import annotations

import importlib
import logging
import math
import os
from collections.abc import Sequence
from types import ModuleType
from typing import Any

import cv2
import numpy as np

from robot_agent.errors import AgentError
from robot_agent.sim import thymio
from robot_agent.sim.calibration_board import Held
from robot_agent.sim.model import OBSTACLE_TYPE, OWN_GROUP, SENSED_GROUP, SimModel
from robot_agent.sim.poses import Pose
from robot_agent.sim.projection import PictureView

_NO_EGL = (
    "MuJoCo cannot draw: EGL is not usable here; install its Debian packages"
    " (apt-get install libegl1 libgl1 libgl1-mesa-dri), and leave MUJOCO_GL unset or egl."
)
_SETTLE_STEPS = 400
_RAY_RUN_UP_M = 0.01
_CV_FROM_MUJOCO = np.diag((1.0, -1.0, -1.0))
"""MuJoCo's cameras have y up and look along -z."""


def load_mujoco() -> ModuleType:
    """MuJoCo, set to draw without a display. Raises AgentError when it is missing or has no EGL to draw with."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    logging.getLogger("OpenGL").setLevel(logging.WARNING)  # it tells of accelerators that nobody misses
    try:
        return importlib.import_module("mujoco")
    except ModuleNotFoundError as error:
        raise AgentError(
            "The simulator needs MuJoCo: install the extra with pip install 'zservo[sim]'"
            " (scripts/setup does). On a robot choose another: --robot thymio or none."
        ) from error
    except Exception as error:  # PyOpenGL without its libraries raises many unrelated things
        raise AgentError(_NO_EGL) from error


class Engine:
    """A loaded model and its state. The robot starts where the model puts it, settled on the floor."""

    def __init__(self, model: SimModel, *, width: int, height: int) -> None:
        self._mj: Any = load_mujoco()
        self._model = self._mj.MjModel.from_xml_string(model.mjcf, model.files)
        self._data = self._mj.MjData(self._model)
        self._view = _View(self._mj, self._model, width, height)
        self._body_geom = self._id("GEOM", "body")
        self._picture_geom = self._id("GEOM", "picture")
        self._camera = self._id("CAMERA", "camera")
        self._mount = self._id("SITE", "mount")
        self._sensed = np.zeros(6, np.uint8)
        self._sensed[SENSED_GROUP] = 1
        self._rest_height_m, self._rest_tilt = self._settle()

    def step(self) -> None:
        """One time step."""
        self._mj.mj_step(self._model, self._data)

    def refresh(self) -> None:
        """Bring what sensors and camera see up to the end of the last step."""
        self._mj.mj_kinematics(self._model, self._data)
        self._mj.mj_camlight(self._model, self._data)

    def drive(self, left_rad_s: float, right_rad_s: float) -> None:
        """Ask the wheels for these speeds; they follow with their own time constant."""
        self._data.ctrl[:2] = left_rad_s, right_rad_s

    def turn_camera(self, pan_rad: float, tilt_rad: float) -> None:
        """Ask the pan-tilt's servos for these angles. Only in a model that has one."""
        self._data.ctrl[2:] = pan_rad, tilt_rad

    @property
    def wheel_speeds_rad_s(self) -> tuple[float, float]:
        """How fast the left and the right wheel really turn."""
        return float(self._data.joint("left").qvel[0]), float(self._data.joint("right").qvel[0])

    @property
    def robot_pose(self) -> Pose:
        """Where the robot is."""
        x, y, _, a, b, c, d = self._data.qpos[:7]
        heading = math.atan2(2.0 * (a * d + b * c), 1.0 - 2.0 * (c * c + d * d))
        return Pose(x_m=float(x), y_m=float(y), heading_rad=heading)

    def place_robot(self, pose: Pose) -> None:
        """Put the robot down at rest."""
        self._data.qpos[:3] = pose.x_m, pose.y_m, self._rest_height_m
        self._mj.mju_mulQuat(self._data.qpos[3:7], _turn(pose.heading_rad), self._rest_tilt)
        self._data.qvel[:6] = 0.0

    def place_leader(self, pose: Pose) -> None:
        """Move the leader; nothing resists it."""
        self._data.mocap_pos[0] = pose.x_m, pose.y_m, 0.0
        self._data.mocap_quat[0] = _turn(pose.heading_rad)

    def place_boards(self, poses: Sequence[Pose]) -> None:
        """Move the boards of a cluttered room, in the model's order."""
        for number, pose in enumerate(poses):
            body = int(self._model.body_mocapid[self._id("BODY", f"board{number}")])
            self._data.mocap_pos[body] = pose.x_m, pose.y_m, 0.0
            self._data.mocap_quat[body] = _turn(pose.heading_rad)

    def hold_board(self, held: Held) -> None:
        """Hold the calibration board there."""
        body = int(self._model.body_mocapid[self._id("BODY", "calibration")])
        self._data.mocap_pos[body], self._data.mocap_quat[body] = held.position_m, held.quaternion

    @property
    def is_touching(self) -> bool:
        """Whether the robot's body met an obstacle in the last step."""
        return bool((self._data.contact.geom == self._body_geom).any())

    def clearance_m(self, within_m: float) -> float:
        """How far the robot's body is from the nearest obstacle, as of the last `refresh`; `within_m` when further."""
        obstacles = np.flatnonzero(self._model.geom_contype & OBSTACLE_TYPE)
        distances = (
            self._mj.mj_geomDistance(self._model, self._data, self._body_geom, int(geom), within_m, None)
            for geom in obstacles
        )
        return float(min(distances, default=within_m))

    def sense(self) -> tuple[float, ...]:
        """Distances (m) ahead of the proximity sensors, infinite when nothing is there."""
        pose = self.robot_pose
        return tuple(
            self._distance_ahead(pose.moved(ahead_m=x, left_m=y, turned_rad=angle)) for x, y, angle in thymio.sensors()
        )

    def picture_view(self) -> PictureView | None:
        """The picture in camera coordinates; None without one."""
        if self._picture_geom < 0:
            return None
        centre, axes = self._printed_face()
        half_m = float(self._model.geom_size[self._picture_geom][0])
        offsets = np.array([(-half_m, half_m), (half_m, half_m), (half_m, -half_m), (-half_m, -half_m)])
        corners = centre + offsets @ axes[:, :2].T
        eye, camera_from_world = self._camera_frame()
        return PictureView(
            centre=camera_from_world @ (centre - eye),
            corners=(corners - eye) @ camera_from_world.T,
            normal=camera_from_world @ axes[:, 2],
        )

    @property
    def picture_pose(self) -> Pose | None:
        """Where the picture stands; its heading is the way one looks at it squarely. None without a picture."""
        if self._picture_geom < 0:
            return None
        centre, axes = self._printed_face()
        return Pose(
            x_m=float(centre[0]), y_m=float(centre[1]), heading_rad=math.atan2(-float(axes[1, 2]), -float(axes[0, 2]))
        )

    def sees(self, point: np.ndarray) -> bool:
        """Whether nothing but the picture itself is on the line of sight to `point` (3,), in camera coordinates."""
        eye, camera_from_world = self._camera_frame()
        distance_m = float(np.linalg.norm(point))
        hit_m, geom = self._first_hit(eye, camera_from_world.T @ (point / distance_m))
        return geom == self._picture_geom or hit_m > distance_m

    @property
    def mount_heading_rad(self) -> float:
        """Horizontal direction of the optical axis of a camera that looks straight ahead."""
        mount_from_world = self._mount_from_world()
        return math.atan2(mount_from_world[2, 1], mount_from_world[2, 0])

    @property
    def picture_bearing_rad(self) -> float | None:
        """Direction of the picture's centre, seen from the camera, from straight ahead; left positive. None without a
        picture."""
        if self._picture_geom < 0:
            return None
        eye, _ = self._camera_frame()
        right, _, ahead = self._mount_from_world() @ (self._printed_face()[0] - eye)
        return math.atan2(-right, ahead)

    def aim(self) -> None:
        """Copy the scene for the next `draw`. Only in the camera's thread."""
        self._view.update(self._data, self._camera)

    def aim_from(self, world_from_camera: np.ndarray) -> None:
        """As `aim`, with the camera anywhere: 4x4, its axes right, down, forwards. Only until the next `refresh`."""
        self._data.cam_xpos[self._camera] = world_from_camera[:3, 3]
        self._data.cam_xmat[self._camera] = (world_from_camera[:3, :3] @ _CV_FROM_MUJOCO).reshape(9)
        self.aim()

    def draw(self) -> np.ndarray:
        """The camera's picture of the copied scene: uint8 gray (height, width), without noise, in full light."""
        return self._view.draw()

    def close(self) -> None:
        """Free the drawing resources. From any thread, while nobody draws."""
        self._view.close()

    def _id(self, kind: str, name: str) -> int:
        return int(self._mj.mj_name2id(self._model, getattr(self._mj.mjtObj, f"mjOBJ_{kind}"), name))

    def _settle(self) -> tuple[float, np.ndarray]:
        """Height and tilt at which wheels and caster carry the robot's weight."""
        for _ in range(_SETTLE_STEPS):
            self.step()
        height_m, heading_rad = float(self._data.qpos[2]), self.robot_pose.heading_rad
        tilt = np.empty(4)
        self._mj.mju_mulQuat(tilt, _turn(-heading_rad), self._data.qpos[3:7])
        self._data.qvel[:] = 0.0
        return height_m, tilt

    def _camera_frame(self) -> tuple[np.ndarray, np.ndarray]:
        return self._data.cam_xpos[self._camera], _CV_FROM_MUJOCO @ self._data.cam_xmat[self._camera].reshape(3, 3).T

    def _mount_from_world(self) -> np.ndarray:
        """Rotation (3, 3) into the coordinates of the camera as it looks straight ahead."""
        return _CV_FROM_MUJOCO @ self._data.site_xmat[self._mount].reshape(3, 3).T

    def _distance_ahead(self, sensor: Pose) -> float:
        """The ray starts inside the robot: at contact, the sensor itself may be a hair inside the obstacle."""
        inside = sensor.moved(ahead_m=-_RAY_RUN_UP_M)
        way = math.cos(inside.heading_rad), math.sin(inside.heading_rad), 0.0
        hit_m, _ = self._first_hit((inside.x_m, inside.y_m, thymio.SENSOR_HEIGHT_M), way)
        return max(0.0, hit_m - _RAY_RUN_UP_M)

    def _printed_face(self) -> tuple[np.ndarray, np.ndarray]:
        """Its centre (3,), and as columns (3, 3) the viewer's right, up, and the direction that it looks to."""
        axes = self._data.geom_xmat[self._picture_geom].reshape(3, 3)
        thickness_m = float(self._model.geom_size[self._picture_geom][2])
        return self._data.geom_xpos[self._picture_geom] + axes[:, 2] * thickness_m, axes

    def _first_hit(self, origin: Any, direction: Any) -> tuple[float, int]:
        geom = np.full(1, -1, np.int32)
        start, way = np.asarray(origin, float), np.asarray(direction, float)
        distance_m = self._mj.mj_ray(self._model, self._data, start, way, self._sensed, 1, -1, geom)
        return (float(distance_m), int(geom[0])) if distance_m >= 0.0 else (math.inf, -1)


class _View:
    """The camera's drawing context. It is current only while drawing, so that any thread may end it."""

    def __init__(self, mj: Any, model: Any, width: int, height: int) -> None:
        self._mj, self._model = mj, model
        self._rect = mj.MjrRect(0, 0, width, height)
        self._scene = mj.MjvScene(model, maxgeom=200)
        self._option = mj.MjvOption()
        self._option.geomgroup[OWN_GROUP] = 0
        self._aim = mj.MjvCamera()
        self._aim.type = mj.mjtCamera.mjCAMERA_FIXED
        self._pixels = np.empty((height, width, 3), np.uint8)
        self._gl: Any = None
        self._context: Any = None

    def update(self, data: Any, camera: int) -> None:
        self._aim.fixedcamid = camera
        everything = self._mj.mjtCatBit.mjCAT_ALL
        self._mj.mjv_updateScene(self._model, data, self._option, None, self._aim, everything, self._scene)

    def draw(self) -> np.ndarray:
        if self._gl is None:
            self._open()
        with self._gl.as_current():
            self._mj.mjr_render(self._rect, self._scene, self._context)
            self._mj.mjr_readPixels(self._pixels, None, self._rect, self._context)
        # OpenGL's rows run upwards.
        return cv2.flip(cv2.cvtColor(self._pixels, cv2.COLOR_RGB2GRAY), 0)

    def _open(self) -> None:
        try:
            self._gl = self._mj.GLContext(int(self._rect.width), int(self._rect.height))
        except Exception as error:  # EGL fails in many ways, with errors of several libraries
            raise AgentError(_NO_EGL) from error
        with self._gl.as_current():
            self._context = self._mj.MjrContext(self._model, self._mj.mjtFontScale.mjFONTSCALE_100)
            self._mj.mjr_setBuffer(self._mj.mjtFramebuffer.mjFB_OFFSCREEN, self._context)

    def close(self) -> None:
        if self._gl is None:
            return
        with self._gl.as_current():
            self._context.free()
        self._gl.free()
        self._gl = self._context = None


def _turn(angle_rad: float) -> np.ndarray:
    return np.array((math.cos(angle_rad / 2.0), 0.0, 0.0, math.sin(angle_rad / 2.0)))
