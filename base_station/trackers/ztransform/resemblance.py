"""How sure one can be that an aligned patch is the learned one: the compiled loops; see the README, section 6.

A patch (cells, cells) is cut into square blocks, numbered row by row. The better half of them decides, up to half may
be covered. `reference.py` has the plain meaning.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y, inner

NOISE = 0.5
"""Grey levels squared a cell, added to a block's energy: what is faint does not count as like or unlike."""
MOST_NOISE = 0.4
"""Of a block's energy that is taken for noise."""
FLOOR_SHARE, FLOOR = 0.5, 0.1
"""A slope is divided by its size plus a share of the patch's mean slope plus grey levels a cell: its direction."""


@njit(cache=True, fastmath=True, error_model="numpy")
def sum_blocks(values, out):
    """Of a row of blocks, of which the columns of cells are summed up already, the sum of each block."""
    side = len(values) // len(out)
    for b in range(len(out)):
        total = np.float32(0)
        for i in range(side):
            total += values[b * side + i]
        out[b] = total


@njit(cache=True, fastmath=True, error_model="numpy")
def slope_directions(patch, slopes, scales):
    """Central differences along the rows and down, into `slopes` (2, cells, cells), of length below 1: their
    directions. Into `scales` (cells, cells): by what each was multiplied.

    Faint slopes are shorter. The outermost cells have none.
    """
    cells = len(patch)
    half, total = np.float32(0.5), np.float32(0)
    slopes[:, 0], slopes[:, -1], scales[0], scales[-1] = 0, 0, 0, 0
    for y in range(1, cells - 1):
        above, here, below = patch[y - 1], patch[y], patch[y + 1]
        across, down, sizes = slopes[0, y], slopes[1, y], scales[y]
        for x in range(1, cells - 1):
            one, two = half * (here[x + 1] - here[x - 1]), half * (below[x] - above[x])
            across[x], down[x] = one, two
            sizes[x] = math.sqrt(one * one + two * two)
        across[0] = across[-1] = down[0] = down[-1] = sizes[0] = sizes[-1] = np.float32(0)
        for x in range(cells):
            total += sizes[x]
    floor = np.float32(FLOOR_SHARE) * total / np.float32((cells - 2) ** 2) + np.float32(FLOOR)
    for y in range(1, cells - 1):
        across, down, sizes = slopes[0, y], slopes[1, y], scales[y]
        for x in range(cells):
            scale = np.float32(1) / (sizes[x] + floor)
            across[x] *= scale
            down[x] *= scale
            sizes[x] = scale
        sizes[0] = sizes[-1] = np.float32(0)


@njit(cache=True, fastmath=True, error_model="numpy")
def compare_slopes(slopes, learned, compared):
    """Of each block the product of its slopes' directions with the learned ones, and their energy; (2, blocks)."""
    cells, blocks = slopes.shape[1], round(math.sqrt(compared.shape[1]))
    side = cells // blocks
    products, energies = np.empty(cells, np.float32), np.empty(cells, np.float32)
    for row in range(blocks):
        products[:] = energies[:] = np.float32(0)
        for y in range(row * side, (row + 1) * side):
            across, down, then_across, then_down = slopes[0, y], slopes[1, y], learned[0, y], learned[1, y]
            for x in range(cells):
                products[x] += across[x] * then_across[x] + down[x] * then_down[x]
                energies[x] += across[x] * across[x] + down[x] * down[x]
        sum_blocks(products, compared[0, row * blocks : (row + 1) * blocks])
        sum_blocks(energies, compared[1, row * blocks : (row + 1) * blocks])


@njit(cache=True, fastmath=True, error_model="numpy")
def energy_of(values, out):
    """The sum of squares of the values (cells, cells) in each block, into `out` (blocks,)."""
    blocks = round(math.sqrt(len(out)))
    side, row_sum = len(values) // blocks, np.empty(len(values), np.float32)
    for row in range(blocks):
        row_sum[:] = np.float32(0)
        for y in range(row * side, (row + 1) * side):
            line = values[y]
            for x in range(len(line)):
                row_sum[x] += line[x] * line[x]
        sum_blocks(row_sum, out[row * blocks : (row + 1) * blocks])


