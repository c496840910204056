"""One point for one thing: neighbouring keyframes may have made a point each, or see one without knowing.

The points of one keyframe are projected into another. Where the keypoint found there shows nothing yet, it now shows
the point; where it shows another point, the two become one: the one that more keyframes see stays.
"""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import NONE, Map
from base_station.trackers.slam.matching import NEAR, Grid, match_projections
from base_station.trackers.slam.pose_optimization import CHI2_TWO
from base_station.trackers.slam.visibility import expect

RADIUS = 3.0
"""Px of the level, around a projection."""


def fuse_neighbourhood(world: Map, keyframe: int, camera: SlamCamera, *, neighbours: int = 12, second: int = 4) -> None:
    """Fuse this keyframe's points into its neighbours and theirs, and theirs into it."""
    targets = dict.fromkeys(int(k) for k in world.neighbours(keyframe, neighbours))
    for near in list(targets):
        targets.update(dict.fromkeys(int(k) for k in world.neighbours(near, second) if k != keyframe))
    mine = world.points_of(np.array([keyframe]))
    for target in targets:
        fuse(world, mine[world.point_alive[mine]], target, camera)
    fuse(world, world.points_of(np.array(list(targets), np.int64)), keyframe, camera)


def fuse(world: Map, points: np.ndarray, keyframe: int, camera: SlamCamera, *, pose: np.ndarray | None = None) -> int:
    """Let a keyframe see these points where it can; how many it newly sees or were made one with another.

    `pose`: where the keyframe is taken to stand (cam_from_world), if not where the map has it.
    """
    features = world.features[keyframe]
    seen = world.point_of[keyframe, : len(features)]
    points = points[~np.isin(points, seen)]
    if not len(points) or not len(features):
        return 0
    expected = expect(world, points, world.poses[keyframe] if pose is None else pose, camera)
    matches = match_projections(
        expected.uv_px, RADIUS * world.scales[expected.octave], expected.octave_range,
        world.descriptors[expected.rows], features, Grid.of(features.xy_px, camera.bounds_px), most=NEAR, ratio=1.0,
    )  # fmt: skip
    index = np.flatnonzero(matches >= 0)
    found = matches[index]
    error2 = np.sum((features.xy_px[found] - expected.uv_px[index]) ** 2, axis=1)
    close = error2 < CHI2_TWO * world.scales[features.octave[found]] ** 2
    rows, found = expected.rows[index[close]].astype(np.int32), found[close]
    there = seen[found]
    free = there == NONE
    world.point_of[keyframe, found[free]] = rows[free]
    world.mark(keyframes=keyframe)
    both = np.stack([rows[~free], there[~free]])
    if both.size:
        keep_there = world.observed[both[1]] >= world.observed[both[0]]
        gone, kept = np.where(keep_there, both[0], both[1]), np.where(keep_there, both[1], both[0])
        single = ~np.isin(gone, kept)  # a chain of replacements waits for the next time
        world.replace_points(gone[single], kept[single])
    return len(rows)
