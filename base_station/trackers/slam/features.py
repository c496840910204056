"""ORB features, spread over the picture: corners of a pyramid (`corners.py`), described (`descriptors.py`).

The features are OpenCV's ORB to the bit, but for which corners are taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.corners import BORDER_PX, CornerFinder
from base_station.trackers.slam.descriptors import describe, smoothed


@dataclass(frozen=True, kw_only=True)
class FeatureSettings:
    """How many features, from which scales."""

    count: int = 1000
    """Features per picture at the most."""
    levels: int = 8
    """Of the pyramid."""
    scale_factor: float = 1.2
    """From one level to the next."""
    threshold: int = 20
    """Grey levels by which a corner's ring differs from its middle."""
    weak_threshold: int = 7
    """The same where there are too few strong corners."""


@dataclass(frozen=True)
class Features:
    """What is kept of a picture, n features.

    `xy_px` (n, 2) float32, undistorted; `octave` (n,) uint8, the pyramid level; `angle_deg` (n,) float32, 0..360;
    `descriptors` (n, 4) uint64.
    """

    xy_px: np.ndarray
    octave: np.ndarray
    angle_deg: np.ndarray
    descriptors: np.ndarray

    def __len__(self) -> int:
        return len(self.xy_px)

    def part(self, rows: np.ndarray) -> Features:
        """These features only."""
        return Features(self.xy_px[rows], self.octave[rows], self.angle_deg[rows], self.descriptors[rows])

    @property
    def descriptor_bytes(self) -> np.ndarray:
        """(n, 32) uint8, OpenCV's layout."""
        return self.descriptors.view(np.uint8).reshape(len(self), 32)


class FeatureExtractor:
    """Finds and describes features. Not for two threads at once."""

    def __init__(self, camera: SlamCamera, settings: FeatureSettings | None = None) -> None:
        self._camera = camera
        self.settings = settings or FeatureSettings()
        self._find = CornerFinder(camera.width_px, camera.height_px)
        cv2.setNumThreads(1)  # the mapper has the other core; a pool of threads waits longer than it helps

    @cached_property
    def scales(self) -> np.ndarray:
        """(levels,) float64: how many picture px one px of each level is."""
        return self.settings.scale_factor ** np.arange(self.settings.levels)

    @cached_property
    def _quotas(self) -> list[int]:
        shares = 1.0 / self.scales
        edges = np.round(np.cumsum(shares / shares.sum()) * self.settings.count).astype(int)
        return [int(n) for n in np.diff(edges, prepend=0)]

    @cached_property
    def _levels(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Memory for each level of the pyramid, and for it smoothed. It is used again by the next level but one, and by
        the next: so it stays in the processor's cache."""
        sizes = [(round(self._camera.height_px / s), round(self._camera.width_px / s)) for s in self.scales]
        sizes = [size for size in sizes if min(size) >= 2 * BORDER_PX + 8]
        even, odd, smooth = (np.empty(self._camera.height_px * self._camera.width_px, np.uint8) for _ in range(3))
        return [
            ((odd if octave % 2 else even)[: h * w].reshape(h, w), smooth[: h * w].reshape(h, w))
            for octave, (h, w) in enumerate(sizes)
        ]

    @cached_property
    def _ratios(self) -> np.ndarray:
        """(levels, 2): a px of the picture, by one of each level as large as it has come out; across, and down."""
        height, width = self._levels[0][0].shape
        return np.array([(width / level.shape[1], height / level.shape[0]) for level, _ in self._levels])

    def __call__(self, image: np.ndarray) -> Features:
        """The features of a gray uint8 picture of the camera's size."""
        settings, found = self.settings, []
        level = np.ascontiguousarray(image)
        for octave, ((smaller, smooth), quota) in enumerate(zip(self._levels, self._quotas, strict=False)):
            if octave:
                level = cv2.resize(level, smaller.shape[::-1], smaller, interpolation=cv2.INTER_LINEAR)
            corners = self._find(level, quota, strong=settings.threshold, weak=settings.weak_threshold)
            xy, angles, looks = describe(level, smoothed(level, smooth), corners)
            found.append((xy, np.full(len(xy), octave, np.uint8), angles, looks))
        xy, octaves, angles, looks = (np.concatenate(part) for part in zip(*found, strict=True))
        xy = (xy + 0.5) * self._ratios[octaves] - 0.5
        return Features(self._camera.undistort(xy), octaves, angles, looks)
