"""The compiled inner loops of acquisition: a band's cells at any zoom, their transform, the score of every position.

The pitch of the cells is scaled with the zoom under test, so poles (per cell) and anchors (in cells) stay the same
numbers at every zoom. The poles of all bands are read side by side in *lanes*, of which a processor takes eight at a
time. `reference.py` has the plain meaning; tables of running sums and where they are: see `boxes`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from base_station.trackers.ztransform.boxes import FRAME_WIDTH, LEAST, SCALE
from base_station.trackers.ztransform.kernels import WIDEST_AZIMUTH_RAD

FINITE_OR_NOT = {"contract", "arcp", "nsz", "reassoc"}
"""Fast mathematics that knows NaN."""
LANES = 16
"""Most bands times poles."""


@njit(cache=True, fastmath=True, error_model="numpy")
def means_between(edges, sums, last, depth, cells):
    """Means between neighbouring edges, into `cells`, from the sums over all that lies before; see `row_profile`."""
    before_x, before = 0.0, 0.0
    for i in range(len(edges)):
        x = min(max(edges[i], 0.0), last)
        n = int(x)
        value = sums[n] + (x - n) * (sums[n + 1] - sums[n])
        if i > 0:
            wide = x - before_x
            if wide > 1e-6:
                cells[i - 1] = (value - before) / (wide * depth)
            else:
                cells[i - 1] = cells[i - 2] if i > 1 else np.float32(0.0)
        before_x, before = x, value


@njit(cache=True, fastmath=True, error_model="numpy")
def row_profile(table, top, bottom, edges, sums, cells):
    """Mean of the rows top..bottom between neighbouring edges (columns), for each of them, into `cells`.

    For a table of the whole frame; in its pixels, between pixels. What lies outside of the frame is cut off; a cell of
    which nothing is left has the value of its neighbour. `sums`: scratch, float64, as long as the table's longer side.
    """
    width, height = table.shape[1] - 1, table.shape[0] - 1 - LEAST
    top = min(max(top, 0.0), height - 1.0)
    bottom = min(max(bottom, top + 1.0), height)
    a, b = int(top), int(bottom)
    part_a, part_b = top - a, bottom - b
    above, above_next, below, below_next = table[a], table[a + 1], table[b], table[b + 1]
    for x in range(width + 1):
        sums[x] = below[x] - above[x] + part_b * (below_next[x] - below[x]) - part_a * (above_next[x] - above[x])
    means_between(edges, sums, width - LEAST, bottom - top, cells)


@njit(cache=True, fastmath=True, error_model="numpy")
def column_profile(table, left, right, edges, sums, cells):
    """The same for the columns left..right; the edges are rows."""
    width, height = table.shape[1] - 1 - LEAST, table.shape[0] - 1
    left = min(max(left, 0.0), width - 1.0)
    right = min(max(right, left + 1.0), width)
    a, b = int(left), int(right)
    part_a, part_b = left - a, right - b
    first, beyond = max(int(edges[0]), 0), min(int(edges[-1]) + 2, height + 1)
    for y in range(first, beyond):
        line = table[y]
        sums[y] = line[b] - line[a] + part_b * (line[b + 1] - line[b]) - part_a * (line[a + 1] - line[a])
    means_between(edges, sums, height - LEAST, right - left, cells)


@njit(cache=True, fastmath=True, error_model="numpy")
def read_field(profiles, count, poles, field):
    """The two-sided second-order transform of the profiles' differences about every cell.

    `profiles`: (bands, cells); `count`: poles for each; `poles`: (3 * LANES,), real parts, imaginary parts and weights
    of the first band's poles, then of the next one's; lanes that are left over have the weight 0. `field`: (cells,
    4 * LANES): right real, right imaginary, left real, left imaginary. State and poles lie in one array at fixed
    distances, so that the compiler sees that lanes do not touch each other.
    """
    bands, cells = profiles.shape
    work = np.zeros(8 * LANES, np.float32)
    for k in range(3 * LANES):
        work[k] = poles[k]
    for side in range(2):
        for k in range(4 * LANES):
            work[3 * LANES + k] = np.float32(0.0)
        for i in range(cells):
            n = cells - 1 - i if side == 0 else i
            out = field[n, 2 * side * LANES : (2 * side + 2) * LANES]
            after, before = min(n + 1, cells - 1), max(n - 1, 0)
            for b in range(bands):
                slope = (profiles[b, after] - profiles[b, before]) * np.float32(0.5)
                for k in range(count):
                    work[7 * LANES + b * count + k] = slope
            for k in range(LANES):
                p_re, p_im, weight = work[k], work[LANES + k], work[2 * LANES + k]
                f_re, f_im = work[3 * LANES + k], work[4 * LANES + k]
                t_re, t_im = work[5 * LANES + k] + f_re, work[6 * LANES + k] + f_im
                s_re, s_im = p_re * t_re - p_im * t_im, p_re * t_im + p_im * t_re
                work[5 * LANES + k], work[6 * LANES + k] = s_re, s_im
                work[3 * LANES + k] = p_re * f_re - p_im * f_im + work[7 * LANES + k]
                work[4 * LANES + k] = p_re * f_im + p_im * f_re
                out[k], out[LANES + k] = s_re * weight, s_im * weight


@njit(cache=True, fastmath=True, error_model="numpy")
def energies(field, out):
    """The energy of the field about every cell."""
    for n in range(field.shape[0]):
        total = np.float32(0.0)
        for j in range(field.shape[1]):
            total += field[n, j] * field[n, j]
        out[n] = total


@njit(cache=True, fastmath=True, error_model="numpy")
def score_position(field, energy, learned, learned_energy, anchors, least_share, middle):
    """Normalised correlation of the learned signature with the field, the target's middle at this cell.

    `field`: (cells, numbers); `energy`: (cells,); `learned`: (anchors, numbers); `learned_energy`: (anchors,);
    `anchors`: offsets in cells. Anchors outside of the frame do not count; a position where less than `least_share` of
    the learned energy is in the frame scores -1.
    """
    product, here, there, whole = np.float32(0.0), np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for a in range(len(anchors)):
        n = middle + anchors[a]
        whole += learned_energy[a]
        if n >= 0 and n < field.shape[0]:
            here += energy[n]
            there += learned_energy[a]
            for j in range(field.shape[1]):
                product += field[n, j] * learned[a, j]
    return product / np.sqrt(here * there + np.float32(1e-9)) if there >= least_share * whole else np.float32(-1.0)


@njit(cache=True, fastmath=True, error_model="numpy")
def best_position(field, learned, learned_energy, anchors, least_share, first, beyond):
    """The best score and its place, in cells with a fraction, among the cells first..beyond - 1.

    Every other cell is tried, then the best one's neighbours; between these a parabola peaks.
    """
    energy = np.empty(field.shape[0], np.float32)
    energies(field, energy)
    best, score = first, np.float32(-2.0)
    for n in range(first, beyond, 2):
        value = score_position(field, energy, learned, learned_energy, anchors, least_share, n)
        if value > score:
            best, score = n, value
    for n in (best - 1, best + 1):
        if n >= first and n < beyond:
            value = score_position(field, energy, learned, learned_energy, anchors, least_share, n)
            if value > score:
                best, score = n, value
    if best <= first or best >= beyond - 1:
        return score, float(best)
    left = score_position(field, energy, learned, learned_energy, anchors, least_share, best - 1)
    right = score_position(field, energy, learned, learned_energy, anchors, least_share, best + 1)
    bend = left - 2 * score + right
    return score, best + (min(max(0.5 * (left - right) / bend, -0.5), 0.5) if bend < 0 else 0.0)


@njit(cache=True, fastmath=True, error_model="numpy")
def row_field(table, where, lens, start, pitch, cells, y, height, bands, count, poles):
    """The field (cells, numbers) of the row bands of a target of this height at y; cells from `start` (px) on."""
    edges, profiles = np.empty(cells + 1), np.empty((bands, cells), np.float32)
    sums, field = np.empty(max(table.shape)), np.empty((cells, 4 * LANES), np.float32)
    for i in range(cells + 1):
        x = start + pitch * i
        if lens[0] > 0:
            azimuth = (x - lens[2]) / lens[1]
            x = lens[2] + lens[1] * math.tan(min(max(azimuth, -WIDEST_AZIMUTH_RAD), WIDEST_AZIMUTH_RAD))
        edges[i] = (x + 0.5) / where[SCALE]
    depth = 0.9 * height / bands
    for b in range(bands):
        top = y + 0.5 + (b - bands / 2) * depth
        row_profile(table, top / where[SCALE], (top + depth) / where[SCALE], edges, sums, profiles[b])
    read_field(profiles, count, poles, field)
    return field


@njit(cache=True, fastmath=True, error_model="numpy")
def column_field(table, where, start, pitch, cells, x, width, bands, count, poles):
    """The same of the column bands of a target of this width at x; cells from row `start` (px) on."""
    edges, profiles = np.empty(cells + 1), np.empty((bands, cells), np.float32)
    sums, field = np.empty(max(table.shape)), np.empty((cells, 4 * LANES), np.float32)
    for i in range(cells + 1):
        edges[i] = (start + pitch * i + 0.5) / where[SCALE]
    depth = 0.9 * width / bands
    for b in range(bands):
        left = x + 0.5 + (b - bands / 2) * depth
        column_profile(table, left / where[SCALE], (left + depth) / where[SCALE], edges, sums, profiles[b])
    read_field(profiles, count, poles, field)
    return field


@njit(cache=True, fastmath=FINITE_OR_NOT, error_model="numpy")
def search_rows(
    table, where, lens, sizes, cells_across, learned, energy, anchors, least_share,
    bands, count, poles, found,
):  # fmt: skip
    """The best column for each of `sizes` (y, width, height; px), into `found` (score, x); -1 where none fits."""
    left, right = -0.5, where[FRAME_WIDTH] * where[SCALE] - 0.5
    if lens[0] > 0:
        left = lens[2] + lens[1] * math.atan((left - lens[2]) / lens[1])
        right = lens[2] + lens[1] * math.atan((right - lens[2]) / lens[1])
    for i in range(len(sizes)):
        y, width, height = sizes[i]
        pitch = width / cells_across
        cells = int((right - left) / pitch)
        found[i, 0], found[i, 1] = -1.0, 0.0
        if cells < 3 or math.isnan(y):
            continue
        field = row_field(table, where, lens, left, pitch, cells, y, height, bands, count, poles)
        score, best = best_position(field, learned, energy, anchors, least_share, 0, cells)
        found[i, 0], found[i, 1] = score, left + (best + 0.5) * pitch


@njit(cache=True, fastmath=True, error_model="numpy")
def search_column(
    table, where, placement, reach, cells_down, learned, energy, anchors, least_share,
    bands, count, poles,
):  # fmt: skip
    """The best row within `reach` heights of the placement's: score and y."""
    pitch = placement[3] / cells_down
    start = placement[1] - (cells_down + 0.5) * pitch
    field = column_field(
        table, where, start, pitch, 2 * cells_down + 1, placement[0], placement[2], bands, count, poles
    )
    away = min(math.ceil(reach * cells_down), cells_down)
    first, beyond = cells_down - away, cells_down + away + 1
    score, best = best_position(field, learned, energy, anchors, least_share, first, beyond)
    return score, start + (best + 0.5) * pitch


@njit(cache=True, error_model="numpy")
def distinct(sizes, found, most):
    """Which of `found` are the best few, best first, leaving out neighbours of better ones; see `search_rows`."""
    kept, count = np.empty(most, np.int64), 0
    for n in np.argsort(-found[:, 0]):
        if found[n, 0] <= 0 or count == most:
            break
        near = False
        for other in kept[:count]:
            y, width, height = sizes[other]
            near = near or (
                abs(found[n, 1] - found[other, 1]) < 0.1 * width
                and abs(sizes[n, 0] - y) < 0.15 * height
                and abs(math.log(sizes[n, 1] / width)) < 0.1
            )
        if not near:
            kept[count] = n
            count += 1
    return kept[:count]
