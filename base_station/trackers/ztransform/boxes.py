"""The compiled reading of a target: means of boxes from running sums, so that a read costs the same at any size.

In a table of running sums the sum over any upright box is four reads away (Crow 1984, summed-area tables). A cell, or
a band's cell, is such a box, with its edges between pixels; only the numbers that a signature is made of are read:
every cell of every row band and column band. Where the picture is seen aslant, or on a cylinder, heights change along
it: a row band's cell then stands at its own height, and a column band is cut into as many strips as it needs.

A *table* is int32 (rows + 1, columns + 1), *where* five float64: the scale of the table's pixels, its left and top edge
and the whole frame's width and height, in its pixels. `reference.py` has the plain meaning. Placements and lenses: see
`kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from base_station.trackers.ztransform.kernels import HEIGHT, KEYSTONE, WIDEST_AZIMUTH_RAD, WIDTH, X, Y

SCALE, LEFT, TOP, FRAME_WIDTH, FRAME_HEIGHT = range(5)
LEAST = 0.02
"""Pixels of the table: what is left of a cell beyond the frame's edge."""
MOST_STRIPS = 12
IN_FRAME, LEAVES_TABLE, LEAVES_FRAME = 2, 1, 0


@njit(cache=True, fastmath=True, error_model="numpy")
def column_at(u, where, lens, placement):
    """Of patch coordinate u: x from the left edge in the table's pixels, shrinking of heights, visible or not."""
    shrink = 1.0 / (1.0 + placement[KEYSTONE] * u)
    x = placement[X] + placement[WIDTH] * u * shrink
    visible = True
    if lens[0] > 0:
        azimuth = (x - lens[2]) / lens[1]
        visible = abs(azimuth) < WIDEST_AZIMUTH_RAD
        azimuth = min(max(azimuth, -WIDEST_AZIMUTH_RAD), WIDEST_AZIMUTH_RAD)
        x = lens[2] + lens[1] * math.tan(azimuth)
        shrink /= math.cos(azimuth)
    return (x + 0.5) / where[SCALE], shrink, visible


@njit(cache=True, fastmath=True, error_model="numpy")
def row_at(v, shrink, where, lens, placement):
    """Of patch coordinate v: y from the upper edge in a column with this shrinking, as `column_at`."""
    y = lens[3] + (placement[Y] - lens[3] + placement[HEIGHT] * v) * shrink
    return (y + 0.5) / where[SCALE]


@njit(cache=True, fastmath=True, error_model="numpy")
def strip_above(table, left, right, y):
    """The sum over columns left..right of the rows above y; all of them between pixels, and inside of the table."""
    a, b, row = int(left), int(right), int(y)
    part_a, part_b, part = left - a, right - b, y - row
    upper = table[row, b] - table[row, a] + part_b * (table[row, b + 1] - table[row, b])
    upper -= part_a * (table[row, a + 1] - table[row, a])
    lower = table[row + 1, b] - table[row + 1, a] + part_b * (table[row + 1, b + 1] - table[row + 1, b])
    lower -= part_a * (table[row + 1, a + 1] - table[row + 1, a])
    return upper + part * (lower - upper)


@njit(cache=True, fastmath=True, error_model="numpy")
def lies(table, where, lens, placement):
    """Whether the placement lies in the frame, and in the table: IN_FRAME, LEAVES_TABLE or LEAVES_FRAME."""
    left = top = 1e9
    right = bottom = -1e9
    visible = True
    for i in range(3):
        x, shrink, seen = column_at(0.5 * (i - 1), where, lens, placement)
        visible = visible and seen
        left, right = min(left, x), max(right, x)
        top = min(top, row_at(-0.5, shrink, where, lens, placement))
        bottom = max(bottom, row_at(0.5, shrink, where, lens, placement))
    if not visible or left < 0 or top < 0 or right > where[FRAME_WIDTH] or bottom > where[FRAME_HEIGHT]:
        return LEAVES_FRAME
    rows, columns = table.shape[0] - 1, table.shape[1] - 1
    left, right, top, bottom = left - where[LEFT], right - where[LEFT], top - where[TOP], bottom - where[TOP]
    inside = left >= 0 and top >= 0 and right < columns - LEAST and bottom < rows - LEAST
    return IN_FRAME if inside else LEAVES_TABLE


