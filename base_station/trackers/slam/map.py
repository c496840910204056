"""The map: keyframes and points as columns of numbers, and who shares what with whom.

*Topological*: keyframes are nodes, and two are neighbours by the number of points that both see (covisibility).
*Metric*: points have a place, a look (descriptor), and the range of distances and directions they are known from.
Rows are numbered for good: a culled keyframe or point stays as a dead row, and says what took its place.

An atlas of maps is one more column: `component`. Keyframes and points of different components share no coordinates.

There is one writer, the mapper. It marks the rows that it changes; `take_changes` packs them, and `apply` brings
another Map (the tracker's own copy) to the same state: the tracker never waits for the mapper, and never sees a
half-made change.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numba import njit

from base_station.trackers.slam.covisibility import Covisibility, count_shared
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.popcount import hamming
from base_station.trackers.slam.se3 import camera_centers, inverse
from base_station.trackers.slam.types import Closure

NONE = -1
MEDOID_MOST = 24
LONGEST_CHAIN = 8
"""Of points replaced by points replaced by others, that is followed."""
FIRST_KEYFRAMES, FIRST_POINTS = 64, 4096
KEYFRAME_COLUMNS = (
    "poses", "sizes", "time_s", "component", "alive", "anchor", "anchor_size", "cam_from_anchor", "point_of"
)  # fmt: skip
POINT_COLUMNS = (
    "xyz", "descriptors", "normals", "nearest", "farthest", "point_alive", "replaced_by", "observed", "point_component",
)  # fmt: skip


@dataclass(frozen=True)
class MapUpdate:
    """Rows that changed, by column name; `shared` (keyframes, alive): the points that they share with those `alive`;
    `event`: what happened; `closure`: the place that was recognised, if one was; `lens`: see `Map.lens`."""

    keyframes: np.ndarray
    points: np.ndarray
    columns: dict[str, np.ndarray]
    alive: np.ndarray
    shared: np.ndarray
    event: str = ""
    timings_ms: dict[str, float] = field(default_factory=dict)
    closure: Closure | None = None
    lens: tuple[float, float] = (1.0, 0.0)


class Map:
    """See the module. `features_most`: the largest number of features that a picture has."""

    def __init__(self, features_most: int, scales: np.ndarray) -> None:
        self.scales = scales
        """(levels,): how many picture px one px of each pyramid level is."""
        self.lens = (1.0, 0.0)
        """Zoom and radial distortion, beyond the camera's own, that its keypoints are free of: see `lens.Lens`."""
        self.keyframe_count = 0
        self.point_count = 0
        k, p = FIRST_KEYFRAMES, FIRST_POINTS
        self.poses = np.zeros((k, 4, 4))
        """cam_from_world."""
        self.sizes = np.ones(k)
        """By how much the map has grown about each keyframe since it was added: a closed loop corrects scale, too."""
        self.time_s = np.zeros(k)
        self.component = np.full(k, NONE, np.int32)
        self.alive = np.zeros(k, np.bool_)
        self.anchor = np.full(k, NONE, np.int32)
        """Of a culled keyframe: the one that it is now given relative to."""
        self.anchor_size = np.ones(k)
        self.cam_from_anchor = np.zeros((k, 4, 4))
        self.point_of = np.full((k, features_most), NONE, np.int32)
        """(keyframes, features): which point each feature shows."""
        self.octave_of = np.zeros((k, features_most), np.uint8)
        """(keyframes, features): the pyramid level of each feature."""
        self.shared = Covisibility()
        """[one, two]: how many points both keyframes see."""
        self.features: dict[int, Features] = {}
        """Of the keyframes alive."""
        self.xyz = np.zeros((p, 3))
        self.descriptors = np.zeros((p, 4), np.uint64)
        self.normals = np.zeros((p, 3), np.float32)
        """Mean unit direction from the cameras that see it."""
        self.nearest = np.zeros(p, np.float32)
        self.farthest = np.zeros(p, np.float32)
        """Distances between which its look fits the pyramid."""
        self.point_alive = np.zeros(p, np.bool_)
        self.replaced_by = np.full(p, NONE, np.int32)
        self.observed = np.zeros(p, np.int32)
        """How many keyframes see it."""
        self.point_component = np.full(p, NONE, np.int32)
        self.born = np.zeros(p, np.int32)
        """The keyframe that made it."""
        self.expected = np.zeros(p, np.int32)
        """In how many frames it should have been seen..."""
        self.found = np.zeros(p, np.int32)
        """...and in how many it was."""
        self._keyframe_changed = np.zeros(k, np.bool_)
        self._point_changed = np.zeros(p, np.bool_)

    # --- rows -------------------------------------------------------------------------------------------------------

    def add_keyframe(
        self, row: int, time_s: float, pose: np.ndarray, features: Features, point_of: np.ndarray, component: int
    ) -> None:
        """A keyframe in row `row`; numbers only go up. `point_of` (n,): the point each feature shows, or -1."""
        self._reserve(row)
        self.shared.add(row)
        self.poses[row], self.time_s[row], self.component[row], self.alive[row] = pose, time_s, component, True
        self.features[row] = features
        self.point_of[row] = NONE
        self.point_of[row, : len(point_of)] = point_of
        self.octave_of[row, : len(features)] = features.octave
        self._keyframe_changed[row] = True

    def skip_keyframe(self, row: int) -> None:
        """There is no keyframe of this number, and there will be none."""
        self._reserve(row)
        self.mark(keyframes=row)

    def _reserve(self, row: int) -> None:
        while row >= len(self.poses):
            self._grow_keyframes()
        self.keyframe_count = max(self.keyframe_count, row + 1)

    def add_points(self, xyz: np.ndarray, descriptors: np.ndarray, born: int) -> np.ndarray:
        """Rows (n,) of new points (n, 3) that look like `descriptors` (n, 4), of the keyframe `born`'s component."""
        first, count = self.point_count, len(xyz)
        while first + count > len(self.xyz):
            self._grow_points()
        self.point_count += count
        rows = np.arange(first, first + count, dtype=np.int32)
        self.xyz[rows], self.descriptors[rows], self.point_alive[rows], self.born[rows] = xyz, descriptors, True, born
        self.expected[rows] = self.found[rows] = 1
        self.point_component[rows] = self.component[born]
        self._point_changed[rows] = True
        return rows

    def _grow_keyframes(self) -> None:
        for name in (*KEYFRAME_COLUMNS, "octave_of", "_keyframe_changed"):
            setattr(self, name, _doubled(getattr(self, name)))
        size = len(self.poses) // 2
        self.shared.reserve(2 * size)
        self.point_of[size:], self.anchor[size:], self.component[size:] = NONE, NONE, NONE
        self.sizes[size:] = self.anchor_size[size:] = 1.0

    def _grow_points(self) -> None:
        size = len(self.xyz)
        for name in (*POINT_COLUMNS, "born", "expected", "found", "_point_changed"):
            setattr(self, name, _doubled(getattr(self, name)))
        self.replaced_by[size:], self.point_component[size:] = NONE, NONE

    # --- looking ----------------------------------------------------------------------------------------------------

    def keyframes_alive(self, component: int | None = None) -> np.ndarray:
        """Rows of the keyframes alive, ascending; of one component, or all."""
        alive = self.alive[: self.keyframe_count]
        return np.flatnonzero(
            alive if component is None else alive & (self.component[: self.keyframe_count] == component)
        )

    def points_alive(self, component: int | None = None) -> np.ndarray:
        """Rows of the points alive, ascending; of one component, or all."""
        alive = self.point_alive[: self.point_count]
        return np.flatnonzero(
            alive if component is None else alive & (self.point_component[: self.point_count] == component)
        )

    def points_of(self, keyframes: np.ndarray) -> np.ndarray:
        """Rows of all points alive that these keyframes see, ascending."""
        seen = np.zeros(self.point_count + 1, np.bool_)
        seen[self.point_of[keyframes].ravel()] = True
        return np.flatnonzero(seen[: self.point_count] & self.point_alive[: self.point_count])

    def neighbours(self, keyframe: int, most: int, least_shared: int = 1) -> np.ndarray:
        """Keyframes alive that share points with this one, those that share most first."""
        alive = self.keyframes_alive()
        weights = self.shared.of(np.array([keyframe]), alive)[0]
        enough = weights >= max(least_shared, 1)
        rows, weights = alive[enough], weights[enough]
        return rows[np.argsort(-weights, kind="stable")[:most]]

    def observations(self, keyframes: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All that these keyframes see: rows of points, of keyframes, and indices of features, each (n,)."""
        position, feature = np.nonzero(self.point_of[keyframes] >= 0)
        rows = np.asarray(keyframes)[position]
        return self.point_of[rows, feature], rows, feature

    def keypoints(self, keyframes: np.ndarray, features: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of feature i of keyframe i, n of both: place (n, 2) px, octave (n,), descriptor (n, 4).

        Quick when those of a keyframe follow each other, as `observations` gives them.
        """
        n = len(keyframes)
        uv, octave, looks = np.empty((n, 2)), np.empty(n, np.int64), np.empty((n, 4), np.uint64)
        starts = np.flatnonzero(np.diff(keyframes, prepend=NONE))
        for first, end in zip(starts, np.append(starts[1:], n), strict=True):
            of, index = self.features[int(keyframes[first])], features[first:end]
            uv[first:end], octave[first:end] = of.xy_px[index], of.octave[index]
            looks[first:end] = of.descriptors[index]
        return uv, octave, looks

    def pose_by(self, keyframe: int, cam_from_keyframe: np.ndarray, size: float = 1.0) -> np.ndarray:
        """cam_from_world of what is given relative to a keyframe, which may be culled by now: through its anchors.

        `size`: the keyframe's at the time when that relative pose was true.
        """
        relative = cam_from_keyframe.copy()
        for row, before, grown in self._way(keyframe, size):
            if before != NONE:
                relative = relative @ self.cam_from_anchor[before]
            relative[:3, 3] *= grown
            keyframe = row
        return relative @ self.poses[keyframe]

    def growth(self, keyframe: int, size: float) -> float:
        """By how much a length about a keyframe has grown since the keyframe had this size; it may be culled by now."""
        return math.prod(grown for _, _, grown in self._way(keyframe, size))

    def _way(self, keyframe: int, size: float) -> Iterator[tuple[int, int, float]]:
        """From a keyframe to the one alive that it is given by: each on the way, the one before (-1: none), and by how
        much lengths have grown since they were given by it. Sizes of different keyframes cannot be compared."""
        yield keyframe, NONE, float(self.sizes[keyframe]) / size
        while not self.alive[keyframe] and self.anchor[keyframe] != NONE:
            before, keyframe = keyframe, int(self.anchor[keyframe])
            yield keyframe, before, float(self.sizes[keyframe] / self.anchor_size[before])

    def living(self, keyframe: int) -> int:
        """This keyframe, or what took its place."""
        while not self.alive[keyframe] and self.anchor[keyframe] != NONE:
            keyframe = int(self.anchor[keyframe])
        return keyframe

    def current(self, point_of: np.ndarray) -> np.ndarray:
        """What these points (rows, or -1) have become; -1 where they are gone."""
        current = point_of.copy()
        for _ in range(LONGEST_CHAIN):
            dead = (current >= 0) & ~self.point_alive[current]
            if not dead.any():
                return current
            current[dead] = self.replaced_by[current[dead]]
        current[(current >= 0) & ~self.point_alive[current]] = NONE
        return current

    # --- changing ---------------------------------------------------------------------------------------------------

    def mark(self, *, keyframes: np.ndarray | int | None = None, points: np.ndarray | None = None) -> None:
        """These rows have changed."""
        if keyframes is not None:
            self._keyframe_changed[keyframes] = True
        if points is not None:
            self._point_changed[points] = True

    def recount(self, keyframes: np.ndarray) -> None:
        """Count anew with whom these keyframes share points."""
        rows, alive = np.asarray(keyframes, np.int64), self.keyframes_alive()
        counted = rows[self.alive[rows]]
        self.shared.set(counted, alive, count_shared(self.point_of, counted, alive, self.point_count))
        self.mark(keyframes=keyframes)

    def count_observed(self, points: np.ndarray) -> None:
        """Count anew how many keyframes see these points."""
        flat = self.point_of[self.keyframes_alive()].ravel()
        counts = np.bincount(flat[flat >= 0], minlength=self.point_count)
        self.observed[points] = counts[points]
        self.mark(points=points)

    def remove_points(self, points: np.ndarray) -> None:
        """These points are no more; no keyframe sees them."""
        if not len(points):
            return
        self.replace_points(points, np.full(len(points), NONE, np.int32))

    def replace_points(self, points: np.ndarray, by: np.ndarray) -> None:
        """Points (n,) turn out to be others (n,), or -1: nothing. The keyframes that saw them see the others."""
        becomes = np.arange(self.point_count + 1, dtype=np.int32)
        becomes[-1] = NONE
        becomes[points] = by
        alive = self.keyframes_alive()
        before = self.point_of[alive]
        after = becomes[before]
        changed = (after != before).any(axis=1)
        rows = alive[changed]
        self.point_of[rows] = after[changed]
        self.see_each_point_once(rows)
        self.point_alive[points] = False
        self.replaced_by[points] = by
        self.found[by[by >= 0]] += self.found[points[by >= 0]]
        self.expected[by[by >= 0]] += self.expected[points[by >= 0]]
        self.mark(keyframes=rows, points=points)

    def see_each_point_once(self, keyframes: np.ndarray) -> None:
        """Where two features of a keyframe show one point, the first one keeps it."""
        _drop_doubles(self.point_of, np.asarray(keyframes, np.int64), np.full(self.point_count, NONE, np.int64))

    def remove_keyframe(self, keyframe: int, anchor: int) -> None:
        """A keyframe is no more; its pose is kept relative to `anchor`, so that the trajectory stays whole."""
        self.anchor[keyframe], self.anchor_size[keyframe] = anchor, self.sizes[anchor]
        self.cam_from_anchor[keyframe] = self.poses[keyframe] @ inverse(self.poses[anchor])
        seen = self.point_of[keyframe]
        self.observed[seen[seen >= 0]] -= 1
        self.mark(points=seen[seen >= 0])
        self.drop_keyframe(keyframe)

    def drop_keyframe(self, keyframe: int) -> None:
        """A keyframe is no more, and nothing took its place."""
        self.alive[keyframe] = False
        self.point_of[keyframe] = NONE
        self.mark(keyframes=keyframe)
        self.shared.remove(keyframe)
        self.features.pop(keyframe, None)

    # --- copies -----------------------------------------------------------------------------------------------------

    def take_changes(self, event: str = "") -> MapUpdate:
        """What changed since the last call."""
        keyframes = np.flatnonzero(self._keyframe_changed[: self.keyframe_count])
        points = np.flatnonzero(self._point_changed[: self.point_count])
        self._keyframe_changed[:] = False
        self._point_changed[:] = False
        columns = {name: getattr(self, name)[keyframes] for name in KEYFRAME_COLUMNS}
        columns |= {name: getattr(self, name)[points] for name in POINT_COLUMNS}
        alive = self.keyframes_alive()
        return MapUpdate(
            keyframes, points, columns, alive, self.shared.of(keyframes, alive), event=event, lens=self.lens
        )

    def apply(self, update: MapUpdate) -> None:
        """Become as the Map that packed these changes."""
        if len(update.keyframes):
            self._reserve(int(update.keyframes[-1]))
        if len(update.points):
            while update.points[-1] >= len(self.xyz):
                self._grow_points()
            self.point_count = max(self.point_count, int(update.points[-1]) + 1)
        for name in KEYFRAME_COLUMNS:
            getattr(self, name)[update.keyframes] = update.columns[name]
        for name in POINT_COLUMNS:
            getattr(self, name)[update.points] = update.columns[name]
        lives = self.alive[update.keyframes]
        for row in update.keyframes[~lives].tolist():
            self.shared.remove(row)
            self.features.pop(row, None)
        for row in update.keyframes[lives].tolist():
            self.shared.add(row)
        self.shared.set(update.keyframes[lives], update.alive, update.shared[lives])


def refresh_points(world: Map, points: np.ndarray, keyframes: np.ndarray) -> None:
    """Bring look, direction and range of these points up to date with all that `keyframes` see of them."""
    rows, seers, features = world.observations(keyframes)
    wanted = np.zeros(world.point_count, np.bool_)
    wanted[points] = True
    kept = wanted[rows]
    rows, seers, features = rows[kept], seers[kept], features[kept]
    if not len(rows):
        return
    _, octaves, looks = world.keypoints(seers, features)
    order = np.argsort(rows, kind="stable")
    rows, seers, octaves, looks = rows[order], seers[order], octaves[order], looks[order]
    starts = np.flatnonzero(np.diff(rows, prepend=-1))
    unique, counts = rows[starts], np.diff(starts, append=len(rows))
    away = world.xyz[rows] - camera_centers(world.poses[seers])
    distances = np.linalg.norm(away, axis=1)
    sums = np.add.reduceat(away / np.maximum(distances, 1e-12)[:, None], starts, axis=0)
    world.normals[unique] = sums / np.maximum(np.linalg.norm(sums, axis=1), 1e-12)[:, None]
    finest = distances * world.scales[octaves]
    farthest = np.add.reduceat(finest, starts) / counts
    world.farthest[unique] = farthest
    world.nearest[unique] = farthest / world.scales[-1]
    world.descriptors[unique] = _medoids(looks, starts, counts)
    world.observed[unique] = np.maximum(world.observed[unique], counts)
    world.mark(points=unique)


@njit(cache=True, nogil=True)
def _drop_doubles(point_of, keyframes, last_seen_by):
    for keyframe in keyframes:
        for feature in range(point_of.shape[1]):
            point = point_of[keyframe, feature]
            if point < 0:
                continue
            if last_seen_by[point] == keyframe:
                point_of[keyframe, feature] = NONE
            last_seen_by[point] = keyframe


@njit(cache=True, nogil=True)
def _medoids(looks, starts, counts):
    """Of each group of descriptors the one that is nearest to all others of its group, (groups, 4)."""
    result = np.empty((len(starts), 4), np.uint64)
    for g in range(len(starts)):
        first, n = starts[g], min(counts[g], MEDOID_MOST)
        best, least = 0, 1 << 30
        for i in range(n):
            total = 0
            for j in range(n):
                total += hamming(looks[first + i], looks[first + j])
            if total < least:
                best, least = i, total
        for word in range(4):
            result[g, word] = looks[first + best, word]
    return result


def _doubled(column: np.ndarray) -> np.ndarray:
    return np.concatenate([column, np.zeros_like(column)])
