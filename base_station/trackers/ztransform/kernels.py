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


@njit(cache=True, fastmath=True)
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


@njit(cache=True, fastmath=True)
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


@njit(cache=True, fastmath=True)
def fill_unseen(patch, seen, reference, gain, offset):
    """Put the reference where the frame ends: what is not seen then pulls neither way."""
    for y in range(patch.shape[0]):
        for x in range(patch.shape[1]):
            if seen[y, x] == 0:
                patch[y, x] = gain * reference[y, x] + offset


@njit(cache=True, fastmath=True)
def read_signature(patch, bands, pole_re, pole_im, weights, anchors, taper, signature):
    """Signature of a patch (cells, cells) into `signature` (2 bands, poles, 2 sides, anchors, 2) flat, of length 1.

    Row bands, then column bands; of each the mean profile, its central difference times the taper, and of that the
    second-order transform sum_u u p^u d[m +- u] about every anchor m, looking right and left. Returns the length that
    it had before normalising.
    """
    cells = patch.shape[0]
    poles, anchor_count = len(pole_re), len(anchors)
    depth = cells // bands
    profiles = np.zeros((2 * bands, cells), np.float32)
    for y in range(cells):
        band = min(y // depth, bands - 1)
        for x in range(cells):
            profiles[band, x] += patch[y, x]
            profiles[bands + min(x // depth, bands - 1), y] += patch[y, x]
    d = np.zeros(cells, np.float32)
    half = np.float32(0.5 / depth)
    square = 0.0
    for b in range(2 * bands):
        for n in range(1, cells - 1):
            d[n] = (profiles[b, n + 1] - profiles[b, n - 1]) * half * taper[n]
        for k in range(poles):
            p_re, p_im, weight = pole_re[k], pole_im[k], weights[k]
            for side in range(2):
                # first[n] = d[n] + p first[n+1];  second[n] = p (second[n+1] + first[n+1]): the recursion of eq. (3.4)
                first_re = first_im = second_re = second_im = np.float32(0.0)
                a = anchor_count - 1 if side == 0 else 0
                for i in range(cells):
                    n = cells - 1 - i if side == 0 else i
                    t_re, t_im = second_re + first_re, second_im + first_im
                    second_re = p_re * t_re - p_im * t_im
                    second_im = p_re * t_im + p_im * t_re
                    t_re = p_re * first_re - p_im * first_im + d[n]
                    first_im = p_re * first_im + p_im * first_re
                    first_re = t_re
                    if 0 <= a < anchor_count and anchors[a] == n:
                        j = (((b * poles + k) * 2 + side) * anchor_count + a) * 2
                        signature[j] = second_re * weight
                        signature[j + 1] = second_im * weight
                        square += signature[j] * signature[j] + signature[j + 1] * signature[j + 1]
                        a += -1 if side == 0 else 1
    length = math.sqrt(square)
    scale = np.float32(1.0 / max(length, 1e-6))
    for j in range(len(signature)):
        signature[j] *= scale
    return length


@njit(cache=True, fastmath=True)
def inner(one, other):
    """Inner product; written out, because numba's own needs SciPy. With fastmath it is as fast as BLAS at this size."""
    total = np.float32(0.0)
    for i in range(one.size):
        total += one[i] * other[i]
    return total


@njit(cache=True, fastmath=True)
def seen_correlation(patch, seen, reference, bands, pole_re, pole_im, weights, anchors, taper):
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
    size = 2 * bands * len(pole_re) * 2 * len(anchors) * 2
    one, other = np.empty(size, np.float32), np.empty(size, np.float32)
    read_signature(flat_p, bands, pole_re, pole_im, weights, anchors, taper, one)
    read_signature(flat_r, bands, pole_re, pole_im, weights, anchors, taper, other)
    return inner(one, other)


@njit(cache=True)
def move(placement, step, largest):
    """Apply a step (dx / width, dy / height, d log width, d log height, dq), each at most `largest`, in place."""
    dx = min(max(step[X], -largest), largest)
    dy = min(max(step[Y], -largest), largest)
    placement[X] += dx * placement[WIDTH]
    placement[Y] += dy * placement[HEIGHT]
    placement[WIDTH] *= math.exp(min(max(step[WIDTH], -largest), largest))
    placement[HEIGHT] *= math.exp(min(max(step[HEIGHT], -largest), largest))
    placement[KEYSTONE] += min(max(step[KEYSTONE], -largest), largest)
