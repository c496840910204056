"""The part of the map that the camera may see now: bounded, however large the map is.

Keyframes vote by the points they share with the last picture; the reference keyframe is the one with most votes. Only
the reference's neighbours and the latest keyframes are asked, so that the cost does not grow with the map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from base_station.trackers.slam.map import Map

ASKED = 40
KEPT = 24
MOST_POINTS = 3000
LATEST = 3


@dataclass(frozen=True)
class LocalMap:
    """`reference`: the keyframe that shares most with the picture; `keyframes`, best first; `open_points`: rows of
    points that these see and the picture does not show yet."""

    reference: int
    keyframes: np.ndarray
    open_points: np.ndarray


def local_map(world: Map, seen: np.ndarray, reference: int) -> LocalMap:
    """Around the points seen in the picture (rows) and the reference keyframe of the last one."""
    reference, keyframes, points = _local_map(
        world.point_of, world.shared.table, world.shared.place, world.alive, world.component, world.point_alive,
        world.keyframe_count, seen, reference,
    )  # fmt: skip
    return LocalMap(int(reference), keyframes, points)


@njit(cache=True, nogil=True)
def _local_map(point_of, shared, place, alive, component, point_alive, count, seen, reference):
    marked = np.zeros(len(point_alive) + 1, np.bool_)  # from point -1 on: which it is would be guessed wrong often
    for point in seen:
        marked[point + 1] = True
    asked = np.empty(1 + ASKED + LATEST, np.int64)
    taken = np.zeros(count, np.bool_)
    n = _take(asked, 0, 1, np.array([reference]), taken, alive)
    neighbours = _neighbours(shared, place, alive, count, reference)
    n = _take(asked, n, n + ASKED, neighbours, taken, alive)
    for latest in range(max(0, count - LATEST), count):
        if component[latest] == component[reference]:
            n = _take(asked, n, n + 1, np.array([latest]), taken, alive)
    votes = np.zeros(n, np.int64)
    for i in range(n):
        for point in point_of[asked[i]]:
            votes[i] += marked[np.uint64(point + 1)]
    order = np.argsort(-votes, kind="mergesort")
    if n and votes[order[0]] > 0 and asked[order[0]] != reference:
        reference = asked[order[0]]
        neighbours = _neighbours(shared, place, alive, count, reference)
    keyframes = np.empty(KEPT, np.int64)
    taken[:] = False
    kept = _take(keyframes, 0, KEPT, asked[:n][order][votes[order] > 0], taken, alive)
    kept = _take(keyframes, kept, KEPT, neighbours, taken, alive)
    points = np.empty(MOST_POINTS, np.int64)
    found = 0
    marked[0] = True
    for keyframe in keyframes[:kept]:
        for point in point_of[keyframe]:
            if not marked[np.uint64(point + 1)]:
                marked[np.uint64(point + 1)] = True
                if point_alive[point] and found < MOST_POINTS:
                    points[found] = point
                    found += 1
    return reference, keyframes[:kept], points[:found]


@njit(cache=True, nogil=True)
def _neighbours(shared, place, alive, count, keyframe):
    """As `Map.neighbours`, all of them: by how many points they share, those that share most first."""
    rows, weights, n = np.empty(count, np.int64), np.empty(count, np.int64), 0
    for row in range(count):
        if alive[row] and row != keyframe and place[row] >= 0 and place[keyframe] >= 0:
            weight = shared[place[keyframe], place[row]]
            if weight > 0:
                rows[n], weights[n] = row, weight
                n += 1
    return rows[:n][np.argsort(-weights[:n], kind="mergesort")]


@njit(cache=True, nogil=True)
def _take(into, n, most, rows, taken, alive):
    """Append rows that are alive and not there yet, until there are `most`; how many there are comes back."""
    for row in rows:
        if n < most and alive[row] and not taken[row]:
            taken[row] = True
            into[n] = row
            n += 1
    return n


def local_map_reference(world: Map, seen: np.ndarray, reference: int) -> LocalMap:
    """The same in plain numpy, for tests."""
    latest = np.arange(max(0, world.keyframe_count - LATEST), world.keyframe_count)
    latest = latest[world.component[latest] == world.component[reference]]
    asked = np.concatenate([[reference], world.neighbours(reference, ASKED), latest]).astype(np.int64)
    asked = asked[np.sort(np.unique(asked, return_index=True)[1])]
    asked = asked[world.alive[asked]]
    votes = np.array([np.isin(world.point_of[row], seen).sum() for row in asked])
    order = np.argsort(-votes, kind="stable")
    if len(order) and votes[order[0]] > 0:
        reference = int(asked[order[0]])
    keyframes = asked[order[votes[order] > 0]][:KEPT]
    extra = world.neighbours(reference, KEPT + len(keyframes))
    keyframes = np.concatenate([keyframes, extra[~np.isin(extra, keyframes)]])[:KEPT]
    points = world.point_of[keyframes].ravel()
    points = points[(points >= 0) & ~np.isin(points, seen)]
    points = points[world.point_alive[points]]
    return LocalMap(reference, keyframes, points[np.sort(np.unique(points, return_index=True)[1])][:MOST_POINTS])
