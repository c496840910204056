"""What the map does not need: points that were a mistake, keyframes that show nothing new."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from base_station.trackers.slam.map import Map

ASKED = 60
"""Neighbours that may see a keyframe's points as well."""


@dataclass(frozen=True, kw_only=True)
class CullingSettings:
    """Mur-Artal et al. 2015, sections VI-B and VI-E."""

    least_found_share: float = 0.25
    """Of the frames in which a young point was expected, that it must be found in."""
    probation: int = 3
    """Keyframes after which a point is no longer young."""
    least_observed: int = 3
    """Keyframes that must see a point two keyframes after it was made."""
    redundant_share: float = 0.9
    """A keyframe goes when so many of its points are seen..."""
    redundant_views: int = 3
    """...by so many others, as finely or more so."""
    looked_at: int = 20
    """Neighbours that are checked after each keyframe."""


def cull_points(world: Map, young: np.ndarray, keyframe: int, settings: CullingSettings) -> np.ndarray:
    """Remove those of the young points that do not prove themselves; those that remain young."""
    young = young[world.point_alive[young]]
    age = keyframe - world.born[young]
    world.count_observed(young)
    doubtful = world.found[young] < settings.least_found_share * world.expected[young]
    doubtful |= (age >= 2) & (world.observed[young] < settings.least_observed)
    world.remove_points(young[doubtful])
    return young[~doubtful & (age < settings.probation)]


def cull_keyframes(world: Map, keyframe: int, settings: CullingSettings) -> list[int]:
    """Remove neighbours of this keyframe that are redundant; their rows. A map's first keyframe stays."""
    first = int(world.keyframes_alive(int(world.component[keyframe]))[0])
    gone = []
    for candidate in world.neighbours(keyframe, settings.looked_at)[::-1]:
        row = int(candidate)
        if row not in (first, keyframe) and _redundant(world, row, settings):
            anchor = world.neighbours(row, 1)
            world.remove_keyframe(row, int(anchor[0]) if len(anchor) else first)
            gone.append(row)
    return gone


def _redundant(world: Map, keyframe: int, settings: CullingSettings) -> bool:
    """Whether most of its points are seen by enough of its neighbours, on no much coarser level than by itself."""
    share = redundant_share(
        world.point_of, world.octave_of, world.point_count, keyframe, world.neighbours(keyframe, ASKED),
        settings.redundant_views,
    )  # fmt: skip
    return bool(share > settings.redundant_share)


@njit(cache=True, nogil=True)
def redundant_share(point_of, octave_of, point_count, keyframe, others, views):
    """Of the points that a keyframe sees, those that at least so many of the others see as finely; 1 without any."""
    coarsest = np.zeros(point_count, np.int16)
    seen = np.zeros(point_count, np.int16)
    count = 0
    for feature in range(point_of.shape[1]):
        point = point_of[keyframe, feature]
        if point >= 0:
            coarsest[point] = octave_of[keyframe, feature] + 2
            count += 1
    for other in others:
        for feature in range(point_of.shape[1]):
            point = point_of[other, feature]
            if point >= 0 and octave_of[other, feature] < coarsest[point]:
                seen[point] += 1
    enough = 0
    for feature in range(point_of.shape[1]):
        point = point_of[keyframe, feature]
        enough += point >= 0 and seen[point] >= views
    return enough / count if count else 1.0


def redundant_share_reference(world: Map, keyframe: int, others: np.ndarray, views: int) -> float:
    """The same in plain numpy, for tests."""
    features = np.flatnonzero(world.point_of[keyframe] >= 0)
    if not len(features):
        return 1.0
    points = world.point_of[keyframe, features]
    octave = np.zeros(world.point_count + 1, np.int64)
    octave[points] = world.features[keyframe].octave[features] + 1
    rows, seers, theirs = world.observations(others)
    _, fineness, _ = world.keypoints(seers, theirs)
    kept = (octave[rows] > 0) & (fineness <= octave[rows])
    return float(np.mean(np.bincount(rows[kept], minlength=world.point_count)[points] >= views))
