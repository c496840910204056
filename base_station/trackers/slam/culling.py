"""What the map does not need: points that were a mistake, keyframes that show nothing new."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from base_station.trackers.slam.map import Map


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
    features = np.flatnonzero(world.point_of[keyframe] >= 0)
    points = world.point_of[keyframe, features]
    if not len(points):
        return True
    octave = np.zeros(world.point_count + 1, np.int64)
    octave[points] = world.features[keyframe].octave[features] + 1
    rows, seers, theirs = world.observations(world.neighbours(keyframe, 60))
    kept = octave[rows] > 0
    rows, seers, theirs = rows[kept], seers[kept], theirs[kept]
    _, fineness, _ = world.keypoints(seers, theirs)
    views = np.bincount(rows[fineness <= octave[rows]], minlength=world.point_count)
    return bool(np.mean(views[points] >= settings.redundant_views) > settings.redundant_share)
