"""A map to be kept: what is alive of an atlas, numbered anew, in arrays that a file can hold (`map_file.py`).

Left behind is what only the running system needs: culled rows, who was replaced by whom, the loops closed so far (the
points that both ends share keep them together), and how often a young point was found. Who shares points with whom,
and each keyframe's visual words for place recognition, are computed anew: then they cannot contradict the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from base_station.errors import StationError
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features, FeatureSettings
from base_station.trackers.slam.lens import Lens
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.relocalization import Places
from base_station.trackers.slam.vocabulary import Vocabulary

SAME_PX = 1e-3
"""Cameras whose directions differ by less are the same one."""
MOST_OFF = 0.02
"""Of the picture's width, by which directions may differ: a camera calibrated anew, not another camera."""
GRID = 7


@dataclass(frozen=True)
class SavedMap:
    """K keyframes with N features in all, and P points; `component` from 0 on, without gaps.

    `source`: where it is from, for messages. `lens`: see `Map.lens`. `scales` (levels,): see `Map.scales`. `columns`,
    as in `Map`: of keyframes poses (K, 4, 4), sizes, time_s, component, feature_counts (K,); of features, keyframe by
    keyframe, xy_px (N, 2), octave, angle_deg (N,), looks (N, 4) uint64, point_of (N,), -1 or a point of the same
    component, no point twice in a keyframe; of points xyz, normals (P, 3), descriptors (P, 4), nearest, farthest,
    point_component (P,).
    """

    camera: SlamCamera
    lens: tuple[float, float]
    scales: np.ndarray
    columns: dict[str, np.ndarray]
    source: str = "this run"

    @classmethod
    def of(cls, world: Map, camera: SlamCamera, least_keyframes: int) -> SavedMap | None:
        """What is worth keeping: the maps of at least so many keyframes. None when there is none."""
        rows = np.array([row for row in world.keyframes_alive() if int(row) in world.features], np.int64)
        numbers, sizes = np.unique(world.component[rows], return_counts=True)
        numbers = numbers[sizes >= least_keyframes]
        rows = rows[np.isin(world.component[rows], numbers)]
        if not len(rows):
            return None
        features = [world.features[int(row)] for row in rows]
        counts = np.array([len(one) for one in features], np.int32)
        seen = np.concatenate([world.point_of[row, :n] for row, n in zip(rows, counts, strict=True)])
        seen, points = _renumbered(world, seen, np.repeat(rows, counts))
        return cls(camera, world.lens, world.scales.copy(), {
            "poses": world.poses[rows], "sizes": world.sizes[rows], "time_s": world.time_s[rows],
            "component": np.searchsorted(numbers, world.component[rows]).astype(np.int32), "feature_counts": counts,
            "xy_px": np.concatenate([one.xy_px for one in features]).astype(np.float32),
            "octave": np.concatenate([one.octave for one in features]).astype(np.uint8),
            "angle_deg": np.concatenate([one.angle_deg for one in features]).astype(np.float32),
            "looks": np.concatenate([one.descriptors for one in features]).astype(np.uint64),
            "point_of": seen, "xyz": world.xyz[points], "normals": world.normals[points],
            "descriptors": world.descriptors[points], "nearest": world.nearest[points],
            "farthest": world.farthest[points],
            "point_component": np.searchsorted(numbers, world.point_component[points]).astype(np.int32),
        })  # fmt: skip

    @property
    def told(self) -> str:
        """In words, for a line of text."""
        return f"{len(self.columns['poses'])} keyframes, {len(self.columns['xyz'])} points"

    @cached_property
    def keyframe_of(self) -> np.ndarray:
        """(N,): whose each feature is."""
        counts = self.columns["feature_counts"]
        return np.repeat(np.arange(len(counts)), counts)

    @cached_property
    def features(self) -> list[Features]:
        """Of each keyframe."""
        ends = np.cumsum(self.columns["feature_counts"])[:-1]
        parts = (np.split(self.columns[name], ends) for name in ("xy_px", "octave", "angle_deg", "looks"))
        return [Features(*one) for one in zip(*parts, strict=True)]

    @cached_property
    def words(self) -> list[np.ndarray]:
        """Of each keyframe, the visual word of each feature (n,). Takes a moment the first time."""
        vocabulary = Vocabulary.load()
        return [vocabulary.bow(one.descriptor_bytes)[0] for one in self.features]

    # --- taken up again ---------------------------------------------------------------------------------------------

    def ready_for(self, camera: SlamCamera, settings: FeatureSettings) -> SavedMap:
        """The map as this camera sees it. Raises StationError for a camera, or features, of another kind.

        Another calibration of the same camera moves the keypoints, and leaves out what the map had found of the lens:
        what the pictures showed stays the same.
        """
        scales = settings.scale_factor ** np.arange(settings.levels)
        most = int(self.columns["feature_counts"].max(initial=0))
        if len(scales) != len(self.scales) or not np.allclose(scales, self.scales, rtol=1e-9) or most > settings.count:
            raise StationError(
                f"The map of {self.source} is of other features (up to {most} a picture, on {len(self.scales)} levels;"
                f" here {settings.count} on {len(scales)}): map anew, into another file.",
                usage=True,
            )
        before = self.camera
        if (camera.width_px, camera.height_px) != (before.width_px, before.height_px):
            raise StationError(
                f"The map of {self.source} is of pictures of {before.width_px}x{before.height_px} px, and the camera's"
                f" have {camera.width_px}x{camera.height_px}: take that size again, or give --map another file.",
                usage=True,
            )
        off_px = _directions_off_px(before, camera)
        if off_px > MOST_OFF * camera.width_px:
            raise StationError(
                f"The map of {self.source} is of another camera (focal length {before.fx:.0f} px, now {camera.fx:.0f};"
                f" directions differ by up to {off_px:.0f} px): take that calibration, or give --map another file.",
                usage=True,
            )
        if off_px <= SAME_PX:
            return self
        xy_px = Lens(*self.lens).seen(self.columns["xy_px"].astype(np.float64), before)
        xy_px = camera.undistort(before.distort(xy_px)).astype(np.float32)
        return replace(self, camera=camera, lens=(1.0, 0.0), columns=self.columns | {"xy_px": xy_px})

    def fill(self, world: Map, places: Places) -> None:
        """Into a Map that is empty, with room for as many features a picture, and the places to recognise in it."""
        mine = self.columns
        ends = np.cumsum(mine["feature_counts"])[:-1]
        for row, (features, seen) in enumerate(zip(self.features, np.split(mine["point_of"], ends), strict=True)):
            component = int(mine["component"][row])
            world.add_keyframe(row, float(mine["time_s"][row]), mine["poses"][row], features, seen, component)
        count = len(mine["poses"])
        world.sizes[:count] = mine["sizes"]
        rows = world.add_points(mine["xyz"], mine["descriptors"], 0)
        for name in ("normals", "nearest", "farthest", "point_component"):
            getattr(world, name)[rows] = mine[name]
        seen = mine["point_of"]
        world.born[rows] = count
        np.minimum.at(world.born, seen[seen >= 0], self.keyframe_of[seen >= 0])
        world.recount(np.arange(count))
        world.count_observed(rows)
        world.lens = self.lens
        world.take_changes()  # whoever has a copy fills it from here, too
        for row, words in enumerate(self.words):
            places.add(row, words)