@njit(cache=True, fastmath=True, error_model="numpy")
def best_part(likeness, weights, part):
    """Weighted mean of the most alike blocks, which together have this part of the weight."""
    whole = weights.sum()
    if whole <= 0:
        return 0.0
    if part >= 1:
        return inner(weights, likeness) / whole
    order = np.argsort(-likeness)
    total, sum_of = 0.0, 0.0
    for b in order:
        weight = min(weights[b], part * whole - total)
        sum_of += weight * likeness[b]
        total += weight
        if total >= part * whole:
            break
    return sum_of / (part * whole)


@njit(cache=True, fastmath=True, error_model="numpy")
def resemblance(patch, compared, energies, learned_slopes, slope_energies, part, alike, noise):
    """How much a patch is like the learned one, and the share of it that is; both 0..1.

    The product of three: the blocks' correlations and those of their slopes' directions, each over the best `part` of
    the blocks, and, at half weight, the latter over all blocks. Directions know finer detail, faint as well as strong:
    a mirror image has but the first. `noise`: standard deviation of a cell; the energy that it adds, up to
    MOST_NOISE of a block's, does not count against the likeness.
    """
    blocks, cells = len(energies), len(patch)
    slopes, scales = np.empty((2, cells, cells), np.float32), np.empty((cells, cells), np.float32)
    slope_directions(patch, slopes, scales)
    directions, added = np.empty((2, blocks), np.float32), np.zeros(blocks, np.float32)
    compare_slopes(slopes, learned_slopes, directions)
    if noise > 0:
        energy_of(scales, added)
    size, left = np.float32(cells**2 // blocks), np.float32(1 - MOST_NOISE)
    variance, faint, tiny = np.float32(noise * noise), np.float32(NOISE) * size, np.float32(1e-6)
    light, fine = np.empty(blocks, np.float32), np.empty(blocks, np.float32)
    light_weights, fine_weights = np.zeros(blocks, np.float32), np.zeros(blocks, np.float32)
    total, agreed = np.float32(0), np.float32(0)
    for b in range(blocks):
        energy = directions[1, b] + tiny
        energy = max(energy - variance * added[b], left * energy)
        fine[b] = min(directions[0, b] / math.sqrt(energy * slope_energies[b] + tiny), np.float32(1))
        square = max(compared[1, b], np.float32(0))
        square = max(square - variance * size, left * square)
        light[b] = min(compared[0, b] / math.sqrt((energies[b] + faint) * (square + faint)), np.float32(1))
        if compared[1, b] >= 0:
            light_weights[b], fine_weights[b] = math.sqrt(energies[b]), math.sqrt(slope_energies[b])
            total += light_weights[b]
            agreed += light_weights[b] if light[b] > alike else np.float32(0)
    if total <= 0:
        return 0.0, 0.0
    light_part, fine_part = best_part(light, light_weights, part), best_part(fine, fine_weights, part)
    whole = max(best_part(fine, fine_weights, 1.0), 0.0)
    return max(light_part, 0.0) * max(fine_part, 0.0) * (0.5 + 0.5 * whole), float(agreed / total)


@njit(cache=True, error_model="numpy")
def pixel_noise(image, placement):
    """Standard deviation of the pixels' noise in every eighth row of the target, by second differences; 0 if few."""
    x, y, width, height = placement[X], placement[Y], placement[WIDTH], placement[HEIGHT]
    top, bottom = max(int(y - height / 2), 0), min(max(int(y + height / 2), 0), image.shape[0])
    left, right = max(int(x - width / 2), 0), min(max(int(x + width / 2), 0), image.shape[1])
    counts, n = np.zeros(1021, np.int64), 0
    for row in range(top, bottom, 8):
        line = image[row]
        for column in range(left + 1, right - 1):
            fine = np.int64(line[column - 1]) - 2 * np.int64(line[column]) + np.int64(line[column + 1])
            counts[abs(fine)] += 1
            n += 1
    if n == 0:
        return 0.0
    median = 0.5 * (_ranked(counts, (n - 1) // 2) + _ranked(counts, n // 2))
    return 1.4826 * median / math.sqrt(6.0)


@njit(cache=True, error_model="numpy")
def _ranked(counts, rank):
    """Of numbers counted by their value, the one with so many before it."""
    value, before = 0, counts[0]
    while before <= rank:
        value += 1
        before += counts[value]
    return value
