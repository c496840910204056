"""The mapper: what becomes of a keyframe. It alone changes the map.

It knows nothing of processes: `mapper_process` runs it in one of its own, or in the caller's.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.culling import cull_keyframes, cull_points
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.fusion import fuse_neighbourhood
from base_station.trackers.slam.initialization import InitialPair
from base_station.trackers.slam.local_bundle import adjust, adjust_locally
from base_station.trackers.slam.loop_closing import correction, find_loop
from base_station.trackers.slam.loop_correction import correct, tie
from base_station.trackers.slam.map import NONE, Map, MapUpdate, refresh_points
from base_station.trackers.slam.new_points import make_points, median_depth
from base_station.trackers.slam.relocalization import Places
from base_station.trackers.slam.returning import Returns
from base_station.trackers.slam.saved_map import SavedMap
from base_station.trackers.slam.types import Closure
from base_station.trackers.slam.whole_bundle import adjust_whole

if TYPE_CHECKING:
    from base_station.trackers.slam.settings import SlamSettings


@dataclass(frozen=True)
class NewMap:
    """A first pair for a map of its own: `component`. `rows`: its two keyframes' numbers."""

    pair: InitialPair
    rows: tuple[int, int]
    words: tuple[np.ndarray, np.ndarray]
    component: int


@dataclass(frozen=True)
class Forget:
    """A map that was lost before it was worth keeping."""

    component: int


@dataclass(frozen=True)
class Settle:
    """No picture follows for now: a map may be adjusted as a whole."""

    component: int


@dataclass(frozen=True)
class TakeUp:
    """A map of an earlier run, before anything else."""

    saved: SavedMap


@dataclass(frozen=True)
class NewKeyframe:
    """A picture that the tracker wants kept. Its pose is given against a keyframe, which may have moved since.

    `point_of` (n,): which point each feature shows. `size`: the reference's when the pose was true (`Map.sizes`).
    `words` (n,): the visual word of each feature. `expected`, `found`: for the points in `counted`, in how many
    frames since the last keyframe they should have been seen, and were.
    """

    row: int
    time_s: float
    features: Features
    point_of: np.ndarray
    reference: int
    cam_from_reference: np.ndarray
    size: float
    words: np.ndarray
    counted: np.ndarray
    expected: np.ndarray
    found: np.ndarray


