"""Which pictures become keyframes: those that see much less of the map than their reference does.

Many are taken and many are culled again (Mur-Artal et al. 2015, section V-E): a keyframe too many costs some time, one
too few costs the track.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class KeyframeSettings:
    """When a picture is kept."""

    seen_share: float = 0.7
    """Of the reference keyframe's points that a picture must still see..."""
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


def wants_keyframe(settings: KeyframeSettings, *, frames_since: int, matches: int, share: float, waiting: int) -> bool:
    """Whether to keep this picture.

    `share`: of the reference keyframe's points, those that it sees; `waiting`: keyframes that the mapper has not
    finished.
    """
    if matches < settings.least_matches or frames_since < settings.least_frames or waiting > settings.queue:
        return False
    if waiting:
        return share < settings.urgent_share
    return share < settings.seen_share or frames_since >= settings.most_frames
