"""ORB features, spread over the picture: corners of a pyramid (`corners.py`), described (`descriptors.py`).

The features are OpenCV's ORB to the bit, but for which corners are taken. Two threads share the levels: what takes time
is compiled, and lets the other one work. While the mapper has the other core the second thread may come late, or not at
all: then the first one has done its part.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

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


class _Hand:
    """What one thread needs to work on a level, pictures up to a size; its memory stays in the processor's cache."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self._find = CornerFinder(width_px, height_px)
        self._smooth = np.empty(height_px * width_px, np.uint8)

    def __call__(
        self, level: np.ndarray, quota: int, settings: FeatureSettings
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        corners = self._find(level, quota, strong=settings.threshold, weak=settings.weak_threshold)
        return describe(level, smoothed(level, self._smooth[: level.size].reshape(level.shape)), corners)


class FeatureExtractor:
    """Finds and describes features. Not for two threads at once."""

    def __init__(self, camera: SlamCamera, settings: FeatureSettings | None = None) -> None:
        self._camera = camera
        self.settings = settings or FeatureSettings()
        self._mine, self._others = (_Hand(camera.width_px, camera.height_px) for _ in range(2))
        self._other_thread = ThreadPoolExecutor(1, "slam-features")
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
    def _smaller(self) -> list[np.ndarray]:
        """Memory for each level of the pyramid but the picture itself."""
        sizes = [(round(self._camera.height_px / s), round(self._camera.width_px / s)) for s in self.scales[1:]]
        return [np.empty(size, np.uint8) for size in sizes if min(size) >= 2 * BORDER_PX + 8]

    @cached_property
    def _ratios(self) -> np.ndarray:
        """(levels, 2): a px of the picture, by one of each level as large as it has come out; across, and down."""
        width, height = self._camera.width_px, self._camera.height_px
        return np.array([(1.0, 1.0), *((width / level.shape[1], height / level.shape[0]) for level in self._smaller)])

    def __call__(self, image: np.ndarray) -> Features:
        """The features of a gray uint8 picture of the camera's size."""
        levels = [np.ascontiguousarray(image), *self._smaller]
        found = [(np.empty(0), np.empty(0), np.empty(0))] * len(levels)
        todo = deque([0])

        def work(hand: _Hand) -> None:
            while (octave := _next(todo)) is not None:
                found[octave] = hand(levels[octave], self._quotas[octave], self.settings)

        other = self._other_thread.submit(work, self._others)
        try:
            for level, smaller in pairwise(levels):
                cv2.resize(level, smaller.shape[::-1], smaller, interpolation=cv2.INTER_LINEAR)
            todo.extend(range(1, len(levels)))
            work(self._mine)
        finally:
            if not other.cancel():
                other.result()
        octaves = np.repeat(np.arange(len(levels), dtype=np.uint8), [len(xy) for xy, _, _ in found])
        xy, angles, looks = (np.concatenate(part) for part in zip(*found, strict=True))
        xy = (xy + 0.5) * self._ratios[octaves] - 0.5
        return Features(self._camera.undistort(xy), octaves, angles, looks)


def _next(todo: deque[int]) -> int | None:
    """Who is free takes the next one."""
    try:
        return todo.popleft()
    except IndexError:
        return None
