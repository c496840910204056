"""The compiled inner loops of acquisition: cell means of a band at any zoom, and the score of every position.

The pitch of the cells is scaled with the zoom under test, so poles (per cell) and anchors (in cells) stay the same
numbers at every zoom. `reference.py` has the plain meaning.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def sum_rows(image, sums):
    """`sums` (height + 1, width) int32: in row y the sum of the rows above y, for each column."""
    height, width = image.shape
    for x in range(width):
        sums[0, x] = 0
    for y in range(height):
        for x in range(width):
            sums[y + 1, x] = sums[y, x] + image[y, x]


@njit(cache=True, fastmath=True)
def band_profile(sums, top, bottom, edges, running, cells):
    """Mean of the rows top..bottom (float, clipped to the frame) between neighbouring edges; into `cells`.

    `edges`: columns, float64, ascending, one more than cells; clipped to the frame. `running`: scratch (width + 1).
    """
    height, width = sums.shape[0] - 1, sums.shape[1]
    top = min(max(top, 0.0), height - 1.0)
    bottom = min(max(bottom, top + 1.0), float(height))
    row_a, row_b = min(int(top), height - 1), min(int(bottom), height - 1)
    part_a, part_b = np.float32(top - row_a), np.float32(bottom - row_b)
    share = np.float32(1.0 / (bottom - top))
    running[0] = 0.0
    total = 0.0
    for x in range(width):
        upper = sums[row_a, x] + part_a * (sums[row_a + 1, x] - sums[row_a, x])
        lower = sums[row_b, x] + part_b * (sums[row_b + 1, x] - sums[row_b, x])
        total += (lower - upper) * share
        running[x + 1] = total
    before_x, before = 0.0, 0.0
    for i in range(len(edges)):
        x = min(max(edges[i], 0.0), float(width))
        column = min(int(x), width - 1)
        value = running[column] + (x - column) * (running[column + 1] - running[column])
        if i > 0:
            wide = x - before_x
            cells[i - 1] = (value - before) / wide if wide > 1e-6 else (cells[i - 2] if i > 1 else 0.0)
        before_x, before = x, value


@njit(cache=True, fastmath=True)
def upright_profile(sums, left, right, edges, cells):
    """The same for a band that stands upright: mean of the columns left..right between neighbouring edges (rows)."""
    height, width = sums.shape[0] - 1, sums.shape[1]
    first = min(max(round(left), 0), width - 1)
    beyond = min(max(round(right), first + 1), width)
    before_y, before = 0.0, 0.0
    for i in range(len(edges)):
        y = min(max(edges[i], 0.0), float(height))
        row = min(int(y), height - 1)
        part, value = y - row, 0.0
        for x in range(first, beyond):
            value += sums[row, x] + part * (sums[row + 1, x] - sums[row, x])
        value /= beyond - first
        if i > 0:
            tall = y - before_y
            cells[i - 1] = (value - before) / tall if tall > 1e-6 else (cells[i - 2] if i > 1 else 0.0)
        before_y, before = y, value


@njit(cache=True, fastmath=True)
def read_field(profile, pole_re, pole_im, weights, field):
    """The two-sided second-order transform of a profile's difference about every cell; into (cells, poles, 2, 2)."""
    cells = len(profile)
    for k in range(len(pole_re)):
        p_re, p_im, weight = pole_re[k], pole_im[k], weights[k]
        for side in range(2):
            first_re = first_im = second_re = second_im = np.float32(0.0)
            for i in range(cells):
                n = cells - 1 - i if side == 0 else i
                d = (profile[min(n + 1, cells - 1)] - profile[max(n - 1, 0)]) * np.float32(0.5)
                t_re, t_im = second_re + first_re, second_im + first_im
                second_re = p_re * t_re - p_im * t_im
                second_im = p_re * t_im + p_im * t_re
                t_re = p_re * first_re - p_im * first_im + d
                first_im = p_re * first_im + p_im * first_re
                first_re = t_re
                field[n, k, side, 0] = second_re * weight
                field[n, k, side, 1] = second_im * weight


@njit(cache=True, fastmath=True)
def score_positions(fields, learned, learned_energy, anchors, least_share, scores):
    """Normalised correlation of the learned signature with the fields, the target's middle at each cell.

    `fields`: (bands, cells, numbers); `learned`: (anchors, bands, numbers); `learned_energy`: (anchors,);
    `anchors`: offsets in cells. Anchors outside of the frame do not count; a position where less than `least_share` of
    the learned energy is in the frame scores -1.
    """
    bands, cells, numbers = fields.shape
    energy = np.zeros(cells, np.float32)
    for b in range(bands):
        for n in range(cells):
            for j in range(numbers):
                energy[n] += fields[b, n, j] * fields[b, n, j]
    whole = np.float32(0.0)
    for a in range(len(anchors)):
        whole += learned_energy[a]
    for m in range(cells):
        product, here, there = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for a in range(len(anchors)):
            n = m + anchors[a]
            if 0 <= n < cells:
                here += energy[n]
                there += learned_energy[a]
                for b in range(bands):
                    for j in range(numbers):
                        product += fields[b, n, j] * learned[a, b, j]
        scores[m] = product / np.sqrt(here * there + np.float32(1e-9)) if there >= least_share * whole else -1.0
