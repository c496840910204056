"""The whole of one map adjusted at once: when nothing is left to do, so that all poses are as good as they can be.

Local BA holds what lies beyond a keyframe's neighbours, and its errors stay where they were first made. Up to some
hundred keyframes the compiled solver is the quickest, although its matrix is dense; beyond, pycolmap's is.
"""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam.bundle_adjustment import bundle_adjust
from base_station.trackers.slam.bundle_kernels import adjust_small
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.lens import look_through
from base_station.trackers.slam.lens_calibration import calibrated
from base_station.trackers.slam.local_bundle import BundleSettings, adjust
from base_station.trackers.slam.map import Map, refresh_points

FEWEST = 3
"""Keyframes of a map that is worth it."""
LARGEST_DENSE, LARGEST = 300, 1500
"""Keyframes up to which the compiled solver is taken, and beyond which it would take too long."""
ROUNDS = 2
"""What did not fit after the first is gone in the second."""


def adjust_whole(world: Map, component: int, camera: SlamCamera, settings: BundleSettings) -> bool:
    """Adjust all keyframes and points of this map but its first keyframe; whether it was of a size to do so.

    What the map says of the lens is believed first (`lens_calibration`); the other maps are adjusted to it then, too.
    """
    if not _fit(world, component):
        return False
    lens = calibrated(world, component, camera)
    if lens is not None:
        look_through(world, lens, camera)
        for other in np.unique(world.component[world.keyframes_alive()]):
            if other != component and _fit(world, int(other)):
                _adjust(world, int(other), camera, settings)
    _adjust(world, component, camera, settings)
    return True


def _fit(world: Map, component: int) -> bool:
    return FEWEST <= len(world.keyframes_alive(component)) <= LARGEST


def _adjust(world: Map, component: int, camera: SlamCamera, settings: BundleSettings) -> None:
    keyframes = world.keyframes_alive(component)
    dense = len(keyframes) <= LARGEST_DENSE
    for _ in range(ROUNDS if dense else 1):
        adjust(
            world, keyframes[1:], keyframes[:1], world.points_alive(component), camera,
            iterations=settings.global_iterations, solver=adjust_small if dense else bundle_adjust,
        )  # fmt: skip
    world.recount(keyframes)
    points = world.points_alive(component)
    world.count_observed(points)
    refresh_points(world, points, keyframes)
