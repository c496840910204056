"""What is kept of a corner: where it lies to a fraction of a pixel, how it is turned, and its look in 256 bits.

All is read around a corner at once, while its surroundings are near. The look is ORB's (Rublee et al., "ORB", ICCV
2011): pairs of places of the smoothed picture, turned as the corner is, are compared.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from base_station.trackers.slam.corners import BORDER_PX
from base_station.trackers.slam.orb_pairs import PAIRS

PATCH_RADIUS_PX = 15
CORNER_RADIUS_PX = 4
LANES = 32
"""Of a row of a patch, as many px are read at once; those too many are masked."""


def smoothed(level: np.ndarray, into: np.ndarray | None = None) -> np.ndarray:
    """The picture whose grey levels are compared."""
    return cv2.sepFilter2D(level, -1, _SMOOTHING, _SMOOTHING, into)  # half as long as GaussianBlur, which rounds anew


def describe(level: np.ndarray, smooth: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of corners (n, 2) int32 px of a picture (h, w) uint8: places (n, 2) float32 px, angles (n,) float32 degrees,
    0..360, and descriptors (n, 4) uint64. Raises ValueError where one lies within BORDER_PX."""
    places, angles = np.empty((len(corners), 2), np.float32), np.empty(len(corners), np.float32)
    looks = np.empty((len(corners), 4), np.uint64)
    if not _describe(level, smooth, corners, _DISC, _WINDOW, _PAIRS, places, angles, looks):
        raise ValueError(f"a corner nearer than {BORDER_PX} px to the picture's border cannot be described")
    return places, angles, looks


_SMOOTHING = cv2.getGaussianKernel(7, 2.0, cv2.CV_32F)
_ROUND = [round((PATCH_RADIUS_PX**2 - v * v) ** 0.5) for v in range(PATCH_RADIUS_PX + 1)]
_HALF_WIDTHS = [
    max(u for u in range(PATCH_RADIUS_PX + 1) if _ROUND[v] >= u or _ROUND[u] >= v) for v in range(PATCH_RADIUS_PX + 1)
]
"""Of the disc's rows; the same across as along, or the angle would depend on how the camera is turned."""
_DISC = np.array([[255 * (abs(u - PATCH_RADIUS_PX) <= half) for u in range(LANES)] for half in _HALF_WIDTHS], np.uint8)
_SIDE = 2 * CORNER_RADIUS_PX + 3
"""Of the px about a corner whose differences are its gradients."""
_DOWN, _ALONG = np.divmod(np.arange((_SIDE - 2) * _SIDE), _SIDE) - np.array(CORNER_RADIUS_PX)
_WINDOW = np.stack(
    [np.exp(-(_ALONG**2 + _DOWN**2) / CORNER_RADIUS_PX**2) * (_ALONG <= CORNER_RADIUS_PX), _ALONG, _DOWN]
).astype(np.float32)
"""(3, 99): weight, u and v of each gradient, row by row; those that would reach into the next row weigh nothing."""
_PAIRS = np.ascontiguousarray(PAIRS.transpose(1, 2, 0), np.float32)


@njit(cache=True, nogil=True)
def _describe(level, smooth, corners, disc, window, pairs, places, angles, looks):
    """Whether all corners are far enough from the border."""
    along, across = np.empty(LANES, np.int16), np.empty(LANES, np.int16)
    patch = np.zeros(_SIDE * _SIDE + 1, np.float32)  # the last gradient, which weighs nothing, reads one more
    first, second = np.empty(pairs.shape[2], np.int32), np.empty(pairs.shape[2], np.int32)
    flat = smooth.reshape(-1)
    height, width = level.shape
    for i in range(len(corners)):
        column, row = corners[i, 0], corners[i, 1]
        if min(column, row, width - 1 - column, height - 1 - row) < BORDER_PX:
            return False
        places[i, 0], places[i, 1] = _place(level, column, row, window, patch)
        angle = _angle_deg(level, column, row, disc, along, across)
        angles[i] = angle
        turn = np.float32(angle) * np.float32(np.pi / 180.0)
        c, s = np.float32(np.cos(turn)), np.float32(np.sin(turn))
        _turned(pairs[0], c, s, width, first)
        _turned(pairs[1], c, s, width, second)
        _compare(flat, row * width + column, first, second, looks[i])
    return True


