"""The learned target as points of the map, and what a camera pose then says about it.

A box remembers the map points in it, a learned place all points in view, and the pose they were learned from. Points
may come later than the learning: as soon as the map explains the learned picture's features, it is placed in the map
by them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.baselines.patch import Learned
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.matching import match_everywhere
from base_station.trackers.slam.pose_optimization import optimize_pose
from base_station.trackers.slam.se3 import inverse, pose_of, transform
from base_station.trackers.slam.tracking import Picture
from base_station.types import Box, TrackerResult, TrackingState

LEAST_POINTS = 12
"""Of the map, that place a target in it."""
NEAREST_DEPTH = 1e-3
PNP_PX = 4.0


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
        center = self.center * world.sizes[world.living(self.keyframe)] / self.size
        return cam_from_learned, transform(cam_from_learned, center[None])[0]


def place_in_map(
    world: Map,
    keyframe: int,
    learned: Features,
    in_box: np.ndarray,
    center_px: tuple[float, float],
    picture: Picture,
    camera: SlamCamera,
) -> MapTarget | None:
    """Where the learned picture was taken and its target is, by the map points that both it and a picture of now show.

    `in_box` (n,) bool: the learned features that belong to the target, whose middle is `center_px`. Its depth is that
    of its points nearest to the middle.
    """
    seen, point_of = picture.features, picture.point_of
    shown = np.flatnonzero(point_of >= 0)
    if len(shown) < LEAST_POINTS:
        return None
    matches = match_everywhere(learned.descriptors, learned.angle_deg, seen.part(shown), most=64, ratio=0.85)
    rows = np.flatnonzero(matches >= 0)
    if len(rows) < LEAST_POINTS:
        return None
    points, uv = world.xyz[point_of[shown[matches[rows]]]], learned.xy_px[rows].astype(np.float64)
    solved, rotation, translation, inliers = cv2.solvePnPRansac(
        points, uv, camera.matrix, None, iterationsCount=200, reprojectionError=PNP_PX, flags=cv2.SOLVEPNP_AP3P
    )
    if not solved or inliers is None or len(inliers) < LEAST_POINTS:
        return None
    guess = pose_of(cv2.Rodrigues(rotation)[0], translation)
    fit = optimize_pose(guess, points, uv, world.scales[learned.octave[rows]], camera.intrinsics)
    own = fit.inliers & in_box[rows]
    if own.sum() < LEAST_POINTS:
        return None
    pose = fit.cam_from_world
    middle = camera.undistort(np.array([center_px]))[0]
    near = np.argsort(np.linalg.norm(uv[own] - middle, axis=1))[:LEAST_POINTS]
    depth = float(np.median(transform(pose, points[own][near])[:, 2]))
    center = np.append((middle - camera.intrinsics[2:]) / camera.intrinsics[:2], 1.0) * depth
    relative = pose @ inverse(world.poses[keyframe])
    return MapTarget(keyframe, relative, float(world.sizes[keyframe]), center)


def result_of(
    target: MapTarget, world: Map, cam_from_world: np.ndarray, learned: Learned, camera: PinholeCamera,
    confidence: float,
) -> TrackerResult:  # fmt: skip
    """Bearing, zoom and the rest; also of a target that is out of the picture: the map knows where it is."""
    cam_from_learned, center = target.seen_from(world, cam_from_world)
    learned_depth = float(target.center[2]) * float(world.sizes[world.living(target.keyframe)]) / target.size
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
    center = target.center * world.sizes[world.living(target.keyframe)] / target.size
    sight = center - inverse(cam_from_learned)[:3, 3]
    turned = math.atan2(center[0], center[2]) - math.atan2(sight[0], sight[2])
    return math.remainder(turned, 2 * math.pi)
