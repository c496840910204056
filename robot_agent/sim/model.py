"""The room, the robot and the leader as MuJoCo's model text (MJCF). Text only: nothing here needs MuJoCo.

All surfaces glow with their own texture and there is no lamp: brightness is a matter of the camera, one number that a
scenario can change without surprises. Contact types: bit 1 is the floor and what rolls on it, bit 2 obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from protocol import Intrinsics
from robot_agent.sim import calibration_board, scenarios, textures, thymio
from robot_agent.sim.clutter import exchanged, mirrored
from robot_agent.sim.courses import ROOM_HALF_SIZE_M
from robot_agent.sim.furnishing import Block
from robot_agent.sim.poses import Pose

WALL_HEIGHT_M = 1.5
SENSED_GROUP, OWN_GROUP = 0, 3
"""Geometry groups: what proximity sensors and lines of sight meet, and the robot's own parts."""
OBSTACLE_TYPE = 2
"""Contact type bit of obstacles."""

_WALLS = ("east", "north", "west", "south")
_WALL_HALF_M, _SLAB_HALF_M = 0.01, 0.001
_WHEEL_HALF_M, _WHEEL_MIDDLE_M = 0.008, 0.0485
_SERVO_INERTIA, _SERVO_RATE_S = 1.2e-5, 65.0
"""Of a pan-tilt's servo, gears and all (kg m2), and how fast it answers (1/s)."""
_PLAIN_WALL_GRAY, _PLAIN_FLOOR_GRAY = 150, 128
_FLOOR_PX, _WALL_PX, _PICTURE_PX = (2048, 2048), (512, 2048), (512, 512)
_BLOCK, _BLOCK_PX = "block", (256, 256)


@dataclass(frozen=True, kw_only=True)
class SimModel:
    """MJCF text and the PNG files it names."""

    mjcf: str
    files: dict[str, bytes]


def build_model(
    stage: scenarios.Stage,
    *,
    texture_seed: int,
    timestep_s: float,
    width: int,
    height: int,
    intrinsics: Intrinsics,
    pan_tilt: bool = False,
) -> SimModel:
    """The whole scene of a stage. `width`, `height` and `intrinsics` are those of the robot's camera; `pan_tilt`: it
    stands on joints."""
    images = _images(stage, np.random.default_rng(texture_seed))
    fovy_deg = float(np.degrees(2.0 * np.arctan(height / 2.0 / intrinsics.fy)))
    assets = "".join(
        f'<texture name="{name}" type="{"cube" if name.startswith(_BLOCK) else "2d"}" file="{name}.png"/>'
        f'<material name="{name}" texture="{name}" emission="1" specular="0" shininess="0"/>'
        for name in images
    )
    mjcf = f"""<mujoco model="zservo">
<compiler angle="radian"/>
<option timestep="{timestep_s!r}" integrator="Euler" cone="elliptic" impratio="10"/>
<statistic extent="1" center="0 0 0"/>
<visual><global offwidth="{width}" offheight="{height}"/><quality offsamples="0" shadowsize="0"/>
<map znear="0.01" zfar="20"/><headlight ambient="0 0 0" diffuse="0 0 0" specular="0 0 0"/></visual>
<default><geom contype="0" conaffinity="0" group="{SENSED_GROUP}"/>
<default class="obstacle"><geom contype="{OBSTACLE_TYPE}"/></default>
<default class="own"><geom group="{OWN_GROUP}" mass="0"/></default></default>
<asset>{assets}{_shades()}{_meshes()}</asset>
<worldbody>{_room(stage)}{_leader(stage)}{_boards(stage)}{_calibration_board(stage)}
{_robot(stage.robot_start, _camera(fovy_deg, pan_tilt))}</worldbody>
<actuator>{_motors()}{_servos() if pan_tilt else ""}</actuator>
</mujoco>"""
    files = {f"{name}.png": _png(image) for name, image in images.items()}
    return SimModel(mjcf=mjcf, files=files)


