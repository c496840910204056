"""The SLAM system as the outside sees it: pictures in, poses out; a map and a trajectory at the end.

`track` is one picture's way: features; then, without a map, initialization; with one, tracking, and relocalization
when that fails; then the keyframe decision. All that changes the map happens at the mapper's.
"""

from __future__ import annotations

import math
import time
import weakref
from dataclasses import replace
from types import TracebackType

import numpy as np

from base_station.trackers.slam import libraries
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import FeatureExtractor, Features
from base_station.trackers.slam.history import History, Tracked
from base_station.trackers.slam.initialization import Initializer
from base_station.trackers.slam.keyframe_decision import ELSEWHERE, Moved, moved_since, share_seen, wants_keyframe
from base_station.trackers.slam.lens import Lens, look_through, through
from base_station.trackers.slam.map import NONE, Map, MapUpdate
from base_station.trackers.slam.mapper import Forget, NewKeyframe, NewMap, Settle, TakeUp
from base_station.trackers.slam.mapper_process import MapperHere, MapperLink, MapperProcess
from base_station.trackers.slam.matching import Grid
from base_station.trackers.slam.rehearsal import rehearse_tracking
from base_station.trackers.slam.relocalization import Places
from base_station.trackers.slam.saved_map import SavedMap
from base_station.trackers.slam.se3 import inverse, median_depth, relative
from base_station.trackers.slam.settings import SlamSettings
from base_station.trackers.slam.tracking import FrameTracker, Located, Picture
from base_station.trackers.slam.types import SlamFrame, SlamStatistics
from base_station.types import TrackingState

__all__ = ["SlamCamera", "SlamFrame", "SlamSettings", "SlamStatistics", "SlamSystem"]

FIRST_MAP_WITHIN_S = 0.2
FINISH_WITHIN_S = 120.0
MOST_FIRST_TRIES = 5
LOST_SMALL_FRAMES = 3
JITTER_S = 0.1
"""By which pictures of a live camera may come early."""
MOST_AHEAD_S, LONGEST_WAIT_S, LOOK_EVERY_S = 5.0, 30.0, 0.5


