"""The learned picture's place in the map, from the first guess to a keyframe of its own.

As soon as the map shows enough of what was learned, it is placed there; where that is sure twice in a row, it becomes a
keyframe, and from then on it moves with the map. A map that grows may come to know better: then it becomes one anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.map import NONE
from base_station.trackers.slam.system import SlamSystem
from base_station.trackers.slam.target import MapTarget, Placed, place_in_map, target_of
from base_station.trackers.slam.twins import TwinSettings, differ

EVERY = 5
"""Frames between two attempts."""
CHECK_EVERY, MOST_CHECKS = 15, 20
"""Frames between two looks, and how many there are, whether the map knows better than the keyframe by now: each takes
as long as a picture."""


TWINS = TwinSettings()


class Placement:
    """Of one learned picture. `features` (n), of which `in_box` (n,) bool are the target's; `center_px`: its middle in
    the picture as it was taken, at `time_s`."""

    def __init__(
        self, features: Features, in_box: np.ndarray, center_px: tuple[float, float], time_s: float, camera: SlamCamera
    ) -> None:
        self._features, self._in_box, self._center_px = features, in_box, center_px
        self._time_s, self._camera = time_s, camera
        self._row = NONE
        """The keyframe that it has become."""
        self._last: Placed | None = None
        self._checks, self._frames = 0, -1  # the first picture is looked at
        self.target: MapTarget | None = None
        """None: not in the map in use."""

    @property
    def features(self) -> Features:
        """Of the learned picture."""
        return self._features

    @property
    def of_target(self) -> Features:
        """Those of them that are the target's."""
        return self._features.part(np.flatnonzero(self._in_box))

    @property
    def is_keyframe(self) -> bool:
        """Whether its place was sure enough for it."""
        return self._row != NONE

    def look_through(self, features: Features) -> None:
        """The features as the map now knows the lens."""
        self._features, self.target = features, None  # the target's middle was the old lens's
        self._frames = -1

    def update(self, slam: SlamSystem, cam_from_world: np.ndarray | None) -> None:
        """After each picture that `slam` has tracked; the pose is that picture's, if it has one."""
        self._frames += 1
        if cam_from_world is None:
            return
        self._leave_other_map(slam)
        if self._frames % EVERY:
            return
        if not self.is_keyframe:
            placed = self._place(slam, cam_from_world)
            self._take(slam, placed)
        elif self._has_arrived(slam):
            world = slam.map
            seen = world.current(world.point_of[self._row, : len(self._features)])
            self.target = self._target_at(slam, self._row, Placed(world.poses[self._row], seen)) or self.target
            self._check(slam, cam_from_world)

    def _leave_other_map(self, slam: SlamSystem) -> None:
        """A pose in one map says nothing of a target in another: the target must be placed anew."""
        if self.target is None:
            return
        keyframe = slam.map.living(self.target.keyframe)
        if not slam.map.alive[keyframe] or slam.map.component[keyframe] != slam.component:
            self.target, self._row, self._last = None, NONE, None

    def _has_arrived(self, slam: SlamSystem) -> bool:
        """As a keyframe, in the tracker's copy of the map."""
        world, row = slam.map, self._row
        return row < world.keyframe_count and bool(world.alive[row]) and int(world.component[row]) == slam.component

    def _check(self, slam: SlamSystem, cam_from_world: np.ndarray) -> None:
        if self._checks >= MOST_CHECKS or self._frames % CHECK_EVERY:
            return
        self._checks += 1
        placed = self._place(slam, cam_from_world)
        if placed is not None and placed.sure and differ(placed.cam_from_world, slam.map.poses[self._row], TWINS):
            self._take(slam, placed)

    def _place(self, slam: SlamSystem, cam_from_world: np.ndarray) -> Placed | None:
        """Sure when it was surely there at the last attempt, too."""
        before, self._last = self._last, None
        picture = slam.last_picture
        if picture is None:
            return None
        placed = place_in_map(
            slam.map, self._features, self._in_box, picture, cam_from_world, self._camera, TWINS, without=self._row
        )
        self._last = placed
        if placed is None:
            return None
        if before is None or not before.sure or differ(before.cam_from_world, placed.cam_from_world, TWINS):
            return replace(placed, sure=False)
        return placed

    def _take(self, slam: SlamSystem, placed: Placed | None) -> None:
        if placed is None:
            return
        self.target = self._target_at(slam, slam.reference, placed) or self.target
        if self.target is not None and placed.sure:
            self._row = slam.insert(self._time_s, self._features, placed.point_of, placed.cam_from_world)

    def _target_at(self, slam: SlamSystem, keyframe: int, placed: Placed) -> MapTarget | None:
        return target_of(slam.map, keyframe, placed, self._features, self._in_box, self._center_px, self._camera)
