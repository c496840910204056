"""The compiled inner loops of the landmark look-up. What is left to the matrix products of BLAS is not in here."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, fastmath=True)
def gather_profiles(cells, offsets, widths, tops, side, bands, profiles, starts):
    """Profiles of all windows whose uppermost row is `tops[n]` of level n, starting at every second cell.

    `cells`: the levels one after the other, float32, level n row by row from `offsets[n]` on, `widths[n]` cells wide.
    A negative top leaves a level out. A window is side x side cells; a profile is the sum over a row band or a column
    band of it; side / bands is even. `profiles`: (side, 2 * bands, positions) float32. `starts`: where each level's
    positions start; one more at the end.
    """
    depth = side // bands
    first = 0
    for level in range(len(widths)):
        starts[level] = first
        width = widths[level]
        if tops[level] < 0 or width < side:
            continue
        count = (width - side) // 2 + 1
        origin = offsets[level] + tops[level] * width
        rows = cells[origin : origin + side * width].reshape(side, width)
        even, odd = np.empty(width // 2 + 1, np.float32), np.empty(width // 2 + 1, np.float32)
        for b in range(bands):
            for x in range(count + side // 2 - 1):  # neighbouring positions are two cells apart: even and odd cells
                total_even, total_odd = np.float32(0.0), np.float32(0.0)
                for y in range(b * depth, (b + 1) * depth):
                    total_even += rows[y, 2 * x]
                    total_odd += rows[y, 2 * x + 1]
                even[x], odd[x] = total_even, total_odd
            for j in range(side // 2):
                profiles[2 * j, b, first : first + count] = even[j : j + count]
                profiles[2 * j + 1, b, first : first + count] = odd[j : j + count]
        for y in range(side):
            for x in range(count + (side - depth) // 2):
                total = np.float32(0.0)
                for j in range(depth):
                    total += rows[y, 2 * x + j]
                even[x] = total
            for b in range(bands):
                begin = b * depth // 2
                profiles[y, bands + b, first : first + count] = even[begin : begin + count]
        first += count
    starts[len(widths)] = first


@njit(cache=True, fastmath=True)
def inverse_lengths(read, inverse):
    """1 / length of every column of `read` (numbers, positions); next to 0 where the window is flat."""
    inverse[:] = np.float32(1e-2)
    for i in range(read.shape[0]):
        line = read[i]
        for k in range(read.shape[1]):
            inverse[k] += line[k] * line[k]
    for k in range(read.shape[1]):
        inverse[k] = np.float32(1.0) / np.sqrt(inverse[k])


@njit(cache=True, fastmath=True)
def best_positions(products, inverse, first, starts, low, high, best, best_score):
    """Of each row of `products` (landmarks, positions) the best position in levels low..high; -1 if there is none.

    A score is the product times `inverse`, see above. `products` begin with position `first`; `starts`: as
    `gather_profiles` fills it.
    """
    for i in range(products.shape[0]):
        best[i] = -1
        highest = np.float32(-1.0)
        line = products[i]
        for k in range(starts[low[i]], starts[high[i]]):
            score = line[k - first] * inverse[k]
            if score > highest:
                highest = score
                best[i] = k
        best_score[i] = highest