def _images(stage: scenarios.Stage, rng: np.random.Generator) -> dict[str, np.ndarray]:
    images = {"floor": textures.plain(_PLAIN_FLOOR_GRAY)} | dict.fromkeys(_WALLS, textures.plain(_PLAIN_WALL_GRAY))
    if stage.textured:
        images["floor"] = textures.texture(rng, *_FLOOR_PX, textures.FLOOR)
        style = textures.WALL if stage.clutter is None else textures.BUSY_WALL
        images |= {name: textures.texture(rng, *_WALL_PX, style) for name in _WALLS}
    if stage.picture is not None:
        images["picture"] = textures.texture(rng, *_PICTURE_PX, textures.PICTURE)
    for number, block in enumerate(stage.furniture):
        if block.printed:
            images[f"{_BLOCK}{number}"] = textures.texture(rng, *_BLOCK_PX, textures.PICTURE)
    if stage.clutter is not None:
        images |= {"mirrored": mirrored(images["picture"]), "exchanged": exchanged(images["picture"])}
        images["board"] = textures.texture(rng, *_PICTURE_PX, textures.BOARD)
    if stage.board is not None:
        images["calibration"] = textures.calibration_sheet()
    return images


def _png(image: np.ndarray) -> bytes:
    """Hardly compressed: it is read once, in this process."""
    _, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return data.tobytes()


def _shades() -> str:
    grays = {"ceiling": 0.84, "screen": 0.53, "body": 0.93, "tyre": 0.12, "lid": 0.78, "trim": 0.45, "back": 0.70}
    return "".join(
        f'<material name="{name}" rgba="{g} {g} {g} 1" emission="1" specular="0" shininess="0"/>'
        for name, g in grays.items()
    )


def _meshes() -> str:
    """Convex hulls of their corners: the body, and a lid that makes its shape readable without shading."""
    solids = {
        "thymio": (thymio.BODY_BOTTOM_M, thymio.BODY_TOP_M, 1.0),
        "lid": (thymio.BODY_TOP_M, thymio.BODY_TOP_M + 0.001, 0.95),
    }
    return "".join(
        f'<mesh name="{name}" vertex="'
        + " ".join(f"{x * scale:.5f} {y * scale:.5f} {z}" for x, y in thymio.outline() for z in (bottom, top))
        + '"/>'
        for name, (bottom, top, scale) in solids.items()
    )


def _room(stage: scenarios.Stage) -> str:
    wall, reach = WALL_HEIGHT_M / 2, ROOM_HALF_SIZE_M + _WALL_HALF_M
    half = ROOM_HALF_SIZE_M + 2 * _WALL_HALF_M  # into the corners: no gap to look through
    parts = [
        f'<geom name="floor" type="plane" size="{half} {half} 1" material="floor" contype="1" friction="1.5 0 0"'
        f' solref="0.005 1"/>',
        f'<geom type="box" size="{half} {half} {_WALL_HALF_M}" pos="0 0 {WALL_HEIGHT_M + _WALL_HALF_M}"'
        ' material="ceiling"/>',
    ]
    for quarter, name in enumerate(_WALLS):
        x, y = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter]
        # Axes: along the wall to the right as seen from inside, then up; the box's z axis points into the room.
        parts.append(
            f'<geom name="{name}" class="obstacle" type="box" size="{half} {wall} {_WALL_HALF_M}" material="{name}"'
            f' pos="{x * reach} {y * reach} {wall}" xyaxes="{y} {-x} 0 0 0 1"/>'
        )
    if stage.picture is not None and stage.picture.wall_pose is not None:
        parts.append(_picture_geom(stage.picture, stage.picture.wall_pose))
    if stage.screen is not None:
        screen = stage.screen
        size = f"{screen.length_m / 2} {screen.thickness_m / 2} {screen.height_m / 2}"
        parts.append(
            f'<geom class="obstacle" type="box" size="{size}" material="screen"'
            f' pos="{screen.pose.x_m} {screen.pose.y_m} {screen.height_m / 2}" euler="0 0 {screen.pose.heading_rad}"/>'
        )
    return "".join(parts) + "".join(_block(number, block) for number, block in enumerate(stage.furniture))


