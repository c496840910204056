"""The learned target as points of the map, and what a camera pose then says about it.

A box remembers the map points in it, a learned place all points in view, and the pose they were learned from. Points
may come later than the learning: as soon as the map explains the learned picture's features, it is placed in the map
by them. It then becomes a keyframe: taken from elsewhere, it sets right what the robot's first centimetres leave open,
such as the tilt of a wall that it drives straight at.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.baselines.patch import Learned
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.matching import match_everywhere
from base_station.trackers.slam.se3 import inverse, transform
from base_station.trackers.slam.tracking import Picture
from base_station.trackers.slam.twins import Pairs, TwinSettings, judge
from base_station.types import Box, TrackerResult, TrackingState

LEAST_POINTS = 12
"""Of the map, that place a target in it."""
NEAREST_DEPTH = 1e-3


@dataclass(frozen=True)
class Placed:
    """The learned picture in the map: where it was taken, and which point each of its features shows, (n,). `sure`: it
    cannot be its twin, see `twins.py`."""

    cam_from_world: np.ndarray
    point_of: np.ndarray
    sure: bool = True


@dataclass(frozen=True)
class MapTarget:
    """`keyframe`: what the target is given relative to, the map may change. `learned_from_keyframe`: 4x4, the camera
    that learned it. `size`: the keyframe's then (`Map.sizes`). `center`: the target's middle in the learned camera."""

    keyframe: int
    learned_from_keyframe: np.ndarray
    size: float
    center: np.ndarray

    def seen_from(self, world: Map, cam_from_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """cam_from_learned 4x4, and the target's middle in the camera's coordinates."""
        learned_from_world = world.pose_by(self.keyframe, self.learned_from_keyframe, self.size)
        cam_from_learned = cam_from_world @ inverse(learned_from_world)
        center = self.center * world.growth(self.keyframe, self.size)
        return cam_from_learned, transform(cam_from_learned, center[None])[0]


def place_in_map(
    world: Map, learned: Features, in_box: np.ndarray, picture: Picture, cam_from_world: np.ndarray, camera: SlamCamera,
    settings: TwinSettings, without: int = NONE,
) -> Placed | None:  # fmt: skip
    """Where the learned picture was taken, by the map points that both it and a picture of now show.

    `in_box` (n,) bool: the learned features that belong to the target, of which enough must be among them.
    `cam_from_world`: of the picture of now. `without`: the keyframe that the learned picture has become by now.
    """
    matches = match_everywhere(learned.descriptors, learned.angle_deg, picture.features, most=64, ratio=0.85)
    rows = np.flatnonzero(matches >= 0)
    pairs = Pairs(rows, matches[rows], picture.point_of[matches[rows]])
    judged = judge(world, learned, in_box, picture, cam_from_world, pairs, camera, settings, without)
    if judged is None or in_box[rows[judged.fits]].sum() < LEAST_POINTS:
        return None
    point_of_learned = np.full(len(learned), NONE, np.int32)
    point_of_learned[rows[judged.fits]] = pairs.points[judged.fits]
    return Placed(judged.cam_from_world, point_of_learned, judged.sure)


def target_of(
    world: Map,
    keyframe: int,
    placed: Placed,
    learned: Features,
    in_box: np.ndarray,
    center_px: tuple[float, float],
    camera: SlamCamera,
) -> MapTarget | None:
    """The target, given relative to a keyframe. Its depth is that of its points nearest to its middle, `center_px`."""
    pose, own = placed.cam_from_world, np.flatnonzero((placed.point_of >= 0) & in_box)
    if len(own) < LEAST_POINTS:
        return None
    points, uv = world.xyz[placed.point_of[own]], learned.xy_px[own]
    middle = camera.undistort(np.array([center_px]))[0]
    near = np.argsort(np.linalg.norm(uv - middle, axis=1))[:LEAST_POINTS]
    depth = float(np.median(transform(pose, points[near])[:, 2]))
    center = np.append((middle - camera.intrinsics[2:]) / camera.intrinsics[:2], 1.0) * depth
    relative = pose @ inverse(world.poses[keyframe])
    return MapTarget(keyframe, relative, float(world.sizes[keyframe]), center)


def result_of(
    target: MapTarget, world: Map, cam_from_world: np.ndarray, learned: Learned, camera: PinholeCamera,
    confidence: float,
) -> TrackerResult:  # fmt: skip
    """Bearing, zoom and the rest; also of a target that is out of the picture: the map knows where it is."""
    cam_from_learned, center = target.seen_from(world, cam_from_world)
    learned_depth = float(target.center[2]) * world.growth(target.keyframe, target.size)
    x, y, depth = (float(value) for value in center)
    ahead = depth > NEAREST_DEPTH * learned_depth
    zoom = learned_depth / depth if ahead else None
    if learned.is_place:
        heading = cam_from_learned[:3, 2]  # where the learned camera looked, in this one's coordinates
        x, y, depth = (float(value) for value in heading)
        ahead = depth > NEAREST_DEPTH
    column, row = _pixel((x, y, depth), camera) if ahead else (None, None)
    there = (camera.cx, camera.cy) if learned.is_place else _pixel(target.center, camera)
    box = None
    if not learned.is_place and column is not None and row is not None and zoom is not None:
        seen = Box.around(column, row, learned.shape[1] * zoom, learned.shape[0] * zoom)
        box = seen if seen.clipped(camera.width, camera.height) else None
    return TrackerResult(
        state=TrackingState.TRACKING,
        shift_px=None if column is None else column - there[0],
        shift_y_px=None if row is None else row - there[1],
        bearing_rad=-math.atan2(x, depth),
        elevation_rad=-math.atan2(y, math.hypot(x, depth)) if ahead else None,
        zoom=zoom,
        view_angle_rad=None if learned.is_place else _view_angle_rad(target, world, cam_from_learned),
        confidence=confidence,
        box=box,
        cam_from_world=cam_from_world,
    )


def heading_of(target: MapTarget, world: Map, cam_from_world: np.ndarray) -> float:
    """Direction, from the camera's optical axis, of what was straight ahead when the target was learned; left
    positive."""
    cam_from_learned, _ = target.seen_from(world, cam_from_world)
    return -math.atan2(float(cam_from_learned[0, 2]), float(cam_from_learned[2, 2]))


def _pixel(point: Iterable[float], camera: PinholeCamera) -> tuple[float, float]:
    """Where the picture shows a point of the camera's coordinates. Well outside of it as an ideal pinhole would: there
    a lens's polynomial says nothing."""
    x, y, depth = (float(value) for value in point)
    column, row = camera.cx + camera.fx * x / depth, camera.cy + camera.fy * y / depth
    if not any(camera.distortion):
        return column, row
    lens = SlamCamera.of(camera)
    left, top, right, bottom = lens.bounds_px
    if left <= column <= right and top <= row <= bottom:
        column, row = lens.distort(np.array([(column, row)]))[0].tolist()
    return column, row


def _view_angle_rad(target: MapTarget, world: Map, cam_from_learned: np.ndarray) -> float:
    """By how much the line of sight has turned about the learned camera's vertical."""
    center = target.center * world.growth(target.keyframe, target.size)
    sight = center - inverse(cam_from_learned)[:3, 3]
    turned = math.atan2(center[0], center[2]) - math.atan2(sight[0], sight[2])
    return math.remainder(turned, 2 * math.pi)
