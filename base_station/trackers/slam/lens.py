"""What a whole map has found of the lens, beyond its calibration: a longer focal length, a little radial distortion.

The map keeps the camera that it began with. What is found only says where that camera's ideal picture shows a keypoint:
keypoints are moved (`Lens.ideal`), and all else goes on as before. `lens_calibration` finds it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.map import Map

NEWTON_STEPS = 6
LEAST_SLOPE = 0.1
"""Of the distance from the middle, seen by ideal: below, the picture is about to be folded over."""


@dataclass(frozen=True)
class Lens:
    """`zoom`: how many times the camera's focal length; `radial`: k1, on top of its distortion."""

    zoom: float = 1.0
    radial: float = 0.0

    def ideal(self, xy_px: np.ndarray, camera: SlamCamera) -> np.ndarray:
        """Where `camera`'s ideal picture would show what it shows, by its own calibration, at these points (n, 2)."""
        seen = (xy_px - camera.intrinsics[2:]) / camera.intrinsics[:2] / self.zoom
        far = np.linalg.norm(seen, axis=1)
        r = far.copy()
        for _ in range(NEWTON_STEPS):
            slope = np.maximum(1.0 + 3.0 * self.radial * r**2, LEAST_SLOPE)
            r -= (r * (1.0 + self.radial * r**2) - far) / slope
        ideal = seen * (r / np.maximum(far, 1e-12))[:, None]
        return np.asarray(ideal * camera.intrinsics[:2] + camera.intrinsics[2:])

    def seen(self, ideal_px: np.ndarray, camera: SlamCamera) -> np.ndarray:
        """The way back, (n, 2)."""
        ideal = (ideal_px - camera.intrinsics[2:]) / camera.intrinsics[:2]
        grown = self.zoom * (1.0 + self.radial * np.sum(ideal**2, axis=1, keepdims=True))
        return np.asarray(ideal * grown * camera.intrinsics[:2] + camera.intrinsics[2:])

    def px_per_ideal_px(self, ideal_px: np.ndarray, camera: SlamCamera) -> np.ndarray:
        """How many px of the picture are one of the ideal picture's there, (n,): a mean over all directions."""
        r2 = np.sum(((ideal_px - camera.intrinsics[2:]) / camera.intrinsics[:2]) ** 2, axis=1)
        grown = np.maximum((1.0 + self.radial * r2) * (1.0 + 3.0 * self.radial * r2), LEAST_SLOPE**2)
        return np.asarray(self.zoom * np.sqrt(grown))

    def of(self, camera: SlamCamera) -> SlamCamera:
        """The camera with this lens; where it had a distortion, the two are put together up to the sixth power."""
        if self == Lens():
            return camera
        z, k = self.zoom, self.radial
        k1, k2, p1, p2, k3 = (*camera.distortion, *(0.0,) * 5)[:5]
        sixth = k3 * z**6 + 5.0 * k * k2 * z**4 + 3.0 * k**2 * k1 * z**2
        both = (k1 * z**2 + k, k2 * z**4 + 3.0 * k * k1 * z**2, p1 * z, p2 * z)
        return replace(
            camera,
            fx=camera.fx * z,
            fy=camera.fy * z,
            distortion=(*both, sixth) if sixth else both if any(both) else (),
        )


def through(features: Features, before: Lens, lens: Lens, camera: SlamCamera) -> Features:
    """Features whose places `before` gave, as `lens` gives them."""
    if lens == before:
        return features
    places = lens.ideal(before.seen(features.xy_px.astype(np.float64), camera), camera)
    return replace(features, xy_px=places.astype(np.float32))


def look_through(world: Map, lens: Lens, camera: SlamCamera) -> None:
    """Let all keypoints of the map be where this lens has them."""
    before = Lens(*world.lens)
    if lens == before:
        return
    for row, features in world.features.items():
        world.features[row] = through(features, before, lens, camera)
    world.lens = lens.zoom, lens.radial
