"""What has been tracked and what it took: the poses of the past, against their keyframes; counts; times by stage."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.lens import Lens
from base_station.trackers.slam.map import Map, MapUpdate
from base_station.trackers.slam.se3 import inverse
from base_station.trackers.slam.types import Closure, SlamStatistics

MOST_POSES = 100_000
"""Of the trajectory, about an hour's; when there are more, every second of the older half is dropped."""
MOST_TIMINGS = 20_000
"""Of a stage, the latest."""


@dataclass(frozen=True)
class Tracked:
    """A frame's pose against its keyframe, of `size` then (`Map.sizes`)."""

    time_s: float
    reference: int
    cam_from_reference: np.ndarray
    size: float


@dataclass
class History:
    """Since the start."""

    frames: int = 0
    tracked: int = 0
    relocalizations: int = 0
    _loops: int = 0
    _corrected: int = 0
    _merges: int = 0
    _closures: list[Closure] = field(default_factory=list)
    _poses: list[Tracked] = field(default_factory=list)
    _timings_ms: dict[str, deque[float]] = field(default_factory=dict)

    def note_pose(self, where: Tracked) -> None:
        """Of a frame that was tracked."""
        self.tracked += 1
        self._poses.append(where)
        if len(self._poses) > MOST_POSES:
            del self._poses[: MOST_POSES // 2 : 2]

    def note_time(self, stage: str, began_s: float) -> None:
        """From `began_s` (`time.perf_counter`) until now."""
        self._note(stage, (time.perf_counter() - began_s) * 1e3)

    def note_update(self, update: MapUpdate) -> None:
        """What the mapper has done."""
        self._corrected += update.event == "loop"
        self._merges += update.event == "merge"
        self._loops += update.event in ("loop", "confirmed")
        if update.closure is not None:
            self._closures.append(update.closure)
        for stage, took_ms in update.timings_ms.items():
            self._note(f"mapper: {stage}", took_ms)

    def _note(self, stage: str, took_ms: float) -> None:
        self._timings_ms.setdefault(stage, deque(maxlen=MOST_TIMINGS)).append(took_ms)

    def trajectory(self, world: Map, component: int) -> list[tuple[float, np.ndarray]]:
        """(time_s, world_from_cam 4x4) of what was tracked in this map, from its keyframes as they are now."""
        return [
            (one.time_s, inverse(world.pose_by(one.reference, one.cam_from_reference, one.size)))
            for one in self._poses
            if world.component[one.reference] == component
        ]

    def statistics(self, world: Map, camera: SlamCamera) -> SlamStatistics:
        """Counts so far. `camera`: as it was given."""
        alive = world.keyframes_alive()
        return SlamStatistics(
            frames=self.frames,
            tracked=self.tracked,
            keyframes=len(alive),
            points=len(world.points_alive()),
            maps=len(np.unique(world.component[alive])),
            loops=self._loops,
            loops_corrected=self._corrected,
            merges=self._merges,
            relocalizations=self.relocalizations,
            closures=tuple(self._closures),
            camera=Lens(*world.lens).of(camera),
            timings_ms={stage: list(took_ms) for stage, took_ms in self._timings_ms.items()},
        )
