"""What the SLAM system says to the outside: one value per frame, and counts at the end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from base_station.types import TrackingState


@dataclass(frozen=True)
class SlamFrame:
    """What became of one picture.

    `cam_from_world`: 4x4 float64, TRACKING only; its world and scale are those of the map at this moment. `reason`: in
    words, why not TRACKING. `keyframe`: whether the picture became one. `matches`: map points seen in it.
    """

    state: TrackingState
    cam_from_world: np.ndarray | None = None
    reason: str = ""
    keyframe: bool = False
    matches: int = 0


@dataclass(frozen=True, kw_only=True)
class SlamStatistics:
    """Counts since the start. `timings_ms`: of every stage, a list with one entry per run."""

    frames: int = 0
    tracked: int = 0
    keyframes: int = 0
    points: int = 0
    maps: int = 0
    loops: int = 0
    merges: int = 0
    relocalizations: int = 0
    timings_ms: dict[str, list[float]] = field(default_factory=dict)