@njit(cache=True, fastmath=True, error_model="numpy")
def strips_needed(bands, cells, where, lens, placement):
    """Into how many strips a column band is cut: in none do heights change by more than half a cell."""
    most = 0.0
    for b in range(bands):
        _, first, _ = column_at(b / bands - 0.5, where, lens, placement)
        _, middle, _ = column_at((b + 0.5) / bands - 0.5, where, lens, placement)
        _, last, _ = column_at((b + 1) / bands - 0.5, where, lens, placement)
        most = max(most, abs(first - middle) + abs(middle - last))
    reach = abs(placement[Y] - lens[3]) + 0.5 * placement[HEIGHT]
    return min(max(math.ceil(2 * cells * most * reach / placement[HEIGHT]), 1), MOST_STRIPS)


@njit(cache=True, fastmath=True, error_model="numpy")
def read_profiles(table, where, lens, placement, profiles):
    """Row bands, then column bands of a placement that lies in the frame and in the table, into (2 bands, cells)."""
    bands, cells = profiles.shape[0] // 2, profiles.shape[1]
    depth = cells // bands
    left, _, _ = column_at(-0.5, where, lens, placement)
    for i in range(cells):
        right, _, _ = column_at((i + 1) / cells - 0.5, where, lens, placement)
        _, shrink, _ = column_at((i + 0.5) / cells - 0.5, where, lens, placement)
        x0, x1 = left - where[LEFT], right - where[LEFT]
        y = row_at(-0.5, shrink, where, lens, placement) - where[TOP]
        above = strip_above(table, x0, x1, y)
        for b in range(bands):
            v = ((b + 1) * depth / cells if b < bands - 1 else 1.0) - 0.5
            next_y = row_at(v, shrink, where, lens, placement) - where[TOP]
            now = strip_above(table, x0, x1, next_y)
            profiles[b, i] = (now - above) / ((x1 - x0) * (next_y - y))
            y, above = next_y, now
        left = right
    strips = strips_needed(bands, cells, where, lens, placement)
    for b in range(bands):
        first, beyond = b * depth / cells, (b + 1) * depth / cells if b < bands - 1 else 1.0
        for i in range(cells):
            profiles[bands + b, i] = np.float32(0.0)
        for s in range(strips):
            u0, u1 = first + (beyond - first) * s / strips, first + (beyond - first) * (s + 1) / strips
            left, _, _ = column_at(u0 - 0.5, where, lens, placement)
            right, _, _ = column_at(u1 - 0.5, where, lens, placement)
            _, shrink, _ = column_at(0.5 * (u0 + u1) - 0.5, where, lens, placement)
            x0, x1 = left - where[LEFT], right - where[LEFT]
            start = row_at(-0.5, shrink, where, lens, placement) - where[TOP]
            step = placement[HEIGHT] * shrink / (where[SCALE] * cells)
            share = 1.0 / ((x1 - x0) * step * strips)
            above = strip_above(table, x0, x1, start)
            for i in range(cells):
                now = strip_above(table, x0, x1, start + (i + 1) * step)
                profiles[bands + b, i] += np.float32((now - above) * share)
                above = now


@njit(cache=True, fastmath=True, error_model="numpy")
def sample_boxes(table, where, lens, placement, patch, seen):
    """All cells of a placement that may stick out of the frame, for a table of the whole frame; see `sample_patch`.

    Fills `patch` (cells, cells) with means, `seen` with 1 where a cell's middle is inside of the frame. Beyond it the
    frame's border repeats. Returns the share of cells that are seen.
    """
    cells, total = patch.shape[0], 0
    width, height = where[FRAME_WIDTH], where[FRAME_HEIGHT]
    left, _, _ = column_at(-0.5, where, lens, placement)
    for i in range(cells):
        right, _, _ = column_at((i + 1) / cells - 0.5, where, lens, placement)
        middle, shrink, visible = column_at((i + 0.5) / cells - 0.5, where, lens, placement)
        visible = visible and middle >= 0 and middle <= width
        x0 = min(max(left, 0.0), width - 2 * LEAST)
        x1 = min(max(right, x0 + LEAST), width - LEAST)
        start = row_at(-0.5, shrink, where, lens, placement)
        step = placement[HEIGHT] * shrink / (where[SCALE] * cells)
        for j in range(cells):
            y = start + (j + 0.5) * step
            ok = visible and y >= 0 and y <= height
            y0 = min(max(start + j * step, 0.0), height - 2 * LEAST)
            y1 = min(max(start + (j + 1) * step, y0 + LEAST), height - LEAST)
            total_here = strip_above(table, x0, x1, y1) - strip_above(table, x0, x1, y0)
            patch[j, i] = total_here / ((x1 - x0) * (y1 - y0))
            seen[j, i] = 1 if ok else 0
            total += 1 if ok else 0
        left = right
    return total / (cells * cells)
