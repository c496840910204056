"""The SLAM system as the outside sees it: pictures in, poses out; a map and a trajectory at the end.

`track` is one picture's way: features; then, without a map, initialization; with one, tracking, and relocalization
when that fails; then the keyframe decision. All that changes the map happens at the mapper's.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from types import TracebackType

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import FeatureExtractor
from base_station.trackers.slam.initialization import Initializer, InitialPair
from base_station.trackers.slam.keyframe_decision import wants_keyframe
from base_station.trackers.slam.map import NONE, Map, MapUpdate
from base_station.trackers.slam.mapper import NewKeyframe, NewMap
from base_station.trackers.slam.mapper_process import MapperHere, MapperLink, MapperProcess
from base_station.trackers.slam.matching import Grid
from base_station.trackers.slam.se3 import inverse, orthonormal
from base_station.trackers.slam.settings import SlamSettings
from base_station.trackers.slam.tracking import FrameTracker, Located, Picture
from base_station.trackers.slam.types import SlamFrame, SlamStatistics
from base_station.types import TrackingState

__all__ = ["SlamCamera", "SlamFrame", "SlamSettings", "SlamStatistics", "SlamSystem"]

FIRST_MAP_WITHIN_S = 0.2
FINISH_WITHIN_S = 60.0


@dataclass
class _Counts:
    frames: int = 0
    tracked: int = 0
    relocalizations: int = 0
    timings_ms: dict[str, list[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Tracked:
    time_s: float
    reference: int
    cam_from_reference: np.ndarray


class SlamSystem:
    """Monocular SLAM. A context manager: `close()` ends the mapper's process.

    `single_process`: the mapper works within `track`; the same pictures then give the same poses, for any machine load.
    """

    def __init__(
        self,
        camera: SlamCamera,
        *,
        settings: SlamSettings | None = None,
        single_process: bool = False,
        seed: int = 0,
    ) -> None:
        self._camera = camera
        self.settings = settings or SlamSettings()
        self._extract = FeatureExtractor(camera, self.settings.features)
        self._map = Map(self.settings.features.count, self._extract.scales)
        self._initializer = Initializer(camera, self._extract.scales, self.settings.initializer)
        self._tracker = FrameTracker(camera, self._map, self.settings.tracking)
        self._link: MapperLink = (MapperHere if single_process else MapperProcess)(camera, self.settings)
        self._state = TrackingState.INITIALIZING
        self._next_row, self._component = 0, NONE
        self._pending: Picture | None = None
        self._keyframe_frame = 0
        self._lost_frames = 0
        self._trajectory: list[_Tracked] = []
        self._counts = _Counts()
        self._closed = False

    # --- pictures ---------------------------------------------------------------------------------------------------

    def track(self, image: np.ndarray, time_s: float) -> SlamFrame:
        """The pose of this gray uint8 picture. Never raises for a bad picture: LOST, with the reason."""
        self._counts.frames += 1
        wrong = self._wrong(image)
        if wrong:
            self._tracker.stopped()
            return self._lost(wrong)
        began = time.perf_counter()
        self._take(self._link.receive())
        self._time("updates", began)
        began = time.perf_counter()
        features = self._extract(image)
        picture = Picture(time_s, features, Grid.of(features.xy_px, self._camera.bounds_px))
        self._time("features", began)
        if self._component == NONE:
            return self._begin(picture)
        began = time.perf_counter()
        found = self._locate(picture)
        self._time("tracking", began)
        if isinstance(found, str):
            return self._lost(found)
        return self._located(picture, found)

    def _wrong(self, image: np.ndarray) -> str:
        if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype != np.uint8:
            return "not a gray picture of 8 bits"
        if image.shape != (self._camera.height_px, self._camera.width_px):
            return (
                f"a picture of {image.shape[1]}x{image.shape[0]} px, the camera has "
                f"{self._camera.width_px}x{self._camera.height_px}"
            )
        return ""

    def _begin(self, picture: Picture) -> SlamFrame:
        pair = self._initializer(picture.time_s, picture.features, picture.grid)
        if not isinstance(pair, InitialPair):
            return SlamFrame(TrackingState.INITIALIZING, reason=pair)
        rows = self._next_row, self._next_row + 1
        self._next_row += 2
        self._initializer.reset()
        work = NewMap(pair, rows, self._next_component())
        self._map.features.update(zip(rows, pair.features, strict=True))
        self._link.send(work)
        self._take(self._link.receive(FIRST_MAP_WITHIN_S))
        if not self._map.alive[rows[1]]:
            return SlamFrame(TrackingState.INITIALIZING, reason="the first points do not hold")
        self._component = work.component
        self._keyframe_frame = self._counts.frames
        found = self._tracker.locate_by(picture, rows[1])
        if isinstance(found, str):
            return self._lost(found)
        return self._located(picture, found)

    def _next_component(self) -> int:
        return int(self._map.component.max()) + 1

    def _locate(self, picture: Picture) -> Located | str:
        if self._lost_frames == 0 or self._lost_frames < 5:
            found = self._tracker.follow(picture)
            if not isinstance(found, str):
                return found
        return "lost"

    def _located(self, picture: Picture, found: Located) -> SlamFrame:
        self._tracker.remember(picture, found, moving=self._lost_frames == 0)
        self._lost_frames = 0
        self._state = TrackingState.TRACKING
        self._counts.tracked += 1
        reference = found.reference
        relative = orthonormal(found.cam_from_world @ inverse(self._map.final_pose(reference)))
        self._trajectory.append(_Tracked(picture.time_s, reference, relative))
        kept = wants_keyframe(
            self.settings.keyframes,
            frames_since=self._counts.frames - self._keyframe_frame,
            matches=found.matches,
            share=self._share_seen(picture, reference),
            waiting=self._link.waiting(),
        )
        if kept:
            self._keep(picture, reference, relative)
        return SlamFrame(TrackingState.TRACKING, found.cam_from_world, keyframe=kept, matches=found.matches)

    def _share_seen(self, picture: Picture, reference: int) -> float:
        """Of the points that the reference keyframe sees surely, those that the picture sees."""
        world = self._map
        mine = world.point_of[reference]
        mine = mine[mine >= 0]
        sure = mine[world.point_alive[mine] & (world.observed[mine] >= 3)]
        if len(sure) < self.settings.keyframes.least_matches:
            sure = mine
        return float(np.isin(sure, picture.point_of).mean()) if len(sure) else 0.0

    def _keep(self, picture: Picture, reference: int, relative: np.ndarray) -> None:
        began = time.perf_counter()
        row = self._next_row
        self._next_row += 1
        self._keyframe_frame = self._counts.frames
        self._map.features[row] = picture.features
        counts = self._tracker.take_counts()
        self._link.send(
            NewKeyframe(row, picture.time_s, picture.features, picture.point_of.copy(), reference, relative, *counts)
        )
        self._time("keyframe", began)

    def _lost(self, reason: str) -> SlamFrame:
        if self._component == NONE:
            return SlamFrame(TrackingState.INITIALIZING, reason=reason)
        self._lost_frames += 1
        self._tracker.stopped()
        self._state = TrackingState.LOST
        return SlamFrame(TrackingState.LOST, reason=reason)

    def _take(self, updates: list[MapUpdate]) -> None:
        for update in updates:
            self._map.apply(update)
            for stage, took_ms in update.timings_ms.items():
                self._counts.timings_ms.setdefault(f"mapper: {stage}", []).append(took_ms)

    def _time(self, stage: str, began: float) -> None:
        self._counts.timings_ms.setdefault(stage, []).append((time.perf_counter() - began) * 1e3)

    # --- the end ----------------------------------------------------------------------------------------------------

    def finish(self) -> None:
        """Let the mapper work off its queue; then `trajectory` and `keyframes` are final."""
        deadline_s = time.monotonic() + FINISH_WITHIN_S
        while self._link.waiting() and time.monotonic() < deadline_s:
            self._take(self._link.receive(0.5))
        self._take(self._link.receive())

    def _largest(self) -> int:
        component = self._map.component[self._map.keyframes_alive()]
        return int(np.bincount(component).argmax()) if len(component) else NONE

    def trajectory(self) -> list[tuple[float, np.ndarray]]:
        """(time_s, world_from_cam 4x4) of every tracked frame of the largest map, from its keyframe's final pose."""
        largest = self._largest()
        return [
            (one.time_s, inverse(one.cam_from_reference @ self._map.final_pose(one.reference)))
            for one in self._trajectory
            if self._map.component[one.reference] == largest
        ]

    def keyframes(self) -> list[tuple[float, np.ndarray]]:
        """(time_s, world_from_cam 4x4) of the largest map's keyframes."""
        rows = self._map.keyframes_alive(self._largest())
        return [(float(self._map.time_s[row]), inverse(self._map.poses[row])) for row in rows]

    def points(self) -> np.ndarray:
        """(n, 3) points of the largest map, metres up to scale."""
        return self._map.xyz[self._map.points_alive(self._largest())]

    def statistics(self) -> SlamStatistics:
        """Counts so far."""
        alive = self._map.keyframes_alive()
        return SlamStatistics(
            frames=self._counts.frames,
            tracked=self._counts.tracked,
            keyframes=len(alive),
            points=len(self._map.points_alive()),
            maps=len(np.unique(self._map.component[alive])),
            relocalizations=self._counts.relocalizations,
            timings_ms=self._counts.timings_ms,
        )

    def close(self) -> None:
        """End the mapper's process. May be called twice."""
        if not self._closed:
            self._closed = True
            self._link.close()

    def __enter__(self) -> SlamSystem:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