class SlamSystem:
    """Monocular SLAM. A context manager: `close()` ends the mapper's process.

    `single_process`: the mapper works within `track`; the same pictures then give the same poses, for any machine load.
    `seed`: of the random choices when places are compared. `mapper_at_once`: wait for the mapper's process now; if
    not, it gets ready meanwhile, and a map that begins in the first seconds is late. `saved`: a map of an earlier run
    (`map_file.py`); the camera is LOST until it recognises a place in it, as after any loss.
    Raises StationError when pycolmap or gtsam is missing, the mapper's process does not start, or the saved map is of
    another camera.
    """

    def __init__(
        self,
        camera: SlamCamera,
        *,
        settings: SlamSettings | None = None,
        single_process: bool = False,
        seed: int = 0,
        mapper_at_once: bool = True,
        saved: SavedMap | None = None,
    ) -> None:
        libraries.gtsam()
        settings = settings or SlamSettings()
        loops = replace(settings.loops, sim3=replace(settings.loops.sim3, seed=seed))
        self.settings = settings = replace(settings, loops=loops)
        saved = saved.ready_for(camera, settings.features) if saved is not None else None
        self._camera = camera
        self._extract = FeatureExtractor(camera, settings.features)
        self._map = Map(settings.features.count, self._extract.scales)
        self._places = Places(self._map, settings.places)
        self._initializer = Initializer(camera, self._extract.scales, settings.initializer)
        self._tracker = FrameTracker(camera, self._map, settings.tracking)
        self._link: MapperLink = (
            MapperHere(camera, settings) if single_process else MapperProcess(camera, settings, at_once=mapper_at_once)
        )
        rehearse_tracking()
        self._next_row = self._next_component = 0
        self._component = NONE
        """The map that is used now."""
        self._awaited: NewMap | None = None
        self._first: int | None = None
        """Of a map that has just begun, the keyframe to find the next picture by."""
        self._keyframe_frame = 0
        self._kept: Tracked | None = None
        """Where the last keyframe was taken."""
        self._last_located_s = self._lost_since_s = 0.0
        self._lost_frames = 0
        self.last_picture: Picture | None = None
        """The last picture that could be looked at, with its features and the map points that they show."""
        self._caught_up = 0.0, -math.inf
        """When the mapper last had nothing to do: in the pictures' time, and by the clock."""
        self._reference = NONE
        self._unsettled = False
        """Whether the map has changed since it was adjusted as a whole."""
        self._history = History()
        self._end = weakref.finalize(self, self._link.close)
        self._taken_up = 0
        """Keyframes of an earlier run, which are the first ones."""
        if saved is not None:
            self._take_up(saved)

    def _take_up(self, saved: SavedMap) -> None:
        """As after a loss, but that nothing is known of the last picture."""
        saved.fill(self._map, self._places)
        self._link.send(TakeUp(saved))
        self._next_row = self._taken_up = self._map.keyframe_count
        self._next_component = int(saved.columns["component"].max()) + 1
        self._component = self._largest()

    # --- pictures ---------------------------------------------------------------------------------------------------

    def track(self, image: np.ndarray, time_s: float, *, wait: bool = False) -> SlamFrame:
        """The pose of this gray uint8 picture. Never raises for a bad picture: LOST, with the reason. `wait`: until the
        mapper has finished with the pictures before (lockstep), as if it needed no time. Raises StationError when the
        mapper's process has failed or ended, with what is known of it: the map would stand still."""
        self._history.frames += 1
        self.last_picture = None
        began = time.perf_counter()
        self._take(self._link.receive())
        self._let_mapper_keep_up(time_s, wait)
        self._history.note_time("updates", began)
        wrong = self._wrong(image)
        if wrong:
            return self._lost(time_s, wrong)
        began = time.perf_counter()
        features = self.features_of(image)
        picture = Picture(time_s, features, Grid.of(features.xy_px, self._camera.bounds_px))
        self.last_picture = picture
        self._history.note_time("features", began)
        began = time.perf_counter()
        found = self._locate(picture)
        self._history.note_time("tracking", began)
        return self._lost(time_s, found) if isinstance(found, str) else self._located(picture, found)

    def _let_mapper_keep_up(self, time_s: float, wait: bool) -> None:
        """Pictures that come faster than their own time passes (a simulation, a file) wait for the mapper as long as
        the camera would have taken. Pictures of a live camera are never ahead."""
        if not self._link.waiting():
            self._caught_up = time_s, time.monotonic()
            return
        since_s, clock_s = self._caught_up
        until_s = clock_s + min(time_s - since_s, MOST_AHEAD_S) - JITTER_S
        if wait:
            until_s = time.monotonic() + LONGEST_WAIT_S
        while self._link.waiting() and self._link.alive() and (left_s := until_s - time.monotonic()) > 0:
            self._take(self._link.receive(min(left_s, LOOK_EVERY_S)))

    def _wrong(self, image: np.ndarray) -> str:
        if not isinstance(image, np.ndarray) or image.ndim != 2 or image.dtype != np.uint8:
            return "not a gray picture of 8 bits"
        if image.shape != (self._camera.height_px, self._camera.width_px):
            size = f"{self._camera.width_px}x{self._camera.height_px}"
            return f"a picture of {image.shape[1]}x{image.shape[0]} px, the camera has {size}"
        return ""

    def _locate(self, picture: Picture) -> Located | str:
        """Where the picture was taken: after the last one; at a place in any map; or as the second of a new map."""
        reason = "no map yet"
        if self._first is not None:
            found = self._by_first_keyframe(picture)
            if not isinstance(found, str):
                return found
        if self._component != NONE:
            lost_s = picture.time_s - self._last_located_s
            if lost_s <= self.settings.atlas.near_s or not self._lost_frames:
                found = self._tracker.follow(picture)
                if not isinstance(found, str):
                    return found
                reason = found
            self._leave_small_map()
            found = self._relocalize(picture)
            if not isinstance(found, str):
                return found
            waits = picture.time_s - self._lost_since_s < self.settings.atlas.new_map_after_s
            if self._component != NONE and (waits or not self._lost_frames):
                self._initializer.watch(picture.time_s, picture.features, picture.grid)
                return reason
        return self._begin(picture)

    def _worth_keeping(self, component: int) -> bool:
        return len(self._map.keyframes_alive(component)) >= self.settings.atlas.least_keyframes

    def _leave_small_map(self) -> None:
        """A map that is not worth keeping is forgotten when it has been lost for some frames; an older one, if there
        is any, is then the one that is lost: its places are still looked for, and a new map may begin at once."""
        small = not self._worth_keeping(self._component)
        if small and self._lost_frames >= LOST_SMALL_FRAMES and not self._link.waiting():
            self._link.send(Forget(self._component))
            self._tracker.forget()
            self._component = self._largest(without=self._component)
            self._lost_since_s = -math.inf

    def _relocalize(self, picture: Picture) -> Located | str:
        """At a place of any map that is worth keeping."""
        began = time.perf_counter()
        try:
            return self._recognised(picture)
        finally:
            self._history.note_time("relocalization", began)

    def _recognised(self, picture: Picture) -> Located | str:
        for keyframe in self._places.candidates(self._places.words(picture.features)):
            if not self._worth_keeping(int(self._map.component[keyframe])):
                continue
            found = self._tracker.locate_by(picture, keyframe)
            if not isinstance(found, str):
                self._history.relocalizations += 1
                return found
        return "no place is recognised"

    def _begin(self, picture: Picture) -> Located | str:
        if self._awaited is None:
            pair = self._initializer(picture.time_s, picture.features, picture.grid)
            if isinstance(pair, str):
                return pair
            self._initializer.reset()
            rows = self._next_row, self._next_row + 1
            words = self._places.words(pair.features[0]), self._places.words(pair.features[1])
            self._awaited = NewMap(pair, rows, words, self._next_component)
            self._next_row, self._next_component = self._next_row + 2, self._next_component + 1
            self._map.features.update(zip(rows, pair.features, strict=True))
            for row, of_row in zip(rows, words, strict=True):
                self._places.add(row, of_row)
            self._link.send(self._awaited)
            self._take(self._link.receive(FIRST_MAP_WITHIN_S))
        if self._awaited is not None:
            return "the mapper works on the first points"
        return "the first points do not hold" if self._first is None else self._by_first_keyframe(picture)

    def _by_first_keyframe(self, picture: Picture) -> Located | str:
        """In a map that has just begun there is no last picture yet."""
        assert self._first is not None
        found = self._tracker.locate_by(picture, self._first)
        if not isinstance(found, str) or self._lost_frames > MOST_FIRST_TRIES:
            self._first = None
        return found

    def _located(self, picture: Picture, found: Located) -> SlamFrame:
        doubt = self._tracker.doubt(picture, found)
        self._tracker.remember(picture, found, moving=not self._lost_frames)
        self._component = int(self._map.component[found.reference])
        self._last_located_s, self._lost_frames = picture.time_s, 0
        self._initializer.reset()
        self._reference = reference = found.reference
        from_reference = relative(found.cam_from_world, self._map.poses[reference])
        where = Tracked(picture.time_s, reference, from_reference, float(self._map.sizes[reference]))
        if not doubt:
            self._history.note_pose(where)
        kept = wants_keyframe(
            self.settings.keyframes,
            frames_since=self._history.frames - self._keyframe_frame,
            matches=found.matches,
            share=self._share_seen(picture, reference),
            waiting=self._link.waiting(),
            moved=self._moved(found),
        )
        if kept:
            self._keep(picture, where)
        if doubt:
            return SlamFrame(TrackingState.LOST, reason=doubt, keyframe=kept, matches=found.matches)
        return SlamFrame(
            TrackingState.TRACKING, found.cam_from_world, keyframe=kept, matches=found.matches,
            component=self._component,
        )  # fmt: skip

    def _share_seen(self, picture: Picture, reference: int) -> float:
        """Of the points that the reference keyframe sees surely, those that the picture sees."""
        world, least = self._map, self.settings.keyframes.least_matches
        return share_seen(world.point_of[reference], picture.point_of, world.point_alive, world.observed, least)

    def _moved(self, found: Located) -> Moved:
        """How the camera has moved since the last keyframe was taken."""
        kept, world = self._kept, self._map
        if kept is None or world.component[world.living(kept.reference)] != self._component:
            return ELSEWHERE
        before = world.pose_by(kept.reference, kept.cam_from_reference, kept.size)
        return moved_since(before, found.cam_from_world, median_depth(found.cam_from_world, world.xyz, found.point_of))

    def _keep(self, picture: Picture, where: Tracked) -> None:
        self._keyframe_frame, self._kept = self._history.frames, where
        self._send(picture.features, picture.point_of.copy(), where, *self._tracker.take_counts())

    def insert(self, time_s: float, features: Features, point_of: np.ndarray, cam_from_world: np.ndarray) -> int:
        """Make a keyframe of a picture that was not tracked, but shows points of the map in use; its number.

        `point_of` (n,): which point each feature shows, -1 for none. `cam_from_world`: about where it was taken.
        """
        reference = self.reference
        from_reference = relative(cam_from_world, self._map.poses[reference])
        none = np.empty(0, np.int64)
        where = Tracked(time_s, reference, from_reference, float(self._map.sizes[reference]))
        return self._send(features, point_of, where, none, none, none)

    def _send(
        self, features: Features, point_of: np.ndarray, where: Tracked,
        counted: np.ndarray, expected: np.ndarray, found: np.ndarray,
    ) -> int:  # fmt: skip
        row, self._next_row = self._next_row, self._next_row + 1
        self._map.features[row] = features
        words = self._places.words(features)
        self._places.add(row, words)
        self._link.send(
            NewKeyframe(
                row, where.time_s, features, point_of, where.reference, where.cam_from_reference, where.size, words,
                counted, expected, found,
            )
        )  # fmt: skip
        return row

    def _lost(self, time_s: float, reason: str) -> SlamFrame:
        self._tracker.stopped()
        if self._component == NONE:
            self._lost_frames = 0
            return SlamFrame(TrackingState.INITIALIZING, reason=reason)
        if not self._lost_frames:
            self._lost_since_s = time_s
        self._lost_frames += 1
        return SlamFrame(TrackingState.LOST, reason=reason)

    def _take(self, updates: list[MapUpdate]) -> None:
        """Bring the tracker's copy of the map up to date."""
        for update in updates:
            self._map.apply(update)
            look_through(self._map, Lens(*update.lens), self._camera)
            self._unsettled = update.event not in ("settled", "left as it is", "taken up")
            if update.event in ("loop", "merge", "settled"):
                self._tracker.stopped()
            self._history.note_update(update)
            if self._awaited is not None and update.event in ("new map", "forgotten map"):
                if update.event == "new map":
                    self._component, self._first = self._awaited.component, self._awaited.rows[1]
                    self._tracker.forget()
                    self._keyframe_frame, self._kept = self._history.frames, None
                self._awaited = None
        if updates:
            self._places.tidy()

    def features_of(self, image: np.ndarray) -> Features:
        """The features of a picture, as the map's lens has them; it is not tracked."""
        return through(self._extract(image), Lens(), Lens(*self._map.lens), self._camera)

    @property
    def map(self) -> Map:
        """The tracker's copy of the map: to be read between two calls of `track`."""
        return self._map

    @property
    def component(self) -> int:
        """Which map of the atlas is in use; -1: none yet."""
        return self._component

    @property
    def reference(self) -> int:
        """The keyframe that shares most with the last picture that was followed; -1 before the first."""
        return self._reference

    # --- the end ----------------------------------------------------------------------------------------------------

    def finish(self) -> None:
        """Let the mapper work off its queue and adjust the whole map; then `trajectory` and `keyframes` are final,
        until the next picture. Raises StationError when the mapper's process has failed or ended."""
        deadline_s = time.monotonic() + FINISH_WITHIN_S
        self._wait_for_mapper(deadline_s)
        if self._unsettled and self._link.alive() and not self._link.waiting():
            self._link.send(Settle(self._largest()))
            self._wait_for_mapper(deadline_s)

    def _wait_for_mapper(self, deadline_s: float) -> None:
        while self._link.waiting() and self._link.alive() and time.monotonic() < deadline_s:
            self._take(self._link.receive(0.5))
        self._take(self._link.receive())

    def _largest(self, without: int = NONE) -> int:
        component = self._map.component[self._map.keyframes_alive()]
        component = component[component != without]
        return int(np.bincount(component).argmax()) if len(component) else NONE

    def trajectory(self) -> list[tuple[float, np.ndarray]]:
        """(time_s, world_from_cam 4x4) of every tracked frame of the largest map, from its keyframe's final pose. Of a
        run of hours the older poses are thinned out (`history.MOST_POSES`)."""
        return self._history.trajectory(self._map, self._largest())

    def keyframes(self) -> list[tuple[float, np.ndarray]]:
        """(time_s, world_from_cam 4x4) of the largest map's keyframes, but those of an earlier run: their time was
        another."""
        rows = self._map.keyframes_alive(self._largest())
        rows = rows[rows >= self._taken_up]
        rows = rows[np.argsort(self._map.time_s[rows], kind="stable")]
        return [(float(self._map.time_s[row]), inverse(self._map.poses[row])) for row in rows]

    def points(self) -> np.ndarray:
        """(n, 3) points of the largest map, metres up to scale."""
        return self._map.xyz[self._map.points_alive(self._largest())]

    def saved(self) -> SavedMap | None:
        """The maps that are worth keeping, to be taken up later: after `finish`. None when there is none."""
        return SavedMap.of(self._map, self._camera, self.settings.atlas.least_keyframes)

    def statistics(self) -> SlamStatistics:
        """Counts so far."""
        return self._history.statistics(self._map, self._camera)

    def close(self) -> None:
        """End the mapper's process. May be called twice."""
        self._end()

    def __enter__(self) -> SlamSystem:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
