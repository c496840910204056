"""What a recognised place does to the map: a loop's error is spread, or two maps become one.

Either way the keyframes about both ends then see each other's points, double points become one, and a bundle
adjustment by pycolmap settles the whole (for a large map: the two ends only).
"""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam import pose_graph, sim3
from base_station.trackers.slam.bundle_adjustment import bundle_adjust
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.fusion import fuse
from base_station.trackers.slam.local_bundle import BundleSettings, adjust, adjust_locally
from base_station.trackers.slam.loop_closing import Loop
from base_station.trackers.slam.map import Map, refresh_points
from base_station.trackers.slam.pose_graph import Edge
from base_station.trackers.slam.se3 import inverse

STRONG = 60
"""Points that two keyframes share, from which on their relative pose is an edge of the pose graph."""
USUAL_SHARED = 100.0
GROUP = 15
LARGEST_GLOBAL = 200
"""Keyframes of a map that is adjusted as a whole."""
LOOP_WEIGHT = 5.0


def correct(world: Map, loop: Loop, closed: list[tuple[int, int]], camera: SlamCamera, settings: BundleSettings) -> str:
    """Change the map by what the loop says: "loop" or "merge". `closed`: pairs of keyframes joined by loops before."""
    one, two = int(world.component[loop.candidate]), int(world.component[loop.keyframe])
    if one == two:
        _spread_error(world, loop, closed)
    else:
        _join(world, loop)
    closed.append((loop.keyframe, loop.candidate))
    group = np.append(world.neighbours(loop.keyframe, GROUP), loop.keyframe)
    for keyframe in group:
        fuse(world, loop.points[world.point_alive[loop.points]], int(keyframe), camera)
    keyframes = world.keyframes_alive(one)
    world.recount(keyframes)
    if len(keyframes) <= LARGEST_GLOBAL:
        adjust(
            world, keyframes[1:], keyframes[:1], world.points_alive(one), camera,
            iterations=settings.global_iterations, solver=bundle_adjust,
        )  # fmt: skip
    else:
        adjust_locally(world, loop.keyframe, camera, settings)
    world.recount(keyframes)
    world.count_observed(world.points_alive(one))
    refresh_points(world, world.points_alive(one), keyframes)
    return "loop" if one == two else "merge"


def tie(world: Map, keyframe: int, place: int, closed: list[tuple[int, int]], camera: SlamCamera) -> None:
    """A loop that is right already: from now on both ends are held together (an edge of later pose graphs), and what
    the place's surroundings show becomes the keyframe's own."""
    closed.append((keyframe, place))
    around = np.append(world.neighbours(place, GROUP), place)
    around = around[around != keyframe]
    fuse(world, world.points_of(around), keyframe, camera)
    near = np.append(world.neighbours(keyframe, GROUP), keyframe)
    world.recount(near)
    world.count_observed(world.points_of(near))
    refresh_points(world, world.points_of(np.array([keyframe])), near)


def _spread_error(world: Map, loop: Loop, closed: list[tuple[int, int]]) -> None:
    rows = world.keyframes_alive(int(world.component[loop.keyframe]))
    position = {int(row): index for index, row in enumerate(rows)}
    before = inverse(world.poses[rows])
    edges = _edges(world, rows, position, before)
    for one, two in closed:
        one, two = position.get(world.living(one), -1), position.get(world.living(two), -1)
        if min(one, two) >= 0 and one != two:
            edges.append(Edge(one, two, inverse(before[one]) @ before[two], LOOP_WEIGHT))
    edges.append(Edge(position[loop.candidate], position[loop.keyframe], loop.candidate_from_keyframe, LOOP_WEIGHT))
    after = pose_graph.optimize(before, edges, fixed={0})
    _move(world, rows, before, after)


def _edges(world: Map, rows: np.ndarray, position: dict[int, int], before: np.ndarray) -> list[Edge]:
    """Of the pose graph as the map has it: between those that share much, and each to its best earlier one."""
    edges = []
    for index, row in enumerate(rows):
        near = [int(other) for other in world.neighbours(int(row), 30) if other < row]
        strong = [other for other in near if world.shared[row, other] >= STRONG]
        earlier = strong or near[:1] or ([int(rows[index - 1])] if index else [])
        for other in earlier:
            place, weight = position[other], max(float(world.shared[row, other]) / USUAL_SHARED, 0.05)
            edges.append(Edge(place, index, inverse(before[place]) @ before[index], weight))
    return edges


def _join(world: Map, loop: Loop) -> None:
    """Carry the keyframe's map over into the candidate's."""
    one, two = int(world.component[loop.candidate]), int(world.component[loop.keyframe])
    rows = world.keyframes_alive(two)
    before = inverse(world.poses[rows])
    there = inverse(world.poses[loop.candidate]) @ loop.candidate_from_keyframe @ world.poses[loop.keyframe]
    _move(world, rows, before, there @ before)
    dead = np.flatnonzero(world.component[: world.keyframe_count] == two)
    world.component[dead] = one
    points = np.flatnonzero(world.point_component[: world.point_count] == two)
    world.point_component[points] = one
    world.mark(keyframes=dead, points=points)


def _move(world: Map, rows: np.ndarray, before: np.ndarray, after: np.ndarray) -> None:
    """Keyframes go from `before` to `after` (world_from_keyframe, similarities), and their points with them."""
    seen, seers, _ = world.observations(rows)
    points, first = np.unique(seen, return_index=True)
    owner = np.searchsorted(rows, seers[first])
    world.xyz[points] = pose_graph.spread(world.xyz[points], owner, before, after)
    world.poses[rows] = sim3.as_pose(after)
    world.sizes[rows] *= sim3.scale_of(after) / sim3.scale_of(before)
    world.mark(keyframes=rows, points=points)