def _block(number: int, block: Block) -> str:
    length, width, height = block.size_m
    material = f"{_BLOCK}{number}" if block.printed else "trim"
    return (
        f'<geom class="obstacle" type="box" size="{length / 2} {width / 2} {height / 2}" material="{material}"'
        f' pos="{block.pose.x_m} {block.pose.y_m} {block.bottom_m + height / 2}"'
        f' euler="0 0 {block.pose.heading_rad}"/>'
    )


def _picture_geom(picture: scenarios.Picture, pose: Pose) -> str:
    return _slab(pose, picture.centre_height_m, (picture.side_m, picture.side_m), "picture", name='name="picture" ')


def _slab(pose: Pose, centre_height_m: float, size_m: tuple[float, float], image: str, *, name: str = "") -> str:
    """A thin slab, width x height, whose printed face (the box's +z) stands at the pose and looks against its heading;
    the box's +x is to the viewer's right."""
    (width, height), inside = size_m, pose.moved(ahead_m=_SLAB_HALF_M)
    axis_x, axis_y = np.sin(pose.heading_rad), -np.cos(pose.heading_rad)
    return (
        f'<geom {name}class="obstacle" type="box" size="{width / 2} {height / 2} {_SLAB_HALF_M}" material="{image}"'
        f' pos="{inside.x_m} {inside.y_m} {centre_height_m}" xyaxes="{axis_x:.9f} {axis_y:.9f} 0 0 0 1"/>'
    )


def _look_alikes(stage: scenarios.Stage) -> str:
    """On the leader, each on a rod."""
    parts = []
    for one in stage.clutter.look_alikes if stage.clutter is not None else ():
        pose = Pose(x_m=one.ahead_m, y_m=one.left_m, heading_rad=0.0)
        parts.append(_slab(pose, one.centre_height_m, (one.side_m, one.side_m), one.image))
        start, end = f"0 0 {thymio.BODY_TOP_M}", f"{one.ahead_m + 0.004} {one.left_m} {one.centre_height_m}"
        parts.append(f'<geom type="capsule" size="0.003" fromto="{start} {end}" material="trim"/>')
    return "".join(parts)


def _boards(stage: scenarios.Stage) -> str:
    """Printed on both faces, which stand along the way that the board goes."""
    parts = []
    for number, board in enumerate(stage.clutter.boards if stage.clutter is not None else ()):
        across = Pose(x_m=0.0, y_m=0.0, heading_rad=np.pi / 2)
        face = _slab(across, board.height_m / 2, (board.width_m, board.height_m), board.image)
        parts.append(f'<body name="board{number}" mocap="true" {_standing(board.pose(0.0))}>{face}</body>')
    return "".join(parts)


def _calibration_board(stage: scenarios.Stage) -> str:
    """A slab whose printed face is the body's xy plane, seen from +z."""
    if stage.board is None:
        return ""
    width, height = calibration_board.SHEET_M
    return (
        '<body name="calibration" mocap="true" pos="1 0 0.5"><geom type="box"'
        f' size="{width / 2} {height / 2} {_SLAB_HALF_M}" pos="0 0 {-_SLAB_HALF_M}" material="calibration"/></body>'
    )


def _leader(stage: scenarios.Stage) -> str:
    picture = stage.picture
    if stage.leader is None or picture is None:
        return ""
    behind = -scenarios.LEADER_PICTURE_BEHIND_M
    board = _picture_geom(picture, Pose(x_m=behind, y_m=0.0, heading_rad=0.0))
    half = picture.side_m / 2
    wheels = "".join(
        f'<geom type="cylinder" size="{thymio.WHEEL_RADIUS_M} {_WHEEL_HALF_M}" pos="0 {y} {thymio.WHEEL_RADIUS_M}"'
        ' euler="1.5707963 0 0" material="tyre"/>'
        for y in (-_WHEEL_MIDDLE_M, _WHEEL_MIDDLE_M)
    )
    return (
        f'<body name="leader" mocap="true" {_standing(stage.leader(0.0))}>'
        '<geom class="obstacle" type="mesh" mesh="thymio" material="body"/>'
        '<geom type="mesh" mesh="lid" material="lid"/>'
        f'{wheels}<geom type="box" size="0.002 {half} {half}" pos="{behind + 0.0035} 0 {picture.centre_height_m}"'
        f' material="back"/><geom type="box" size="0.012 0.05 0.004" pos="0.02 0 0.056" material="trim"/>{board}'
        f"{_look_alikes(stage)}</body>"
    )