class Mapper:
    """Owns the map. Each step returns what changed."""

    def __init__(self, camera: SlamCamera, settings: SlamSettings) -> None:
        self._camera, self._settings = camera, settings
        scales = settings.features.scale_factor ** np.arange(settings.features.levels)
        self.map = Map(settings.features.count, scales)
        self._young = np.empty(0, np.int32)
        self._places = Places(self.map, settings.places)
        self._closed: list[tuple[int, int]] = []
        self._returns = Returns(camera, settings.returns)
        self._looked_after = 0
        self._timings_ms: dict[str, float] = {}

    def begin(self, new: NewMap) -> MapUpdate:
        """Two keyframes and their points, adjusted together; the median depth becomes 1. Empty if it does not hold."""
        began = time.perf_counter()
        world, pair = self.map, new.pair
        one, two = new.rows
        world.add_keyframe(one, pair.times_s[0], np.eye(4), pair.features[0], np.empty(0, np.int32), new.component)
        world.add_keyframe(
            two, pair.times_s[1], pair.two_from_one, pair.features[1], np.empty(0, np.int32), new.component
        )
        rows = world.add_points(pair.points, pair.features[1].descriptors[pair.rows_two], two)
        world.point_of[one, pair.rows_one] = rows
        world.point_of[two, pair.rows_two] = rows
        both = np.array([one, two])
        adjust(world, np.array([two]), np.array([one]), rows, self._camera, iterations=20)
        rows = rows[world.point_alive[rows]]
        depth = median_depth(world, one)
        held = len(rows) >= self._settings.initializer.two_view.least_points and depth > 0 and np.isfinite(depth)
        if not held:
            return self.forget(new.component)
        world.xyz[rows] /= depth
        world.poses[two, :3, 3] /= depth
        world.recount(both)
        refresh_points(world, rows, both)
        self._young = rows
        for row, words in zip(new.rows, new.words, strict=True):
            self._places.add(row, words)
        return self._changes("new map", began)

    def take_up(self, saved: SavedMap) -> MapUpdate:
        """Go on in a map of an earlier run. Who sent it has it already: no rows come back."""
        began = time.perf_counter()
        saved.fill(self.map, self._places)
        return self._changes("taken up", began)

    def insert(self, new: NewKeyframe, busy: Callable[[], bool] = lambda: False) -> MapUpdate:
        """All that a keyframe brings. `busy`: whether others wait; then the costly last steps are left out."""
        began = time.perf_counter()
        world, settings = self.map, self._settings
        if not world.alive[new.reference] and world.anchor[new.reference] == NONE:
            world.skip_keyframe(new.row)  # its map is gone; the tracker is to forget the picture, too
            return self._changes("keyframe of a forgotten map", began)
        self._count(new)
        component = int(world.component[new.reference])
        pose = world.pose_by(new.reference, new.cam_from_reference, new.size)
        world.add_keyframe(new.row, new.time_s, pose, new.features, self.map.current(new.point_of), component)
        row = np.array([new.row])
        world.see_each_point_once(row)
        world.recount(row)
        confirmed = None if busy() or new.row < self._looked_after else self._returns.look(world, new.row)
        self._young = cull_points(world, self._young, new.row, settings.culling)
        made = make_points(world, new.row, self._camera, settings.new_points)
        self._young = np.concatenate([self._young, made])
        world.recount(row)
        fuse_neighbourhood(world, new.row, self._camera)
        world.recount(row)
        if not busy():
            adjust_locally(world, new.row, self._camera, settings.bundle)
            cull_keyframes(world, new.row, settings.culling)
        near = np.append(world.neighbours(new.row, settings.bundle.moving), new.row)
        world.recount(near)
        around = np.unique(np.concatenate([near, *(world.neighbours(int(k), 10) for k in near)]))
        world.count_observed(world.points_of(near))
        refresh_points(world, world.points_of(near), around)
        self._places.add(new.row, new.words)
        self._places.tidy()
        if confirmed is not None:
            tie(world, new.row, self._returns.place(world), self._closed, self._camera)
        closure = confirmed if confirmed is not None or busy() else self._close_loop(new)
        update = self._changes("keyframe" if closure is None else closure.kind, began)
        return replace(update, closure=closure)

    def _close_loop(self, new: NewKeyframe) -> Closure | None:
        if new.row < self._looked_after:
            return None
        began = time.perf_counter()
        loop = find_loop(self.map, self._places, new.row, new.words, self._camera, self._settings.loops)
        self._note_time("place recognition", began)
        if loop is None:
            return None
        began = time.perf_counter()
        self._looked_after = new.row + self._settings.loops.again_after
        closure = correction(self.map, loop)
        correct(self.map, loop, self._closed, self._camera, self._settings.bundle)
        self._returns.closed(loop.candidate)
        self._note_time("loop closing", began)
        return closure

    def _note_time(self, stage: str, began: float) -> None:
        self._timings_ms[stage] = (time.perf_counter() - began) * 1e3

    def forget(self, component: int) -> MapUpdate:
        """Drop a map that came to nothing."""
        began, world = time.perf_counter(), self.map
        world.remove_points(world.points_alive(component))
        for row in world.keyframes_alive(component):
            world.drop_keyframe(int(row))
        self._places.tidy()
        return self._changes("forgotten map", began)

    def settle(self, component: int) -> MapUpdate:
        """Adjust a whole map, so that its trajectory is final."""
        began = time.perf_counter()
        done = adjust_whole(self.map, component, self._camera, self._settings.bundle)
        return self._changes("settled" if done else "left as it is", began)

    def _count(self, new: NewKeyframe) -> None:
        np.add.at(self.map.expected, new.counted, new.expected)
        np.add.at(self.map.found, new.counted, new.found)

    def _changes(self, event: str, began: float) -> MapUpdate:
        update, parts = self.map.take_changes(event), self._timings_ms
        self._timings_ms = {}
        return replace(update, timings_ms={event: (time.perf_counter() - began) * 1e3, **parts})
