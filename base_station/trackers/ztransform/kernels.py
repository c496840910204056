"""The compiled inner loops of tracking: sample a patch, read its signature, improve a placement.

Each has its plain meaning in `reference.py`, and a test holds the two together. A *placement* is five float64:
x, y (middle, px), width, height (px), keystone q. Patch coordinates u, v in -0.5..0.5 lie at

    x + width u / (1 + q u),   y_h + (y - y_h + height v) / (1 + q u)

which is the exact view of an upright flat picture that is turned about the vertical, y_h the horizon. A *lens* is
four float64: curved (0 or 1), focal length, principal point. With curved = 1 placements lie on a cylinder about the
camera, unrolled with the focal length as its radius: there a turn on the spot is a pure shift.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

X, Y, WIDTH, HEIGHT, KEYSTONE = range(5)
FREEDOMS = 5
WIDEST_AZIMUTH_RAD = 1.2


@njit(cache=True, fastmath=True, error_model="numpy")
def sample_patch(image, scale, placement, lens, samples, patch, seen):
    """Fill `patch` (cells, cells) with means of samples x samples bilinear reads; `seen`: 1 inside of the frame.

    `image` is the frame at 1 / scale of its size (see `pyramid`); placement and lens are in px of the full frame.
    Returns the share of cells seen. Reads outside of the frame repeat its border.
    """
    height, width = image.shape
    inverse, offset = 1.0 / scale, 0.5 * (scale - 1) / scale
    cells = patch.shape[0]
    n = cells * samples
    column = np.empty(n, np.int32)
    column_part = np.empty(n, np.float32)
    row_middle = np.empty(n, np.float32)
    row_span = np.empty(n, np.float32)
    inside = np.empty(n, np.uint8)
    curved, focal, middle_x, middle_y = lens[0] > 0, lens[1], lens[2], lens[3]
    for i in range(n):
        u = (i + 0.5) / n - 0.5
        shrink = 1.0 / (1.0 + placement[KEYSTONE] * u)
        x = placement[X] + placement[WIDTH] * u * shrink
        y = middle_y + (placement[Y] - middle_y) * shrink
        span = placement[HEIGHT] * shrink
        visible = True
        if curved:
            azimuth = (x - middle_x) / focal
            visible = abs(azimuth) < WIDEST_AZIMUTH_RAD
            azimuth = min(max(azimuth, -WIDEST_AZIMUTH_RAD), WIDEST_AZIMUTH_RAD)
            stretch = 1.0 / math.cos(azimuth)
            x = middle_x + focal * math.tan(azimuth)
            y = middle_y + (y - middle_y) * stretch
            span *= stretch
        x = x * inverse - offset
        y = y * inverse - offset
        inside[i] = 1 if visible and -0.5 <= x <= width - 0.5 else 0
        x = min(max(x, 0.0), width - 1.001)
        column[i] = int(x)
        column_part[i] = x - column[i]
        row_middle[i] = y
        row_span[i] = span * inverse
    total = 0
    share = np.float32(1.0 / (samples * samples))
    low, high = np.float32(0.0), np.float32(height - 1.001)
    one, half = np.float32(1.0), np.float32(0.5)
    for cell_y in range(cells):
        centre_v = np.float32((cell_y + 0.5) / cells - 0.5)
        for cell_x in range(cells):
            middle = cell_x * samples + samples // 2
            y = row_middle[middle] + centre_v * row_span[middle]
            ok = inside[middle] == 1 and -half <= y and y <= height - half
            seen[cell_y, cell_x] = 1 if ok else 0
            total += 1 if ok else 0
            patch[cell_y, cell_x] = 0
        for s in range(samples):
            v = np.float32((cell_y * samples + s + 0.5) / n - 0.5)
            k = 0
            for cell_x in range(cells):
                value = np.float32(0.0)
                for _ in range(samples):
                    y = min(max(row_middle[k] + v * row_span[k], low), high)
                    row = int(y)
                    fy = y - np.float32(row)
                    x, fx = column[k], column_part[k]
                    above = image[row, x] * (one - fx) + image[row, x + 1] * fx
                    below = image[row + 1, x] * (one - fx) + image[row + 1, x + 1] * fx
                    value += above * (one - fy) + below * fy
                    k += 1
                patch[cell_y, cell_x] += value * share
    return total / (cells * cells)


@njit(cache=True, fastmath=True, error_model="numpy")
def match_light(patch, seen, reference):
    """Gain and offset that give the reference the contrast and mean of the patch, over the cells that are seen."""
    n, sum_p, sum_r, sum_pp, sum_rr = 0, 0.0, 0.0, 0.0, 0.0
    for y in range(patch.shape[0]):
        for x in range(patch.shape[1]):
            if seen[y, x] == 1:
                p, r = patch[y, x], reference[y, x]
                n += 1
                sum_p += p
                sum_r += r
                sum_pp += p * p
                sum_rr += r * r
    if n == 0:
        return 1.0, 0.0
    spread_p = max(sum_pp / n - (sum_p / n) ** 2, 0.0)
    spread_r = max(sum_rr / n - (sum_r / n) ** 2, 1e-6)
    gain = math.sqrt(spread_p / spread_r)
    return gain, sum_p / n - gain * sum_r / n


@njit(cache=True, fastmath=True, error_model="numpy")
def fill_unseen(patch, seen, reference, gain, offset):
    """Put the reference where the frame ends: what is not seen then pulls neither way."""
    for y in range(patch.shape[0]):
        for x in range(patch.shape[1]):
            if seen[y, x] == 0:
                patch[y, x] = gain * reference[y, x] + offset


@njit(cache=True, fastmath=True, error_model="numpy")
def inner(one, other):
    """Inner product; written out, because numba's own needs SciPy. With fastmath it is as fast as BLAS at this size."""
    total = np.float32(0.0)
    for i in range(one.size):
        total += one[i] * other[i]
    return total