def _robot(start: Pose, camera: str) -> str:
    radius, half_base = thymio.WHEEL_RADIUS_M, thymio.LIMITS.wheel_base_m / 2
    # Ellipsoids touch the floor in one point, so that the wheel base is exact.
    wheels = "".join(
        f'<body name="{side}" pos="0 {y} {radius}"><joint name="{side}" axis="0 1 0" armature="2e-5"/>'
        f'<geom class="own" type="ellipsoid" size="{radius} 0.006 {radius}" mass="0.012" conaffinity="1"'
        f' friction="1.5 0 0" solref="0.005 1" material="tyre"/></body>'
        for side, y in (("left", half_base), ("right", -half_base))
    )
    body_kg = thymio.MASS_KG - 2 * 0.012
    return (
        f'<body name="robot" {_standing(start)}><freejoint name="robot"/>'
        f'<inertial pos="0.022 0 0.024" mass="{body_kg}" diaginertia="3.3e-4 3.0e-4 5.4e-4"/>'
        '<geom name="body" class="own" type="mesh" mesh="thymio" conaffinity="2" friction="0.3 0 0" material="body"/>'
        '<geom class="own" type="sphere" size="0.005" pos="0.066 0 0.005" conaffinity="1" priority="1" condim="1"'
        ' solref="0.005 1" material="trim"/>'
        '<geom class="own" type="capsule" size="0.003" fromto="0 0 0.05 0 0 0.085" material="tyre"/>'
        f"{camera}{wheels}</body>"
    )


def _camera(fovy_deg: float, pan_tilt: bool) -> str:
    """Fixed, or on two joints that cross in it: pan about the vertical (left positive), tilt about its horizontal axis
    (up positive). `mount` is the way it looks with both at 0."""
    forward = 'xyaxes="0 -1 0 0 0 1"'
    mount = f'<site name="mount" group="{OWN_GROUP}" pos="0 0 {thymio.CAMERA_HEIGHT_M}" {forward}/>'
    if not pan_tilt:
        return f'{mount}<camera name="camera" pos="0 0 {thymio.CAMERA_HEIGHT_M}" {forward} fovy="{fovy_deg!r}"/>'
    hinge = f'armature="{_SERVO_INERTIA}" damping="{2.0 * _SERVO_INERTIA * _SERVO_RATE_S}"'
    part = '<inertial pos="0 0 0" mass="0.005" diaginertia="1e-6 1e-6 1e-6"/>'
    return (
        f'{mount}<body name="pan" pos="0 0 {thymio.CAMERA_HEIGHT_M}"><joint name="pan" axis="0 0 1" {hinge}/>{part}'
        f'<body name="tilt"><joint name="tilt" axis="0 -1 0" {hinge}/>{part}'
        f'<camera name="camera" {forward} fovy="{fovy_deg!r}"/></body></body>'
    )


def _standing(pose: Pose) -> str:
    return f'pos="{pose.x_m!r} {pose.y_m!r} 0" euler="0 0 {pose.heading_rad!r}"'


def _servos() -> str:
    """Position servos, critically damped together with the joints: they lag behind a ramp by 2 / rate."""
    gain = _SERVO_INERTIA * _SERVO_RATE_S**2
    return "".join(f'<position name="{axis}" joint="{axis}" kp="{gain}"/>' for axis in ("pan", "tilt"))


def _motors() -> str:
    """Velocity servos behind a first-order filter of the asked speed."""
    gain = 0.01
    return "".join(
        f'<general name="{side}" joint="{side}" dyntype="filterexact" dynprm="{thymio.WHEEL_RESPONSE_S}"'
        f' gainprm="{gain}" biastype="affine" biasprm="0 0 {-gain}"/>'
        for side in ("left", "right")
    )
