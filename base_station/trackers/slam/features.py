"""ORB features, spread over the picture: corners on a pyramid, a share of them in every cell, described by OpenCV.

OpenCV's own ORB keeps the strongest corners, and they crowd on a few textured things; a pose held by one corner of the
picture is a poor pose. Here every level is divided into cells, and the picking goes round the cells: first the best
corner of each, then the second best, until the level's quota is full. Where strong corners are missing, a block of the
level is searched again for weak ones (Mur-Artal et al., "ORB-SLAM", 2015, section IV-B names both ideas).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numba import njit

from base_station.trackers.slam.camera import SlamCamera

BORDER_PX = 19
"""A descriptor reads its corner's surroundings so far."""
PATCH_RADIUS_PX = 15
CORNER_RADIUS_PX = 4
BLOCK_PX = 160


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
        self._strong = cv2.FastFeatureDetector_create(self.settings.threshold)  # type: ignore[attr-defined]
        self._weak = cv2.FastFeatureDetector_create(self.settings.weak_threshold)  # type: ignore[attr-defined]
        self._describer = cv2.ORB_create(  # type: ignore[attr-defined]
            100_000, nlevels=1, edgeThreshold=BORDER_PX, fastThreshold=self.settings.weak_threshold
        )
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

    def __call__(self, image: np.ndarray) -> Features:
        """The features of a gray uint8 picture of the camera's size."""
        level, found = image, []
        for octave, (scale, quota) in enumerate(zip(self.scales, self._quotas, strict=True)):
            if octave:
                size = (round(image.shape[1] / scale), round(image.shape[0] / scale))
                if min(size) < 2 * BORDER_PX + 8:
                    break
                level = cv2.resize(level, size, interpolation=cv2.INTER_LINEAR)
            xy, angles, descriptors = self._of_level(level, quota)
            ratio = np.array([image.shape[1] / level.shape[1], image.shape[0] / level.shape[0]])
            found.append(((xy + 0.5) * ratio - 0.5, np.full(len(xy), octave, np.uint8), angles, descriptors))
        xy, octaves, angles, descriptors = (np.concatenate(part) for part in zip(*found, strict=True))
        words = np.ascontiguousarray(descriptors).view(np.uint64).reshape(-1, 4)
        return Features(self._camera.undistort(xy), octaves, angles, words)

    def _of_level(self, level: np.ndarray, quota: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        xy, scores = self._corners(level, quota)
        height, width = level.shape
        inner_px = (width - 2 * BORDER_PX) * (height - 2 * BORDER_PX)
        cell_px = max(8.0, (inner_px / max(quota, 1)) ** 0.5)
        picked = spread(xy, scores, cell_px, width, height, quota)
        xy = xy[picked]
        angles = orientations(level, xy)
        points = [
            cv2.KeyPoint(x, y, 2.0 * PATCH_RADIUS_PX + 1, angle, 0.0, 0)
            for (x, y), angle in zip(xy.tolist(), angles.tolist(), strict=True)
        ]
        kept, descriptors = self._describer.compute(level, points)
        if descriptors is None or len(kept) != len(xy):  # OpenCV keeps all of them: they respect its border
            return np.empty((0, 2), np.float32), np.empty(0, np.float32), np.empty((0, 32), np.uint8)
        return refined(level, xy), angles, descriptors

    def _corners(self, level: np.ndarray, quota: int) -> tuple[np.ndarray, np.ndarray]:
        """Corners (n, 2) float32 px of the level and their scores (n,): strong ones, and weak ones in poor blocks."""
        height, width = level.shape
        xy, scores = _detect(self._strong, level, 0, 0)
        columns, rows = max(1, round(width / BLOCK_PX)), max(1, round(height / BLOCK_PX))
        block, poor = _poor_blocks(xy, width / columns, height / rows, columns, rows, 1.5 * quota / (columns * rows))
        if not poor.any():
            return xy, scores
        rich = ~poor[block]
        found = [(xy[rich], scores[rich])]
        for index in np.flatnonzero(poor):
            left, top = index % columns * width // columns, index // columns * height // rows
            right, bottom = (index % columns + 1) * width // columns, (index // columns + 1) * height // rows
            x, y = max(left - 3, 0), max(top - 3, 0)
            found.append(_detect(self._weak, level[y : bottom + 3, x : right + 3], x, y))
        return np.concatenate([part[0] for part in found]), np.concatenate([part[1] for part in found])


@njit(cache=True, nogil=True)
def _poor_blocks(xy, wide, high, columns, rows, least):
    """In which block each corner (n, 2) lies, and which blocks have too few of them, bool."""
    block = np.empty(len(xy), np.int64)
    counts = np.zeros(columns * rows, np.int64)
    for i in range(len(xy)):
        block[i] = min(int(xy[i, 0] / wide), columns - 1) + columns * min(int(xy[i, 1] / high), rows - 1)
        counts[block[i]] += 1
    return block, counts < least


def _detect(detector: cv2.FastFeatureDetector, image: np.ndarray, x: int, y: int) -> tuple[np.ndarray, np.ndarray]:
    points = detector.detect(image)
    if not points:
        return np.empty((0, 2), np.float32), np.empty(0, np.float32)
    xy = cv2.KeyPoint_convert(points) + np.array([x, y], np.float32)  # type: ignore[attr-defined]
    return xy, np.array([point.response for point in points], np.float32)


def spread(xy: np.ndarray, scores: np.ndarray, cell_px: float, width: int, height: int, count: int) -> np.ndarray:
    """Indices of `count` corners at the most, taken in turns from square cells, the best of each cell first.

    `xy` (n, 2) px, `scores` (n,): whole numbers 0..255, as FAST gives them. Not those near the border.
    """
    return _spread(xy, scores, cell_px, width, height, count)


@njit(cache=True, nogil=True)
def _spread(xy, scores, cell_px, width, height, count):
    columns = int(width / cell_px) + 1
    cells = np.full(len(xy), -1, np.int32)
    by_score = np.zeros(257, np.int32)
    for i in range(len(xy)):
        x, y = xy[i, 0], xy[i, 1]
        if x >= BORDER_PX and y >= BORDER_PX and x < width - BORDER_PX and y < height - BORDER_PX:
            cells[i] = int(x / cell_px) + columns * int(y / cell_px)
            by_score[256 - min(max(int(scores[i]), 0), 255)] += 1
    for s in range(1, 257):
        by_score[s] += by_score[s - 1]
    order = np.empty(by_score[256], np.int32)
    for i in range(len(xy)):
        if cells[i] >= 0:
            s = 255 - min(max(int(scores[i]), 0), 255)
            order[by_score[s]] = i
            by_score[s] += 1
    seen = np.zeros(columns * (int(height / cell_px) + 1), np.int32)
    turns = np.empty(len(order), np.int32)
    most = 0
    for n in range(len(order)):
        cell = cells[order[n]]
        turns[n] = seen[cell]
        seen[cell] += 1
        most = max(most, seen[cell])
    picked = np.empty(min(count, len(order)), np.int64)
    n = 0
    for turn in range(most):
        for k in range(len(order)):
            if turns[k] == turn:
                if n == len(picked):
                    return picked
                picked[n] = order[k]
                n += 1
    return picked


_ROUND = [round((PATCH_RADIUS_PX**2 - v * v) ** 0.5) for v in range(PATCH_RADIUS_PX + 1)]
_HALF_WIDTHS = np.array(
    [max(u for u in range(PATCH_RADIUS_PX + 1) if _ROUND[v] >= u or _ROUND[u] >= v) for v in range(16)]
)
"""Of the disc's rows; the same across as along, or the angle would depend on how the camera is turned."""


def refined(image: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Corners (n, 2) to a fraction of a px: where the edges around them meet, float32.

    The point from which all gradients nearby point across, in the least squares sense (Foerstner and Guelch 1987); a
    corner that would move by more than a px stays.
    """
    return _refined(image, xy, _CORNER_WEIGHTS)


_ALONG = np.exp(-((np.arange(-CORNER_RADIUS_PX, CORNER_RADIUS_PX + 1) / CORNER_RADIUS_PX) ** 2))
_CORNER_WEIGHTS = np.outer(_ALONG, _ALONG)


@njit(cache=True, nogil=True)
def _refined(image, xy, weights):
    radius = weights.shape[0] // 2
    result = np.empty((len(xy), 2), np.float32)
    for i in range(len(xy)):
        column, row = int(xy[i, 0] + 0.5), int(xy[i, 1] + 0.5)
        a, b, c, p, q = 0.0, 0.0, 0.0, 0.0, 0.0
        for v in range(-radius, radius + 1):
            for u in range(-radius, radius + 1):
                x, y = column + u, row + v
                gx = float(image[y, x + 1]) - float(image[y, x - 1])
                gy = float(image[y + 1, x]) - float(image[y - 1, x])
                weight = weights[v + radius, u + radius]
                xx, xy_, yy = weight * gx * gx, weight * gx * gy, weight * gy * gy
                a += xx
                b += xy_
                c += yy
                p += xx * u + xy_ * v
                q += xy_ * u + yy * v
        determinant = a * c - b * b
        du, dv = 0.0, 0.0
        if determinant > 1e-3 * a * c:
            du, dv = (c * p - b * q) / determinant, (a * q - b * p) / determinant
            if abs(du) > 1.0 or abs(dv) > 1.0:
                du, dv = 0.0, 0.0
        result[i, 0], result[i, 1] = column + du, row + dv
    return result


def orientations(image: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Direction in degrees, 0..360, from each corner (n, 2) to the centroid of grey in a disc about it (Rosin)."""
    return _orientations(image, xy, _HALF_WIDTHS)


@njit(cache=True, nogil=True)
def _orientations(image, xy, half_widths):
    angles = np.empty(len(xy), np.float32)
    radius = len(half_widths) - 1
    for i in range(len(xy)):
        column, row = int(xy[i, 0] + 0.5), int(xy[i, 1] + 0.5)
        m10, m01 = np.int32(0), np.int32(0)
        for v in range(-radius, radius + 1):
            half, total, moment = half_widths[abs(v)], np.int32(0), np.int32(0)
            line = image[row + v, column - half : column + half + 1]
            for u in range(2 * half + 1):
                grey = np.int32(line[u])
                moment += np.int32(u) * grey
                total += grey
            m10 += moment - np.int32(half) * total
            m01 += np.int32(v) * total
        angles[i] = np.degrees(np.arctan2(m01, m10)) % 360.0
    return angles