@njit(cache=True, nogil=True)
def _place(level, column, row, window, patch):
    """Where the edges around a corner meet: the point from which all gradients nearby point across, in the least
    squares sense (Foerstner and Guelch 1987). A corner that would move by more than a px stays."""
    radius = CORNER_RADIUS_PX + 1
    left = np.uint64(column - radius)
    for v in range(_SIDE):
        line, first = level[row + v - radius], np.uint64(v * _SIDE)
        for u in range(np.uint64(_SIDE)):
            patch[first + u] = np.float32(line[left + u])
    a, b, c, p, q = _gradient_sums(patch, window[0], window[1], window[2])
    determinant = a * c - b * b
    if determinant > np.float32(1e-3) * a * c:
        du, dv = (c * p - b * q) / determinant, (a * q - b * p) / determinant
        if abs(du) <= 1.0 and abs(dv) <= 1.0:
            return column + du, row + dv
    return column + 0.0, row + 0.0


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def _gradient_sums(patch, weights, along, down):
    a, b, c, p, q = np.float32(0), np.float32(0), np.float32(0), np.float32(0), np.float32(0)
    for k in range(np.uint64(len(weights))):
        gx = patch[k + np.uint64(_SIDE + 2)] - patch[k + np.uint64(_SIDE)]
        gy = patch[k + np.uint64(2 * _SIDE + 1)] - patch[k + np.uint64(1)]
        wx, wy = weights[k] * gx, weights[k] * gy
        a += wx * gx
        b += wx * gy
        c += wy * gy
        p += wx * (gx * along[k] + gy * down[k])
        q += wy * (gx * along[k] + gy * down[k])
    return a, b, c, p, q


@njit(cache=True, nogil=True)
def _angle_deg(level, column, row, disc, along, across):
    """Direction from the corner to the centroid of grey in a disc about it (Rosin 1999)."""
    left = np.uint64(column - PATCH_RADIUS_PX)
    line, mask = level[row], disc[0]
    for u in range(np.uint64(LANES)):
        along[u] = np.int16(line[left + u] & mask[u])
        across[u] = np.int16(0)
    for v in range(1, PATCH_RADIUS_PX + 1):
        above, below, mask = level[row - v], level[row + v], disc[v]
        for u in range(np.uint64(LANES)):
            one, two = np.int16(above[left + u] & mask[u]), np.int16(below[left + u] & mask[u])
            along[u] = np.int16(along[u] + one + two)
            across[u] = np.int16(across[u] + np.int16(v) * (two - one))
    m10, m01 = 0, 0
    for u in range(2 * PATCH_RADIUS_PX + 1):
        m10 += along[u] * (u - PATCH_RADIUS_PX)
        m01 += across[u]
    return np.degrees(np.arctan2(m01, m10)) % 360.0


@njit(cache=True, nogil=True)
def _turned(places, c, s, stride, offsets):
    """Where the turned places (2, n) lie in the picture's memory, from its corner."""
    x, y = places[0], places[1]
    for k in range(np.uint64(len(offsets))):
        down, along = np.rint(x[k] * s + y[k] * c), np.rint(x[k] * c - y[k] * s)
        offsets[k] = np.int32(down) * np.int32(stride) + np.int32(along)


@njit(cache=True, nogil=True)
def _compare(flat, center, first, second, look):
    for word in range(4):
        bits = np.uint64(0)
        for k in range(64):
            pair = 64 * word + k
            darker = flat[np.uint64(center + first[pair])] < flat[np.uint64(center + second[pair])]
            bits |= np.uint64(darker) << np.uint64(k)
        look[word] = bits
