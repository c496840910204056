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
    """`reference`: the keyframe that shares most with the picture; `keyframes`, best first; `points`: rows."""

    reference: int
    keyframes: np.ndarray
    points: np.ndarray


def local_map(world: Map, seen: np.ndarray, reference: int) -> LocalMap:
    """Around the points seen in the last picture (rows) and its reference keyframe."""
    latest = np.arange(max(0, world.keyframe_count - LATEST), world.keyframe_count)
    latest = latest[world.alive[latest] & (world.component[latest] == world.component[reference])]
    asked = np.concatenate([[reference], world.neighbours(reference, ASKED), latest]).astype(np.int64)
    asked = asked[np.sort(np.unique(asked, return_index=True)[1])]
    asked = asked[world.alive[asked]]
    votes = _votes(world.point_of, asked, seen, np.zeros(world.point_count + 1, np.bool_))
    order = np.argsort(-votes, kind="stable")
    if len(order) and votes[order[0]] > 0:
        reference = int(asked[order[0]])
    keyframes = asked[order[votes[order] > 0]][:KEPT]
    extra = world.neighbours(reference, KEPT)
    keyframes = np.concatenate([keyframes, extra[~np.isin(extra, keyframes)]])[:KEPT]
    points = _union(
        world.point_of, keyframes, world.point_alive, np.zeros(world.point_count + 1, np.bool_), MOST_POINTS
    )
    return LocalMap(reference, keyframes, points)


@njit(cache=True, nogil=True)
def _votes(point_of, keyframes, seen, marked):
    for row in seen:
        marked[row] = True
    votes = np.zeros(len(keyframes), np.int64)
    for i in range(len(keyframes)):
        mine = point_of[keyframes[i]]
        for k in range(len(mine)):
            if mine[k] >= 0 and marked[mine[k]]:
                votes[i] += 1
    return votes


@njit(cache=True, nogil=True)
def _union(point_of, keyframes, alive, marked, most):
    points = np.empty(most, np.int64)
    n = 0
    for keyframe in keyframes:
        mine = point_of[keyframe]
        for k in range(len(mine)):
            row = mine[k]
            if row >= 0 and not marked[row] and alive[row]:
                marked[row] = True
                points[n] = row
                n += 1
                if n == most:
                    return points
    return points[:n]
