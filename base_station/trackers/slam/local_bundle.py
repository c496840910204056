"""From the map to a bundle adjustment and back: which keyframes move, which hold, and what turns out to be wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from base_station.trackers.slam.bundle_kernels import adjust_small
from base_station.trackers.slam.bundle_problem import BundleProblem
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.pose_optimization import CHI2_TWO


@dataclass(frozen=True, kw_only=True)
class BundleSettings:
    """How much is adjusted after each keyframe."""

    moving: int = 12
    """Keyframes: the new one and its neighbours."""
    holding: int = 16
    """Keyframes that see the same points and are held, those that share most."""
    iterations: int = 10
    """Of a local adjustment."""
    global_iterations: int = 20
    """Of one over a whole map."""


def adjust_locally(world: Map, keyframe: int, camera: SlamCamera, settings: BundleSettings) -> None:
    """Adjust a keyframe, its neighbours and their points; what lies beyond is held."""
    moving = np.append(world.neighbours(keyframe, settings.moving - 1), keyframe)
    points = world.points_of(moving)
    seen = np.zeros(world.point_count + 1, np.bool_)
    seen[points] = True
    others = np.setdiff1d(world.keyframes_alive(int(world.component[keyframe])), moving)
    shares = seen[world.point_of[others]].sum(axis=1)
    best = np.argsort(-shares, kind="stable")[: settings.holding]
    holding = others[best][shares[best] > 0]
    if not len(holding):
        oldest = moving.min()
        moving, holding = moving[moving != oldest], np.array([oldest])
    adjust(world, moving, holding, points, camera, iterations=settings.iterations)


def adjust(
    world: Map,
    moving: np.ndarray,
    holding: np.ndarray,
    points: np.ndarray,
    camera: SlamCamera,
    *,
    iterations: int,
    solver: Callable[..., tuple[np.ndarray, np.ndarray]] = adjust_small,
) -> None:
    """Bundle-adjust these keyframes and points in place; observations that do not fit are dropped then."""
    part = part_of(world, moving, holding, points)
    if part is None:
        return
    problem, used, rows, seers, features = part
    poses, xyz = solver(problem, camera.intrinsics, world.scales, iterations=iterations)
    if not (np.isfinite(poses).all() and np.isfinite(xyz).all()):
        return
    world.poses[moving] = poses[: len(moving)]
    world.xyz[used] = xyz
    world.mark(keyframes=moving, points=used)
    _drop_misfits(
        world, poses[problem.keyframe], xyz[problem.point], problem.uv_px, world.scales[problem.octave], camera,
        rows, seers, features,
    )  # fmt: skip


def part_of(
    world: Map, moving: np.ndarray, holding: np.ndarray, points: np.ndarray
) -> tuple[BundleProblem, np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """These keyframes and what two of them see of these points, as a problem; the points' rows in the map; and of each
    observation the rows of its point and its keyframe, and its feature. None when there is nothing to adjust."""
    keyframes = np.concatenate([moving, holding]).astype(np.int64)
    rows, seers, features = world.observations(keyframes)
    wanted = np.zeros(world.point_count, np.bool_)
    wanted[points] = True
    counts = np.bincount(rows[wanted[rows]], minlength=world.point_count)
    kept = wanted[rows] & (counts[rows] >= 2)
    rows, seers, features = rows[kept], seers[kept], features[kept]
    if not len(rows):
        return None
    uv, octave, _ = world.keypoints(seers, features)
    used, point = np.unique(rows, return_inverse=True)
    position = np.zeros(world.keyframe_count, np.int64)
    position[keyframes] = np.arange(len(keyframes))
    fixed = np.arange(len(keyframes)) >= len(moving)
    problem = BundleProblem(
        world.poses[keyframes], fixed, world.xyz[used], position[seers], point, uv, octave
    )  # fmt: skip
    return problem, used, rows, seers, features


def _drop_misfits(
    world: Map,
    poses: np.ndarray,
    xyz: np.ndarray,
    uv_px: np.ndarray,
    sigma_px: np.ndarray,
    camera: SlamCamera,
    rows: np.ndarray,
    seers: np.ndarray,
    features: np.ndarray,
) -> None:
    """Forget observations beyond the chi-square bound, and points that fewer than two keyframes still see."""
    x, y, z = np.einsum("nij,nj->in", poses[:, :3, :3], xyz) + poses[:, :3, 3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        errors = (camera.fx * x / z + camera.cx - uv_px[:, 0]) ** 2 + (camera.fy * y / z + camera.cy - uv_px[:, 1]) ** 2
        bad = ~((z > 0) & (errors <= CHI2_TWO * sigma_px**2))
    world.point_of[seers[bad], features[bad]] = NONE
    world.mark(keyframes=np.unique(seers[bad]))
    touched = np.unique(rows[bad])
    world.count_observed(touched)
    world.remove_points(touched[world.observed[touched] < 2])
