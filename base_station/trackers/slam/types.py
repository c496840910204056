"""What the SLAM system says to the outside: one value per frame, and counts at the end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.types import TrackingState


@dataclass(frozen=True)
class SlamFrame:
    """What became of one picture.

    `cam_from_world`: 4x4 float64, TRACKING only; its world and scale are those of the map at this moment. `reason`: in
    words, why not TRACKING. `keyframe`: whether the picture became one. `matches`: map points seen in it. `component`:
    which map of the atlas the pose is in, -1 without a pose; poses in different maps cannot be compared.
    """

    state: TrackingState
    cam_from_world: np.ndarray | None = None
    reason: str = ""
    keyframe: bool = False
    matches: int = 0
    component: int = -1


@dataclass(frozen=True, kw_only=True)
class Closure:
    """A place that was recognised and verified, in the keyframe of `time_s`. "loop": the map's error there was spread,
    "merge": two maps were joined, "confirmed": a closed loop's place was right where the map has it.

    By how much the recognised pose differed from the map's: `moved_of_depth` (share of the median depth), `turned_rad`,
    and `scale` (the keyframe's surroundings had to grow so much). For a merge there was nothing to compare with.
    """

    kind: Literal["loop", "merge", "confirmed"]
    time_s: float
    moved_of_depth: float
    turned_rad: float
    scale: float


@dataclass(frozen=True, kw_only=True)
class SlamStatistics:
    """Counts since the start. `closures`: in order. `timings_ms`: of every stage, a list with one entry per run,
    of the latest 20000.
    `loops`: places of the same map that were recognised, verified and tied together; `loops_corrected`: those of them
    that left an error to spread. The others (kind "confirmed") were right already. `camera`:
    the one it was given, or what the whole map has made of it (`lens.py`); None where nothing is known of that."""

    frames: int = 0
    tracked: int = 0
    keyframes: int = 0
    points: int = 0
    maps: int = 0
    loops: int = 0
    loops_corrected: int = 0
    merges: int = 0
    relocalizations: int = 0
    closures: tuple[Closure, ...] = ()
    camera: SlamCamera | None = None
    timings_ms: dict[str, list[float]] = field(default_factory=dict)
