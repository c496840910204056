"""Which pictures become keyframes: those that see much less of the map than their reference does.

How much less, depends on how far the camera has come: a picture from aside tells depths, one from a turn on the spot
none, and a keyframe of it is only one more for what is there.
A camera that stands sees nothing new: the map does not grow meanwhile, however long that is. Only when it sees less
than its keyframe did is another one taken, which then is what is seen.
Many are taken and many are culled again (Mur-Artal et al. 2015, section V-E): a keyframe too many costs some time, one
too few costs the track.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from base_station.trackers.slam.se3 import apart

SURE_KEYFRAMES = 3
"""A point that so many keyframes see is one that is found again."""


@dataclass(frozen=True, kw_only=True)
class KeyframeSettings:
    """When a picture is kept."""

    seen_share: float = 0.7
    """Of the reference keyframe's points that a picture must still see..."""
    far_share: float = 0.85
    """...and a picture from so far off that it tells depths..."""
    far_step: float = 0.04
    """...which is so far from the last keyframe, of the median depth. A car leaves what it sees within some pictures:
    points that few keyframes see are not found again, and each of them takes the scale along..."""
    urgent_share: float = 0.4
    """...and below which it is kept although the mapper is at work."""
    most_frames: int = 10
    """Since the last keyframe, after which one is taken when the mapper is idle."""
    least_frames: int = 1
    """Since the last keyframe, before the next."""
    queue: int = 2
    """Keyframes that may wait for the mapper."""
    least_matches: int = 15
    """A picture that sees fewer points is no keyframe."""
    least_step: float = 0.01
    """Of the median depth, since the last keyframe: from nearer by no point's depth can be told (`new_points.py`). A
    camera that has moved less..."""
    least_turn_rad: float = math.radians(1.0)
    """...and has turned less stands."""


@dataclass(frozen=True)
class Moved:
    """How a camera has moved: `step` as a share of the median depth, and by which angle it has turned."""

    step: float
    turn_rad: float

    def stands(self, settings: KeyframeSettings) -> bool:
        """Whether it is still where it was."""
        return self.step < settings.least_step and self.turn_rad < settings.least_turn_rad


ELSEWHERE = Moved(math.inf, math.inf)
"""There was no keyframe before, or it was in another map."""


def wants_keyframe(
    settings: KeyframeSettings, *, frames_since: int, matches: int, share: float, waiting: int, moved: Moved
) -> bool:
    """Whether to keep this picture.

    `share`: of the reference keyframe's points, those that it sees; `waiting`: keyframes that the mapper has not
    finished; `moved`: since the last keyframe (`moved_since`).
    """
    if matches < settings.least_matches or frames_since < settings.least_frames or waiting > settings.queue:
        return False
    stands = moved.stands(settings)
    if waiting:
        return share < settings.urgent_share and not stands
    if stands:  # what it sees less of is hidden, or in another light: that becomes known, but not in every picture
        return share < settings.seen_share and frames_since >= settings.most_frames
    must_see = settings.far_share if moved.step >= settings.far_step else settings.seen_share
    return share < must_see or frames_since >= settings.most_frames


def moved_since(before: np.ndarray, cam_from_world: np.ndarray, depth: float) -> Moved:
    """How a camera has moved from one pose (cam_from_world) to another. `depth`: the median of its points."""
    step, turn_rad = apart(cam_from_world, before)
    return Moved(step / depth, turn_rad)


def share_seen(
    reference: np.ndarray, picture: np.ndarray, alive: np.ndarray, observed: np.ndarray, least: int
) -> float:
    """Of the points that a reference keyframe sees surely, those that a picture sees, 0..1.

    `reference`, `picture`: the points that their features show, or -1; `alive`, `observed`: the map's columns. With
    fewer than `least` sure ones, of all that it sees.
    """
    return _share_seen(reference, picture, alive, observed, least)


@njit(cache=True, nogil=True)
def _share_seen(reference, picture, alive, observed, least):
    seen = np.zeros(len(alive), np.bool_)
    for point in picture:
        if point >= 0:
            seen[point] = True
    every, every_seen, sure, sure_seen = 0, 0, 0, 0
    for point in reference:
        if point < 0:
            continue
        every += 1
        every_seen += seen[point]
        if alive[point] and observed[point] >= SURE_KEYFRAMES:
            sure += 1
            sure_seen += seen[point]
    if sure < least:
        sure, sure_seen = every, every_seen
    return sure_seen / sure if sure else 0.0
