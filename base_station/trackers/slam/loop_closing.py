"""Closing loops, and joining maps: recognising a place that the map does not yet know to be the same.

A keyframe's place is looked up among those that it shares nothing with. A candidate must stand four tests before the
map is touched: its looks, a similarity (Sim3) between points of both that agrees in both pictures, enough further
points of the candidate's surroundings found where that similarity puts them, and the same from the keyframe's own
neighbours. Then a loop's error is spread over all keyframes (`loop_correction`); a candidate of another map joins both.
After Mur-Artal and Tardos 2017, section V, and Campos et al., "ORB-SLAM3", 2021, section VI.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from base_station.trackers.slam import sim3
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.matching import Grid, match_everywhere, match_projections
from base_station.trackers.slam.relocalization import Places
from base_station.trackers.slam.se3 import inverse, rotation_angle_rad, transform
from base_station.trackers.slam.sim3 import Sighted, Sim3Settings
from base_station.trackers.slam.types import Closure
from base_station.trackers.slam.visibility import expect


@dataclass(frozen=True, kw_only=True)
class LoopSettings:
    """When two places are believed to be one."""

    latest: int = 10
    """Keyframes before this one that are no loop."""
    neighbour_share: float = 0.8
    """Of the least similarity to its own neighbours, that a keyframe must have to a candidate."""
    least_pairs: int = 12
    """Points of both keyframes that agree with a similarity. It need only be good enough for the next test, which
    decides: seen from a little aside, two keyframes have few pairs in common, and a similarity from points that are not
    exact fits half of them."""
    least_projected: int = 45
    """Points of the candidate's surroundings found in the keyframe's picture."""
    least_by_neighbour: int = 25
    """The same in the picture of a neighbour..."""
    neighbours: int = 2
    """...of which so many must agree."""
    surroundings: int = 12
    """Keyframes around the candidate whose points are looked for."""
    radius_px: float = 8.0
    """Around a projection, on the finest level."""
    again_after: int = 8
    """Keyframes after a closed loop before the next is looked for."""
    sim3: Sim3Settings = field(default_factory=Sim3Settings)
    """How a similarity is searched for."""


@dataclass(frozen=True)
class Loop:
    """`keyframe` sees the place of `candidate`. `candidate_from_keyframe`: 4x4 similarity of camera coordinates.
    `points`: rows of the points around the candidate."""

    keyframe: int
    candidate: int
    candidate_from_keyframe: np.ndarray
    points: np.ndarray


def find_loop(
    world: Map, places: Places, keyframe: int, words: np.ndarray, camera: SlamCamera, settings: LoopSettings
) -> Loop | None:
    """The place that this keyframe comes back to, or None."""
    known = world.neighbours(keyframe, world.keyframe_count)
    latest = world.keyframes_alive(int(world.component[keyframe]))[-settings.latest :]
    scores = [places.similarity(keyframe, int(row)) for row in known[:10] if world.shared[keyframe, row] >= 30]
    least_score = settings.neighbour_share * min(scores, default=0.05)
    mine = world.keyframes_alive(int(world.component[keyframe]))
    others = np.setdiff1d(world.keyframes_alive(), mine)
    exclude = {keyframe, *known.tolist(), *latest.tolist()}
    candidates = places.candidates(words, exclude=exclude | set(others.tolist()), least_score=least_score)
    if len(others):  # apart: a map's own places resemble it most, and would leave no turn to those of other maps
        candidates += places.candidates(words, exclude=set(mine.tolist()))
    for candidate in candidates:
        loop = _verify(world, keyframe, candidate, camera, settings)
        if loop is not None:
            return loop
    return None


def _verify(world: Map, keyframe: int, candidate: int, camera: SlamCamera, settings: LoopSettings) -> Loop | None:
    pairs = _pairs(world, keyframe, candidate)
    if len(pairs[0]) < settings.least_pairs:
        return None
    mine = _sighted(world, keyframe, pairs[0], camera)
    theirs = _sighted(world, candidate, pairs[1], camera)
    found = sim3.estimate(theirs, mine, settings.sim3)
    if found is None or found.inliers.sum() < settings.least_pairs:
        return None
    around = np.append(world.neighbours(candidate, settings.surroundings), candidate)
    points = world.points_of(around)
    loop = Loop(keyframe, candidate, found.a_from_b, points)
    if _projected(world, loop, keyframe, camera, settings) < settings.least_projected:
        return None
    neighbours = world.neighbours(keyframe, 5)
    agreeing = sum(
        _projected(world, loop, int(row), camera, settings) >= settings.least_by_neighbour for row in neighbours
    )
    return loop if agreeing >= min(settings.neighbours, len(neighbours)) else None


def _pairs(world: Map, keyframe: int, candidate: int) -> tuple[np.ndarray, np.ndarray]:
    """Features (n,) of both keyframes that look alike, and show a point each."""
    mine, theirs = world.features[keyframe], world.features[candidate]
    rows = np.flatnonzero(world.point_of[keyframe, : len(mine)] >= 0)
    shown = np.flatnonzero(world.point_of[candidate, : len(theirs)] >= 0)
    matches = match_everywhere(
        mine.descriptors[rows], mine.angle_deg[rows], theirs.part(shown), ratio=0.85
    )  # fmt: skip
    index = np.flatnonzero(matches >= 0)
    return rows[index], shown[matches[index]]


def _sighted(world: Map, keyframe: int, features: np.ndarray, camera: SlamCamera) -> Sighted:
    of = world.features[keyframe]
    points = transform(world.poses[keyframe], world.xyz[world.point_of[keyframe, features]])
    seen = (of.xy_px[features] - camera.intrinsics[2:]) / camera.intrinsics[:2]
    return Sighted(points=points, seen=seen, sigma=world.scales[of.octave[features]] / camera.fx)


def correction(world: Map, loop: Loop) -> Closure:
    """What the loop is going to change, see `Closure`. To be asked before."""
    kind: Literal["loop", "merge"] = (
        "loop" if world.component[loop.candidate] == world.component[loop.keyframe] else "merge"
    )
    mapped = world.poses[loop.candidate] @ inverse(world.poses[loop.keyframe])
    found = loop.candidate_from_keyframe
    depth = float(np.median(transform(world.poses[loop.candidate], world.xyz[loop.points])[:, 2]))
    return Closure(
        kind=kind,
        time_s=float(world.time_s[loop.keyframe]),
        moved_of_depth=float(np.linalg.norm(found[:3, 3] - mapped[:3, 3])) / max(abs(depth), 1e-9),
        turned_rad=rotation_angle_rad(sim3.rotation_of(found) @ mapped[:3, :3].T),
        scale=float(sim3.scale_of(found)),
    )


def seen_from(world: Map, loop: Loop, keyframe: int) -> np.ndarray:
    """cam_from_world, rigid, of a keyframe as the loop has it: in the candidate's world."""
    mine_from_it = world.poses[loop.keyframe] @ inverse(world.poses[keyframe])
    return sim3.as_pose(inverse(world.poses[loop.candidate]) @ loop.candidate_from_keyframe @ mine_from_it)


def _projected(world: Map, loop: Loop, keyframe: int, camera: SlamCamera, settings: LoopSettings) -> int:
    """How many points around the candidate are found in a keyframe's picture where the loop puts them."""
    features = world.features[keyframe]
    expected = expect(world, loop.points, seen_from(world, loop, keyframe), camera)
    matches = match_projections(
        expected.uv_px, settings.radius_px * world.scales[expected.octave], expected.octave_range,
        world.descriptors[expected.rows], features, Grid.of(features.xy_px, camera.bounds_px), most=64, ratio=0.9,
    )  # fmt: skip
    return int((matches >= 0).sum())
