"""Coming back to where a loop was closed: recognised and measured once more, although the map knows the place by now.

After a loop is closed the camera drives in mapped space, and a next lap leaves nothing to close. That is only as good
as the map is: so each time the camera comes back to that place, its keyframe is placed anew by its looks alone, against
the points of the old keyframe, as if nothing were known of where it is. And it is placed by the other points that the
map has it see, without any that the old keyframe sees. The loop is confirmed when both poses are sure and are the same
up to a bound; by how much they differ is kept. The two have no point in common, and both are asked for before this
keyframe has moved a point: what has been adjusted to fit together would always agree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.certainty import CertaintySettings, is_certain
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.matching import match_everywhere
from base_station.trackers.slam.pose_optimization import optimize_pose
from base_station.trackers.slam.se3 import camera_centers, rotation_angle_rad, transform
from base_station.trackers.slam.three_points import pose_from_three
from base_station.trackers.slam.types import Closure


@dataclass(frozen=True, kw_only=True)
class ReturnSettings:
    """When a return confirms a loop."""

    away_below: int = 5
    """Points shared with the place, below which the camera is away from it..."""
    back_from: int = 30
    """...and from which on it is back."""
    least_pairs: int = 40
    """Features that look alike and agree on one pose."""
    pnp_error_px: float = 4.0
    farthest_of_depth: float = 0.03
    """Between both poses, as a share of the median depth; with more the map is not what the place says..."""
    widest_rad: float = math.radians(2.0)
    """...and so it is with a wider turn."""
    least_others: int = 30
    """Points that the place does not see, and that fit the other pose."""
    certainty: CertaintySettings = field(default_factory=CertaintySettings)
    """Of both poses."""


class Returns:
    """Remembers the place of the last closed loop, and whether the camera has been away since."""

    def __init__(self, camera: SlamCamera, settings: ReturnSettings) -> None:
        self._camera, self._settings = camera, settings
        self._place, self._away = NONE, False

    def closed(self, place: int) -> None:
        """A loop has just been closed at this keyframe."""
        self._place, self._away = place, False

    def place(self, world: Map) -> int:
        """The keyframe at the closed loop's place, as it is now."""
        return world.living(self._place)

    def look(self, world: Map, keyframe: int) -> Closure | None:
        """What a new keyframe confirms; None where it is not a return, or does not. To be asked before the keyframe
        changes the map."""
        if self._place == NONE:
            return None
        place = self.place(world)
        if not world.alive[place] or world.component[place] != world.component[keyframe]:
            return None
        shared = int(world.shared[keyframe, place])
        self._away |= shared < self._settings.away_below
        if not self._away or shared < self._settings.back_from:
            return None
        measured = confirm(world, keyframe, place, self._camera, self._settings)
        if measured is not None:
            self._away = False
        return measured


def confirm(
    world: Map, keyframe: int, place: int, camera: SlamCamera, settings: ReturnSettings
) -> Closure | None:  # fmt: skip
    """The keyframe's pose by its looks alone, against what the place sees; None when the rest of the map says
    otherwise, or does not say enough."""
    mine, theirs = world.features[keyframe], world.features[place]
    points = world.point_of[place, : len(theirs)]
    shown = np.flatnonzero(points >= 0)
    matches = match_everywhere(theirs.descriptors[shown], theirs.angle_deg[shown], mine, ratio=0.85)
    index = np.flatnonzero(matches >= 0)
    if len(index) < settings.least_pairs:
        return None
    xyz, rows = world.xyz[points[shown[index]]], matches[index]
    found = pose_from_three(xyz, mine.xy_px[rows], camera, error_px=settings.pnp_error_px, tries=200, confidence=0.999)
    if found is None:
        return None
    pose = _sure_pose(world, found[0], xyz, mine, rows, settings.least_pairs, camera, settings)
    seen = world.point_of[keyframe, : len(mine)]
    others = np.flatnonzero((seen >= 0) & ~np.isin(seen, points) & ~np.isin(np.arange(len(mine)), rows))
    mapped = _sure_pose(
        world, world.poses[keyframe], world.xyz[seen[others]], mine, others, settings.least_others, camera, settings
    )
    if pose is None or mapped is None:
        return None
    depth = float(np.median(transform(mapped, xyz)[:, 2]))
    moved = float(np.linalg.norm(camera_centers(pose) - camera_centers(mapped))) / depth
    turned_rad = rotation_angle_rad(pose[:3, :3] @ mapped[:3, :3].T)
    if moved > settings.farthest_of_depth or turned_rad > settings.widest_rad:
        return None
    return Closure(
        kind="confirmed", time_s=float(world.time_s[keyframe]), moved_of_depth=moved, turned_rad=turned_rad, scale=1.0
    )


def _sure_pose(
    world: Map, guess: np.ndarray, xyz: np.ndarray, features: Features, rows: np.ndarray, least: int,
    camera: SlamCamera, settings: ReturnSettings,
) -> np.ndarray | None:  # fmt: skip
    """cam_from_world by points (n, 3) that these features (rows, (n,)) show; None by too few, or an unsure one."""
    if len(rows) < least:
        return None
    seen, scales = features.xy_px[rows].astype(np.float64), world.scales[features.octave[rows]]
    fit = optimize_pose(guess, xyz, seen, scales, camera.intrinsics)
    fitting = fit.inliers
    sure = fitting.sum() >= least and is_certain(
        fit.cam_from_world, xyz[fitting], seen[fitting], scales[fitting], camera.intrinsics, settings.certainty
    )
    return fit.cam_from_world if sure else None