def _renumbered(world: Map, seen: np.ndarray, keyframes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which point each feature shows, (N,) int32, among the rows of points (P,) that are shown at all."""
    kept = (seen >= 0) & world.point_alive[seen]
    kept &= world.point_component[seen] == world.component[keyframes]
    once = np.zeros(len(seen), np.bool_)
    rows = np.flatnonzero(kept)
    pairs = keyframes[rows].astype(np.int64) * (world.point_count + 1) + seen[rows]
    once[rows[np.unique(pairs, return_index=True)[1]]] = True
    points, numbers = np.unique(seen[once], return_inverse=True)
    renumbered = np.full(len(seen), NONE, np.int32)
    renumbered[once] = numbers
    return renumbered, points


def _directions_off_px(one: SlamCamera, two: SlamCamera) -> float:
    """By how much, at the most, two cameras disagree where a pixel looks, in px of the second."""
    across, down = np.meshgrid(np.linspace(0, one.width_px - 1, GRID), np.linspace(0, one.height_px - 1, GRID))
    places = np.stack([across.ravel(), down.ravel()], axis=1)
    rays = [(c.undistort(places) - c.intrinsics[2:]) / c.intrinsics[:2] for c in (one, two)]
    return float(np.linalg.norm((rays[0] - rays[1]) * two.intrinsics[:2], axis=1).max())
