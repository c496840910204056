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

import cv2
import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.baselines.patch import Learned
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.matching import match_everywhere
from base_station.trackers.slam.pose_optimization import optimize_pose
from base_station.trackers.slam.se3 import inverse, pose_of, rotation_angle_rad, transform
from base_station.trackers.slam.tracking import Picture
from base_station.types import Box, TrackerResult, TrackingState

TWINS_APART_RAD, TWIN_LEAD = math.radians(3.0), 1.5
"""Poses that differ by more are two; and by what factor the worse one's misfit must be larger."""
SURE_POINTS, SURE_MISFIT = 45, 5.0
"""So many points, whose mean square misfit (of both axes, in deviations) is no larger, make a pose sure."""
LEAST_POINTS = 12
"""Of the map, that place a target in it."""
NEAREST_DEPTH = 1e-3
PNP_PX = 8.0
"""Off by so much a point is still taken for the learned one: a tilted map is to be set right, not to be left."""


@dataclass(frozen=True)
class Placed:
    """The learned picture in the map: where it was taken, and which point each of its features shows, (n,). `sure`: it
    cannot be its twin, see `_best_twin`."""

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
    world: Map, learned: Features, in_box: np.ndarray, picture: Picture, camera: SlamCamera
) -> Placed | None:  # fmt: skip
    """Where the learned picture was taken, by the map points that both it and a picture of now show.

    `in_box` (n,) bool: the learned features that belong to the target, of which enough must be among them.
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
    near = inliers[:, 0]
    guess, sigma = pose_of(cv2.Rodrigues(rotation)[0], translation), world.scales[learned.octave[rows]]
    pose, sure = _best_twin(guess, points[near], uv[near], sigma[near], camera)
    if in_box[rows[near]].sum() < LEAST_POINTS:
        return None
    point_of_learned = np.full(len(learned), NONE, np.int32)
    point_of_learned[rows[near]] = point_of[shown[matches[rows[near]]]]
    return Placed(pose, point_of_learned, sure)


def _best_twin(
    guess: np.ndarray, points: np.ndarray, uv_px: np.ndarray, sigma_px: np.ndarray, camera: SlamCamera
) -> tuple[np.ndarray, bool]:
    """A plane looks much the same from two sides (Collins and Bartoli, "Infinitesimal plane-based pose estimation",
    2014): both poses are refined, the one that fits best is given, and whether the other fits clearly worse."""
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    flat = points - ((points - middle) @ normal)[:, None] * normal
    found, rotations, translations, _ = cv2.solvePnPGeneric(flat, uv_px, camera.matrix, None, flags=cv2.SOLVEPNP_IPPE)
    guesses = [guess]
    if found:
        both = zip(rotations, translations, strict=True)
        guesses += [pose_of(cv2.Rodrigues(rotation)[0], translation) for rotation, translation in both]
    poses = [optimize_pose(one, points, uv_px, sigma_px, camera.intrinsics).cam_from_world for one in guesses]
    misfits = [_misfit(pose, points, uv_px, sigma_px, camera) for pose in poses]
    best = int(np.argmin(misfits))
    others = [misfit for pose, misfit in zip(poses, misfits, strict=True) if differ(pose, poses[best])]
    fits = len(points) >= SURE_POINTS and misfits[best] <= SURE_MISFIT
    return poses[best], fits and min(others, default=math.inf) > TWIN_LEAD * misfits[best]


def differ(one: np.ndarray, two: np.ndarray) -> bool:
    """Whether two poses are turned too differently to be the same one."""
    return rotation_angle_rad(one[:3, :3] @ two[:3, :3].T) > TWINS_APART_RAD


def _misfit(
    pose: np.ndarray, points: np.ndarray, uv_px: np.ndarray, sigma_px: np.ndarray, camera: SlamCamera
) -> float:  # fmt: skip
    in_cam = transform(pose, points)
    if not (in_cam[:, 2] > 0).all():
        return math.inf
    expected_px = in_cam[:, :2] / in_cam[:, 2:] * camera.intrinsics[:2] + camera.intrinsics[2:]
    off = np.linalg.norm(expected_px - uv_px, axis=1) / sigma_px
    return float(np.mean(np.minimum(off, PNP_PX) ** 2))


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
