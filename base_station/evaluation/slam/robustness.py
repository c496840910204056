"""What a SLAM system makes of rough treatment in a room where every true pose is known.

Once round it maps; then it is covered and carried elsewhere, the light changes, it is held before a bare wall, and it
turns round on the spot. What counts is how soon it is found again, and that no pose it tells is far from the truth. The
similarity between map and truth is taken from the lap, so it does not follow a wrong pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from base_station.trackers.slam.se3 import rotation_angle_rad
from base_station.trackers.slam.sim3 import align, inverse, rotation_of, transform
from base_station.trackers.slam.system import SlamSystem
from base_station.trackers.slam.types import SlamFrame
from base_station.types import TrackingState

FRAME_S = 1 / 15
STEP_M, CREEP_M = 0.02, 0.01
"""Between two pictures of the lap, and of the rest."""
OVERLAP_M = 0.6
"""For so far the lap goes on over its beginning."""
COVERED_S, LOOKS = 2.0, 12
WALL_S = 1.0
WALL_GRAY = 150
DARK = 1 / 3
SPIN_RAD_S = math.radians(30.0)
NEAR_VIEW_RAD = math.radians(15.0)
"""A view turned no further from a mapped one is a mapped one."""
FARTHEST_M, WIDEST_RAD = 0.10, math.radians(5.0)
"""A pose that is further from the truth is wild."""


@dataclass(frozen=True, kw_only=True)
class TrueRoom:
    """`view`: the gray picture that a camera at a pose (world_from_camera 4x4, metres) takes. `way`: the pose after so
    many metres of a closed lap, moved so far to the left and turned so far to the left; heading along the lap."""

    view: Callable[[np.ndarray], np.ndarray]
    way: Callable[[float, float, float], np.ndarray]
    length_m: float


@dataclass(frozen=True, kw_only=True)
class Seen:
    """One picture: what was said of it, and how wrong (NaN where nothing was, or in another map than the lap's).
    `mapped`: whether the lap has seen this view."""

    treatment: str
    state: TrackingState
    mapped: bool
    error_m: float
    error_rad: float
    other_map: bool

    @property
    def is_wild(self) -> bool:
        return self.error_m > FARTHEST_M or self.error_rad > WIDEST_RAD


@dataclass
class Treatments:
    """Treats a system, and notes what it says. Call `lap` first."""

    room: TrueRoom
    slam: SlamSystem
    seen: list[Seen] = field(default_factory=list)
    found_after: dict[str, list[float]] = field(default_factory=dict)
    """For each treatment, in which of the pictures of a mapped view it was found again; infinity: in none."""
    _time_s: float = 0.0
    _lap: list[tuple[float, np.ndarray]] = field(default_factory=list)
    _map: int = -1

    def lap(self) -> float:
        """Once round and a little further; the error of the lap (RMSE, m)."""
        way = np.arange(0.0, self.room.length_m + OVERLAP_M, STEP_M)
        for so_far in way:
            truth = self.room.way(float(so_far), 0.0, 0.0)
            self._lap.append((self._time_s, truth))
            frame = self._show(self.room.view(truth))
            self._map = frame.component if frame.component >= 0 else self._map
        metres, _ = self._lap_errors()
        return float(np.sqrt(np.mean(metres**2)))

    def kidnap(self, place_m: float, left_m: float = 0.0, turned_rad: float = 0.0) -> None:
        """Covered, and put down elsewhere."""
        self._cover()
        self._go("kidnapped", [self.room.way(place_m + CREEP_M * k, left_m, turned_rad) for k in range(LOOKS)])

    def unseen(self, place_m: float) -> None:
        """Covered, and put down where it looks against the lap, which it has not mapped."""
        self._cover()
        poses = [self.room.way(place_m + CREEP_M * k, 0.0, math.pi) for k in range(2 * LOOKS)]
        self._go("unseen", poses, mapped=False)

    def darken(self, place_m: float) -> None:
        """The light goes to a third, and back, both at once."""
        poses = [self.room.way(place_m + CREEP_M * k, 0.0, 0.0) for k in range(45)]
        self._go("before the dark", poses[:15])
        self._go("dark", poses[15:30], light=DARK)
        self._go("light again", poses[30:])

    def before_a_wall(self, place_m: float) -> None:
        """A bare wall fills the view for a while."""
        here = self.room.way(place_m, 0.0, 0.0)
        self._go("before the wall", [here] * 3)
        bare = np.full_like(self.room.view(here), WALL_GRAY)
        for _ in range(round(WALL_S / FRAME_S)):
            self._note("bare wall", self._show(bare), None, mapped=False)
        self._go("after the wall", [self.room.way(place_m + CREEP_M * k, 0.0, 0.0) for k in range(LOOKS)])

    def spin(self, place_m: float) -> None:
        """Once round on the spot."""
        step = SPIN_RAD_S * FRAME_S
        turned = np.arange(0.0, 2 * math.pi, step)
        self._go("before the spin", [self.room.way(place_m, 0.0, 0.0)] * 3)
        away = [float(angle) for angle in turned if angle < 2 * math.pi - NEAR_VIEW_RAD]
        back = [float(angle) for angle in turned[len(away) :]]
        self._go("spinning", [self.room.way(place_m, 0.0, angle) for angle in away], mapped=False)
        poses = [self.room.way(place_m, 0.0, angle) for angle in back]
        self._go("after the spin", poses + [self.room.way(place_m + CREEP_M * k, 0.0, 0.0) for k in range(LOOKS)])

    def figures(self) -> dict[str, Any]:
        """What it all came to."""
        told = [one for one in self.seen if np.isfinite(one.error_m)]
        counts = self.slam.statistics()
        return {
            "pictures": len(self.seen),
            "found_after_frames": self.found_after,
            "found_after_frames_max": max((max(frames) for frames in self.found_after.values()), default=0),
            "told": len(told),
            "told_in_other_maps": sum(one.other_map for one in self.seen),
            "error_m_max": max((one.error_m for one in told), default=0.0),
            "error_deg_max": math.degrees(max((one.error_rad for one in told), default=0.0)),
            "wild": sum(one.is_wild for one in told),
            "maps": counts.maps,
            "loops": counts.loops,
            "merges": counts.merges,
        }

    def _cover(self) -> None:
        dark = np.zeros_like(self.room.view(self.room.way(0.0, 0.0, 0.0)))
        for _ in range(round(COVERED_S / FRAME_S)):
            self._note("covered", self._show(dark), None, mapped=False)

    def _go(self, treatment: str, poses: Sequence[np.ndarray], *, light: float = 1.0, mapped: bool = True) -> None:
        found = math.inf
        for number, pose in enumerate(poses, 1):
            frame = self._show((self.room.view(pose) * light).astype(np.uint8))
            seen = self._note(treatment, frame, pose, mapped=mapped)
            if seen.state is TrackingState.TRACKING and not seen.other_map:
                found = min(found, number)
        if mapped:
            self.found_after.setdefault(treatment, []).append(found)

    def _show(self, image: np.ndarray) -> SlamFrame:
        frame = self.slam.track(image, self._time_s)
        self._time_s += FRAME_S
        return frame

    def _note(self, treatment: str, frame: SlamFrame, truth: np.ndarray | None, *, mapped: bool) -> Seen:
        """A pose told where nothing can be seen is infinitely wrong."""
        other = frame.component not in (-1, self._map)
        metres = radians = math.nan
        if frame.cam_from_world is not None and not other:
            metres, radians = (math.inf, math.inf) if truth is None else self._error(frame.cam_from_world, truth)
        seen = Seen(
            treatment=treatment, state=frame.state, mapped=mapped, error_m=metres, error_rad=radians, other_map=other
        )
        self.seen.append(seen)
        return seen

    def _error(self, cam_from_world: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
        _, world_from_map = self._lap_errors()
        pose = world_from_map @ inverse(cam_from_world)
        turned = rotation_of(pose).T @ truth[:3, :3]
        return float(np.linalg.norm(pose[:3, 3] - truth[:3, 3])), rotation_angle_rad(turned)

    def _lap_errors(self) -> tuple[np.ndarray, np.ndarray]:
        """Metres (n,) that the poses of the lap are off, and the similarity that brings the map to the truth."""
        truth = dict(self._lap)
        both = [(pose[:3, 3], truth[time_s][:3, 3]) for time_s, pose in self.slam.trajectory() if time_s in truth]
        here, there = (np.array(side) for side in zip(*both, strict=True))
        world_from_map = align(here, there)
        return np.linalg.norm(transform(world_from_map, here) - there, axis=1), world_from_map
