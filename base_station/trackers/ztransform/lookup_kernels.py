"""The compiled inner loops of the landmark look-up. What is left to the matrix products of BLAS is not in here.

Windows are side x side cells, start at every second cell, and are read in bands of side / 3: three bands of rows and
three of columns. Windows four rows apart share two of their bands of rows, windows four columns apart two of their
bands of columns; so bands are read first, each once, and windows put together from them.

`levels` is what `windows.Levels` says of the frame, int64 (levels, 4): where the level's cells begin, its height, its
width, and the first row that bands may start at.
"""

from __future__ import annotations

import numpy as np
from numba import njit

CELLS, HIGH, WIDE, FIRST_ROW = range(4)
"""Columns of `levels`."""
BANDS = 3
COLUMN_STEP = 2
"""In cells: how far apart the windows are that are looked at."""
SLOPES_SIDE = 12
"""Of the windows whose slopes are compared, in cells."""
SLOPES_SIZE = SLOPES_SIDE**2
"""Room for the slopes along one axis."""


@njit(cache=True)
def spots(wide, side):
    """How many places there are for a band of columns in a level; the last few have no room for a whole window."""
    return (wide - side // BANDS) // COLUMN_STEP + 1


@njit(cache=True, fastmath=True, error_model="numpy")
def gather_bands(cells, levels, begins, taps):
    """Profiles of all bands of windows that are asked for, side by side.

    `cells`: the levels one after the other, float32. `begins` (2, levels, rows): where in `taps` a band of rows, and
    the bands of columns, of the windows begin whose uppermost row is FIRST_ROW + row * side / 3; -1 where nobody asks.
    `taps`: float32 (side, bands' places).
    """
    side = taps.shape[0]
    depth = side // BANDS
    for level in range(len(levels)):
        wide, high = levels[level, WIDE], levels[level, HIGH]
        count, first_row = spots(wide, side), levels[level, FIRST_ROW]
        here = cells[levels[level, CELLS] : levels[level, CELLS] + high * wide].reshape(high, wide)
        even, odd = np.zeros((high, count + side), np.float32), np.zeros((high, count + side), np.float32)
        for y in range(high):
            line, one, two = here[y], even[y], odd[y]
            for x in range(wide // 2):
                one[x] = line[2 * x]
                two[x] = line[2 * x + 1]
        for row in range(begins.shape[2]):
            top, begin = first_row + row * depth, begins[0, level, row]
            if begin >= 0:
                _sum_down(even[top : top + depth], taps[0::2, begin : begin + count])
                _sum_down(odd[top : top + depth], taps[1::2, begin : begin + count])
            begin = begins[1, level, row]
            if begin >= 0:
                for t in range(side):
                    line, one, two = taps[t, begin : begin + count], even[top + t], odd[top + t]
                    for x in range(count):
                        line[x] = one[x] + two[x]
                    for x in range(count):
                        line[x] += one[x + 1] + two[x + 1]


@njit(cache=True, fastmath=True, error_model="numpy")
def _sum_down(rows, taps):
    """taps[t, x] = sum over the rows, at column x + t."""
    count = taps.shape[1]
    total = np.zeros(rows.shape[1], np.float32)
    for y in range(len(rows)):
        line = rows[y]
        for x in range(len(total)):
            total[x] += line[x]
    for t in range(len(taps)):
        taps[t, :] = total[t : t + count]


@njit(cache=True, fastmath=True, error_model="numpy")
def put_together(read, power, levels, begins, rows, side, starts, out):
    """Descriptors, of length 1, of all windows in row `rows[n]` of level n; -1 leaves a level out.

    `read` (numbers, bands' places): what the bands' profiles were read as, `power`: the sum of its squares; `begins`:
    see `gather_bands`. `out`: float32 (2 * BANDS * numbers, at least as many as there are windows), `starts`: where
    each level's windows start in it; one more at the end. For each number bands of rows come first, then of columns.
    """
    numbers, step = read.shape[0], side // BANDS // COLUMN_STEP
    first = 0
    places = np.empty(2 * BANDS, np.int64)
    for level in range(len(levels)):
        starts[level] = first
        if rows[level] < 0:
            continue
        windows = spots(levels[level, WIDE], side) - (BANDS - 1) * step
        for b in range(BANDS):
            places[b] = begins[0, level, rows[level] + b]
            places[BANDS + b] = begins[1, level, rows[level]] + b * step
        gain = np.full(windows, np.float32(1e-2))  # a flat window is next to 0
        for b in range(2 * BANDS):
            part = power[places[b] : places[b] + windows]
            for x in range(windows):
                gain[x] += part[x]
        for x in range(windows):
            gain[x] = np.float32(1.0) / np.sqrt(gain[x])
        for f in range(numbers):
            for b in range(2 * BANDS):
                part = read[f, places[b] : places[b] + windows]
                line = out[2 * BANDS * f + b, first : first + windows]
                for x in range(windows):
                    line[x] = part[x] * gain[x]
        first += windows
    starts[len(levels)] = first


@njit(cache=True, fastmath=True, error_model="numpy")
def power_of(read, power):
    """The sum of squares of every column of `read`."""
    power[:] = np.float32(0.0)
    for f in range(len(read)):
        line = read[f]
        for x in range(len(power)):
            power[x] += line[x] * line[x]


@njit(cache=True, fastmath=True, error_model="numpy")
def best_windows(products, first, starts, low, high, score, level, column):
    """Of each row of `products` (landmarks, windows) the best window in levels low..high, its level and first column.

    `products` begin with window `first`; `starts`: as `put_together` fills it. Score and level are -1 if there is none.
    """
    for i in range(products.shape[0]):
        score[i], level[i], column[i] = np.float32(-1.0), -1, 0
        line = products[i]
        for n in range(low[i], high[i]):
            part = line[starts[n] - first : starts[n + 1] - first]
            highest = np.float32(-1.0)
            for k in range(len(part)):
                highest = max(highest, part[k])
            if highest > score[i]:
                score[i], level[i] = highest, n
        if level[i] >= 0:
            part = line[starts[level[i]] - first : starts[level[i] + 1] - first]
            for k in range(len(part)):
                if part[k] == score[i]:
                    column[i] = COLUMN_STEP * k
                    break


@njit(cache=True, fastmath=True, error_model="numpy")
def _slopes_of(cells, across, down):
    """Central differences across (two columns less than there are cells) and down (two rows less), flat, row by row."""
    side = cells.shape[0]
    for y in range(side):
        line, out = cells[y], across[y * (side - 2) : (y + 1) * (side - 2)]
        for x in range(side - 2):
            out[x] = line[x + 2] - line[x]
    for y in range(side - 2):
        above, below, out = cells[y], cells[y + 2], down[y * side : (y + 1) * side]
        for x in range(side):
            out[x] = below[x] - above[x]


@njit(cache=True, fastmath=True, error_model="numpy")
def _part(values, begin, weights):
    """sum_i values[begin + i] weights[i]."""
    total, part = np.float32(0.0), values[begin : begin + SLOPES_SIZE]
    for i in range(SLOPES_SIZE):
        total += part[i] * weights[i]
    return total


@njit(cache=True, fastmath=True, error_model="numpy")
def compare_slopes(cells, levels, level, top, column, known, which, score, off):
    """Cosine between the slopes of windows' cells and those of landmarks, the best within +-1 cell.

    `level`, `top`, `column`: of each window. `known`: float32 (landmarks' windows, 2, SLOPES_SIZE), see
    `windows.known_slopes`; `which` of them belongs to each window. `score`: the cosine, `off` (windows, 2): how many
    cells further right and down it was found.
    """
    side, around = SLOPES_SIDE, SLOPES_SIDE + 2
    masks = np.zeros((2, SLOPES_SIZE), np.float32)
    for y in range(side):
        masks[0, y * side : y * side + side - 2] = np.float32(1.0)
    for y in range(side - 2):
        masks[1, y * around : y * around + side] = np.float32(1.0)
    square = np.empty((around, around), np.float32)
    slopes = np.zeros((2, SLOPES_SIZE + 2 * around + 2), np.float32)
    squares = np.zeros_like(slopes)
    for i in range(len(score)):
        wide, high = levels[level[i], WIDE], levels[level[i], HIGH]
        begin = levels[level[i], CELLS]
        here = cells[begin : begin + high * wide].reshape(high, wide)
        for y in range(around):
            line = here[min(max(top[i] + y - 1, 0), high - 1)]
            for x in range(around):
                square[y, x] = line[min(max(column[i] + x - 1, 0), wide - 1)]
        _slopes_of(square, slopes[0], slopes[1])
        for axis in range(2):
            one, two = slopes[axis], squares[axis]
            for n in range(len(one)):
                two[n] = one[n] * one[n]
        score[i] = np.float32(-1.0)
        for y in range(3):
            for x in range(3):
                power, product = np.float32(1e-3), np.float32(0.0)
                for axis in range(2):
                    first = y * (side if axis == 0 else around) + x
                    power += _part(squares[axis], first, masks[axis])
                    product += _part(slopes[axis], first, known[which[i], axis])
                cosine = product / np.sqrt(power)
                if cosine > score[i]:
                    score[i] = cosine
                    off[i, 0], off[i, 1] = x - 1, y - 1