@njit(cache=True, fastmath=True, error_model="numpy")
def band_means(patch, bands, profiles):
    """Row bands, then column bands of a patch (cells, cells) into `profiles` (2 bands, cells): the mean of each."""
    cells = patch.shape[0]
    depth = cells // bands
    for b in range(bands):
        first, beyond = b * depth, (b + 1) * depth if b < bands - 1 else cells
        share = np.float32(1.0 / (beyond - first))
        for x in range(cells):
            profiles[b, x] = np.float32(0.0)
        for y in range(first, beyond):
            for x in range(cells):
                profiles[b, x] += patch[y, x] * share
        for y in range(cells):
            total = np.float32(0.0)
            for x in range(first, beyond):
                total += patch[y, x]
            profiles[bands + b, y] = total * share


@njit(cache=True, fastmath=True, error_model="numpy")
def read_bands(profiles, windows, signature):
    """Signature of band profiles (bands, cells) into `signature` (bands, numbers) flat, of length 1.

    A signature is linear in the profiles but for its length, so the poles are read through their windows, `windows`
    (cells, numbers), as `SignatureReader` sums them up. Returns the length that it had before normalising.
    """
    bands, cells = profiles.shape
    numbers = windows.shape[1]
    for b in range(bands):
        out = signature[b * numbers : (b + 1) * numbers]
        for j in range(numbers):
            out[j] = np.float32(0.0)
        for n in range(cells):
            value = profiles[b, n]
            for j in range(numbers):
                out[j] += value * windows[n, j]
    length = math.sqrt(inner(signature, signature))
    scale = np.float32(1.0 / max(length, 1e-6))
    for j in range(len(signature)):
        signature[j] *= scale
    return length


@njit(cache=True, fastmath=True, error_model="numpy")
def read_signature(patch, bands, windows, signature):
    """Signature of a patch, see `read_bands`; returns its length before normalising."""
    profiles = np.empty((2 * bands, patch.shape[0]), np.float32)
    band_means(patch, bands, profiles)
    return read_bands(profiles, windows, signature)


@njit(cache=True, fastmath=True, error_model="numpy")
def seen_correlation(patch, seen, reference, bands, windows):
    """Normalised correlation of two signatures in which only the cells seen count (the others at the mean)."""
    cells = patch.shape[0]
    mean_p, mean_r, n = 0.0, 0.0, 0
    for y in range(cells):
        for x in range(cells):
            if seen[y, x] == 1:
                mean_p += patch[y, x]
                mean_r += reference[y, x]
                n += 1
    if n == 0:
        return 0.0
    flat_p, flat_r = np.zeros((cells, cells), np.float32), np.zeros((cells, cells), np.float32)
    for y in range(cells):
        for x in range(cells):
            if seen[y, x] == 1:
                flat_p[y, x] = patch[y, x] - mean_p / n
                flat_r[y, x] = reference[y, x] - mean_r / n
    size = 2 * bands * windows.shape[1]
    one, other = np.empty(size, np.float32), np.empty(size, np.float32)
    read_signature(flat_p, bands, windows, one)
    read_signature(flat_r, bands, windows, other)
    return inner(one, other)


@njit(cache=True, error_model="numpy")
def move(placement, step, largest):
    """Apply a step (dx / width, dy / height, d log width, d log height, dq), each at most `largest`, in place."""
    dx = min(max(step[X], -largest), largest)
    dy = min(max(step[Y], -largest), largest)
    placement[X] += dx * placement[WIDTH]
    placement[Y] += dy * placement[HEIGHT]
    placement[WIDTH] *= math.exp(min(max(step[WIDTH], -largest), largest))
    placement[HEIGHT] *= math.exp(min(max(step[HEIGHT], -largest), largest))
    placement[KEYSTONE] += min(max(step[KEYSTONE], -largest), largest)
