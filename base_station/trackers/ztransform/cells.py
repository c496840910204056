"""The compiled reading of a target's cells straight from the frame's pixels: exact means, whatever the cells' size.

First down the columns: running sums of every column of pixels about the target, made once a frame, tell what lies
between two rows in two reads. Then along the rows: of each row of cells, the few columns of pixels that a cell covers,
with their weights. In a flat picture seen aslant the edges between rows of cells are straight lines, so cells are the
trapezoids that they are; pixel columns on the same pixel row are reckoned side by side.

Sums are kept modulo 65536, as only differences are used: a cell may be up to 256 px high. Placements: see `kernels`;
the lens is flat. `reference.py` has the plain meaning.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from base_station.trackers.ztransform.kernels import HEIGHT, KEYSTONE, WIDTH, X, Y

TALLEST_CELL_PX = 256.0
FAR_PX = 1e9
LEAST_WIDTH = 1e-3
"""Of the learned width, where one is seen so aslant that a side comes near the camera."""
ABREAST = 4
"""Rows of cells that are summed side by side."""
TOP, BOTTOM, LEFT, RIGHT = range(4)


@njit(cache=True, fastmath=True, error_model="numpy")
def extent(placement, horizon_px):
    """top, bottom, left, right of a placement, from the frame's upper left edge: pixel n lies between n and n + 1.

    Of any size where a side of it would be behind the camera.
    """
    half_q = 0.5 * placement[KEYSTONE]
    if abs(half_q) > 1 - LEAST_WIDTH:
        return -FAR_PX, FAR_PX, -FAR_PX, FAR_PX
    left = placement[X] - 0.5 * placement[WIDTH] / (1 - half_q) + 0.5
    right = placement[X] + 0.5 * placement[WIDTH] / (1 + half_q) + 0.5
    above = placement[Y] - horizon_px - 0.5 * placement[HEIGHT]
    below = above + placement[HEIGHT]
    top = horizon_px + 0.5 + min(above / (1 - half_q), above / (1 + half_q))
    bottom = horizon_px + 0.5 + max(below / (1 - half_q), below / (1 + half_q))
    return top, bottom, left, right


@njit(cache=True, fastmath=True, error_model="numpy")
def is_inside(image, placement, horizon_px, cells):
    """Whether all of the placement lies in the image (and its cells are not too high to be summed)."""
    top, bottom, left, right = extent(placement, horizon_px)
    inside = top >= 0 and left >= 0 and bottom <= image.shape[0] and right <= image.shape[1]
    return inside and bottom - top < cells * TALLEST_CELL_PX and right - left > 1


@njit(cache=True, fastmath=True, error_model="numpy")
def part_about(image, placement, horizon_px, margin):
    """The pixels about a placement: first row, past-last row, first column, past-last column; int64 (4,).

    `margin`: of its width and height, to be ready for what is near it.
    """
    top, bottom, left, right = extent(placement, horizon_px)
    more_x, more_y = margin * placement[WIDTH], margin * placement[HEIGHT]
    out = np.empty(4, np.int64)
    out[TOP] = max(int(max(top - more_y, 0.0)), 0)
    out[BOTTOM] = int(min(bottom + more_y + 1, image.shape[0] * 1.0))
    out[LEFT] = max(int(max(left - more_x, 0.0)), 0)
    out[RIGHT] = int(min(right + more_x + 1, image.shape[1] * 1.0))
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def covers(part, image, placement, horizon_px):
    """Whether this part of the image shows all that the image shows of the placement."""
    top, bottom, left, right = extent(placement, horizon_px)
    return (
        part[TOP] <= max(top, 0.0)
        and part[LEFT] <= max(left, 0.0)
        and part[BOTTOM] >= min(bottom, image.shape[0] * 1.0)
        and part[RIGHT] >= min(right, image.shape[1] * 1.0)
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def sums_down(image, part):
    """Running sums down every column of this part of the image, modulo 65536: uint16 (rows + 1, columns)."""
    sums = np.empty((part[BOTTOM] - part[TOP] + 1, part[RIGHT] - part[LEFT]), np.uint16)
    sums[0] = np.uint16(0)
    for y in range(len(sums) - 1):
        line, above, here = image[part[TOP] + y, part[LEFT] : part[RIGHT]], sums[y], sums[y + 1]
        for x in range(len(here)):
            here[x] = np.uint16(above[x] + np.uint16(line[x]))
    return sums


@njit(cache=True, fastmath=True, error_model="numpy")
def _columns_of(placement, left, cells):
    """Which columns of pixels a column of cells covers: the first of each, and weights (cells, columns) that give a
    mean."""
    x, width, keystone = placement[X], placement[WIDTH], placement[KEYSTONE]
    first, edges, most = np.empty(cells, np.uint32), np.empty(cells + 1), 1
    for i in range(cells + 1):
        u = i / cells - 0.5
        edges[i] = max(x + width * u / (1 + keystone * u) + 0.5 - left, 0.0)
    for i in range(cells):
        first[i] = int(edges[i])
        most = max(most, math.ceil(edges[i + 1]) - int(edges[i]))
    weights, fall, per_px = np.zeros((cells, most), np.float32), keystone / width, placement[HEIGHT] / cells
    for i in range(cells):
        n, columns = int(edges[i]), math.ceil(edges[i + 1]) - int(edges[i])
        cut, cut_end = edges[i] - n, n + columns - edges[i + 1]
        nearer = 1 - fall * (left + n - x)  # of the first column, how high it is against the middle one
        area = (columns * (nearer - 0.5 * fall * (columns - 1)) - cut * nearer) - cut_end * (
            nearer - fall * (columns - 1)
        )
        share = np.float32(1 / (area * per_px))
        weights[i, :columns] = share
        weights[i, 0] -= share * np.float32(cut)
        weights[i, columns - 1] -= share * np.float32(cut_end)
    return first, weights


@njit(cache=True, fastmath=True, error_model="numpy")
def _row_until(row, start, slope, columns):
    """Up to which column of pixels the line start + slope x stays in this row of pixels."""
    if slope > 0:
        return min(math.ceil((row + 1 - start) / slope), columns)
    if slope < 0:
        return min(math.floor((row - start) / slope) + 1, columns)
    return columns


@njit(cache=True, fastmath=True, error_model="numpy")
def _between(above, below, upper, lower, start, slope, ends, end_slope, ramp, out):
    """What columns of pixels show between two lines that each stay in a row of pixels.

    `above`, `below`: the sums over those rows; `upper`, `lower`: the rows themselves, of which parts count.
    """
    for n in range(len(out)):
        x = ramp[n]
        out[n] = (
            np.float32(np.uint16(below[n] - above[n]))
            + (ends + end_slope * x) * np.float32(lower[n])
            - (start + slope * x) * np.float32(upper[n])
        )


@njit(cache=True, fastmath=True, error_model="numpy")
def _strip(image, part, sums, left, start, slope, end, end_slope, ramp, out):
    """The sum of every column of pixels between the lines start + slope x and end + end_slope x; rows of the part, and
    columns from `left` of it on."""
    x, columns, last = 0, len(out), len(sums) - 2
    while x < columns:
        row, end_row = math.floor(start + slope * x), math.floor(end + end_slope * x)
        until = min(_row_until(row, start, slope, columns), _row_until(end_row, end, end_slope, columns))
        until = max(until, x + 1)
        row, end_row = min(max(row, 0), last), min(max(end_row, 0), last)
        upper, lower = image[part[TOP] + row, part[LEFT] :], image[part[TOP] + end_row, part[LEFT] :]
        first, beyond = left + x, left + until
        _between(
            sums[row, first:beyond], sums[end_row, first:beyond], upper[first:beyond], lower[first:beyond],
            np.float32(start + slope * x - row), np.float32(slope),
            np.float32(end + end_slope * x - end_row), np.float32(end_slope), ramp, out[x:until],
        )  # fmt: skip
        x = until


@njit(cache=True, fastmath=True, error_model="numpy")
def read_cells(image, part, sums, placement, horizon_px, patch):
    """The mean of every cell of a placement that lies in the image, and in this part of it, into `patch`, float32
    (cells, cells). `sums`: see `sums_down`."""
    cells = len(patch)
    first, weights = _columns_of(placement, part[LEFT], cells)
    left = np.int64(first[0])
    columns = min(np.int64(first[-1]) + weights.shape[1], sums.shape[1]) - left
    ramp, strips = np.arange(columns).astype(np.float32), np.zeros((ABREAST, columns + weights.shape[1]), np.float32)
    for i in range(cells):
        first[i] -= np.uint32(left)
    away = part[LEFT] + left - placement[X]
    start = start_slope = 0.0
    for j in range(cells + 1):
        below_horizon = placement[Y] - horizon_px + placement[HEIGHT] * (j / cells - 0.5)
        slope = -below_horizon * placement[KEYSTONE] / placement[WIDTH]
        end = horizon_px + 0.5 + below_horizon + slope * away - part[TOP]
        if j > 0:
            strip = strips[(j - 1) % ABREAST, :columns]
            _strip(image, part, sums, left, start, start_slope, end, slope, ramp, strip)
            if j % ABREAST == 0 or j == cells:
                _gather(strips, first, weights, patch[(j - 1) // ABREAST * ABREAST : j])
        start, start_slope = end, slope


@njit(cache=True, fastmath=True, error_model="numpy")
def _gather(strips, first, weights, out):
    """The weighted sums of the columns of pixels under each cell, for at most four rows of cells at once."""
    columns, rows = weights.shape[1], len(out)
    for i in range(len(first)):
        one = two = three = four = np.float32(0)
        for t in range(columns):
            weight, n = weights[i, t], first[i] + np.uint32(t)
            one += weight * strips[0, n]
            two += weight * strips[1, n]
            three += weight * strips[2, n]
            four += weight * strips[3, n]
        out[0, i] = one
        if rows == ABREAST:
            out[1, i], out[2, i], out[3, i] = two, three, four
        elif rows > 1:
            out[1, i] = two
            if rows > 2:
                out[2, i] = three


@njit(cache=True, fastmath=True, error_model="numpy")
def read_inside(image, placement, horizon_px, patch):
    """`read_cells` of this placement alone; False, and nothing read, where not all of it lies in the image."""
    if not is_inside(image, placement, horizon_px, len(patch)):
        return False
    part = part_about(image, placement, horizon_px, 0.0)
    read_cells(image, part, sums_down(image, part), placement, horizon_px, patch)
    return True
