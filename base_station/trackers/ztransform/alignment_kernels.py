"""The compiled inner loops of alignment: how a patch differs from the learned one, block by block.

A patch is cut into square blocks, each flat: (blocks, cells of a block). Each block has its own offset and gain of
light; what is learned of a block is its deviation from its mean, and how that changes with the five parts of a step,
less what a change of gain would do as well. `reference.py` has the plain meaning.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from base_station.trackers.ztransform.boxes import IN_FRAME, lies, sample_boxes, sample_inside
from base_station.trackers.ztransform.kernels import FREEDOMS, HEIGHT, WIDTH, X, Y, inner, move
from base_station.trackers.ztransform.refinement import MORE_TO_READ

ROUNDING = 0.02
"""Grey levels squared: a block's misfit is never taken for less."""
NOISE = 0.5
"""Grey levels squared a cell, added to a block's energy: what is faint does not count as like or unlike."""
LEAST_GAIN, LARGEST_GAIN = 0.05, 3.0
"""Of light: the whole patch's is at least the one, a block's at most the other times the whole patch's."""
MOST_NOISE = 0.4
"""Of a block's energy that is taken for noise."""
FLOOR_SHARE, FLOOR = 0.5, 0.1
"""A slope is divided by its size plus a share of the patch's mean slope plus grey levels a cell: its direction."""


@njit(cache=True)
def cut_blocks(patch, blocks):
    """The patch (cells, cells) as (blocks * blocks, flat), each block row by row."""
    side = patch.shape[0] // blocks
    out = np.empty((blocks * blocks, side * side), patch.dtype)
    for top in range(blocks):
        for left in range(blocks):
            block = out[top * blocks + left]
            for y in range(side):
                for x in range(side):
                    block[y * side + x] = patch[top * side + y, left * side + x]
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def compare_blocks(cut, shown, learned, energies):
    """Of each block: gain-wise product with the learned one, energy about its mean, and the mean; (blocks, 3).

    `shown`: uint8 as `cut`, 0 where the frame ends. A block that is not shown whole has energy -1.
    """
    out = np.empty((len(cut), 3), np.float32)
    for b in range(len(cut)):
        total, square, product, whole = np.float32(0), np.float32(0), np.float32(0), 0
        for i in range(cut.shape[1]):
            total += cut[b, i]
            whole += shown[b, i]
        mean = total / np.float32(cut.shape[1])
        for i in range(cut.shape[1]):
            d = cut[b, i] - mean
            square += d * d
            product += d * learned[b, i]
        out[b, 0], out[b, 1], out[b, 2] = product, square if whole == cut.shape[1] else -1.0, mean
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def robust_step(cut, compared, learned, energies, changes, hessians, prior, step):
    """The step that brings the placement to the learned one, into `step`; False when no block is shown whole.

    Least squares over all blocks. A block counts the less, the worse it fits whatever its light: what covers a part of
    the target fits nowhere. `changes`: (blocks, 5, cells of a block), `hessians`: (blocks, 5, 5) of them. `prior`: (5,)
    1 / variance of a step, against the misfit's variance.
    """
    blocks, freedom = len(cut), cut.shape[1] - 2
    misfits, gains = np.empty(blocks, np.float32), np.empty(blocks, np.float32)
    strong = np.median(energies)
    n, firm = 0, 0
    shown_misfits, shown_gains = np.empty(blocks, np.float32), np.empty(blocks, np.float32)
    for b in range(blocks):
        gain = compared[b, 0] / (energies[b] + np.float32(1e-3))
        misfits[b] = max(compared[b, 1] - gain * compared[b, 0], np.float32(0)) / freedom
        if compared[b, 1] >= 0:
            shown_misfits[n] = misfits[b]
            n += 1
            if energies[b] > strong:
                shown_gains[firm] = gain
                firm += 1
    if n == 0:
        return False
    usual = np.median(shown_misfits[:n]) + ROUNDING
    whole_gain = LEAST_GAIN
    if firm > 0:
        whole_gain = max(float(np.median(shown_gains[:firm])), LEAST_GAIN)
    trust = 0.2 * strong + 1e-3
    for b in range(blocks):
        gain = (compared[b, 0] + trust * whole_gain) / (energies[b] + trust)
        gains[b] = min(max(gain, 0.0), LARGEST_GAIN * whole_gain)
    hessian, slope = np.zeros((FREEDOMS, FREEDOMS)), np.zeros(FREEDOMS)
    for k in range(FREEDOMS):
        hessian[k, k] = prior[k] * usual
    for b in range(blocks):
        if compared[b, 1] < 0:
            continue
        weight = usual / (misfits[b] + usual) * gains[b]
        for k in range(FREEDOMS):
            product = np.float32(0)
            for i in range(cut.shape[1]):
                product += changes[b, k, i] * cut[b, i]
            slope[k] -= weight * product
            for j in range(k + 1):
                hessian[k, j] += weight * gains[b] * hessians[b, k, j]
    solve(hessian, slope, step)
    return True


@njit(cache=True, fastmath=True, error_model="numpy")
def solve(matrix, right, out):
    """matrix @ out = right, for a positive definite matrix, of which the lower half is enough: Cholesky. Overwrites the
    matrix. (numba's needs SciPy.)"""
    n = len(right)
    for j in range(n):
        for k in range(j):
            matrix[j, j] -= matrix[j, k] * matrix[j, k]
        matrix[j, j] = math.sqrt(max(matrix[j, j], 1e-12))
        for i in range(j + 1, n):
            for k in range(j):
                matrix[i, j] -= matrix[i, k] * matrix[j, k]
            matrix[i, j] /= matrix[j, j]
    for i in range(n):
        out[i] = right[i]
        for k in range(i):
            out[i] -= matrix[i, k] * out[k]
        out[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            out[i] -= matrix[k, i] * out[k]
        out[i] /= matrix[i, i]


@njit(cache=True, fastmath=True, error_model="numpy")
def slope_directions(patch):
    """Central differences along the rows and down, float32 (2, cells, cells), of length below 1: their directions.

    Faint slopes are shorter. The outermost cells have none. And (cells, cells): by what each slope was multiplied.
    """
    cells = patch.shape[0]
    out, scales = np.zeros((2, cells, cells), np.float32), np.zeros((cells, cells), np.float32)
    half, total = np.float32(0.5), np.float32(0)
    for y in range(1, cells - 1):
        for x in range(1, cells - 1):
            across, down = half * (patch[y, x + 1] - patch[y, x - 1]), half * (patch[y + 1, x] - patch[y - 1, x])
            out[0, y, x], out[1, y, x] = across, down
            total += math.sqrt(across * across + down * down)
    floor = np.float32(FLOOR_SHARE) * total / np.float32((cells - 2) ** 2) + np.float32(FLOOR)
    for y in range(1, cells - 1):
        for x in range(1, cells - 1):
            across, down = out[0, y, x], out[1, y, x]
            scale = np.float32(1) / (math.sqrt(across * across + down * down) + floor)
            out[0, y, x], out[1, y, x], scales[y, x] = across * scale, down * scale, scale
    return out, scales


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
    blocks = len(compared)
    side = round(math.sqrt(blocks))
    slopes, scales = slope_directions(patch)
    across, down = cut_blocks(slopes[0], side), cut_blocks(slopes[1], side)
    scale = cut_blocks(scales, side) if noise > 0 else across
    variance = np.float32(noise * noise)
    light, fine = np.empty(blocks, np.float32), np.empty(blocks, np.float32)
    light_weights, fine_weights = np.zeros(blocks, np.float32), np.zeros(blocks, np.float32)
    faint = np.float32(NOISE * across.shape[1])
    total, agreed = 0.0, 0.0
    for b in range(blocks):
        product, energy, added = np.float32(0), np.float32(1e-6), np.float32(0)
        for i in range(across.shape[1]):
            product += across[b, i] * learned_slopes[0, b, i] + down[b, i] * learned_slopes[1, b, i]
            energy += across[b, i] * across[b, i] + down[b, i] * down[b, i]
            added += variance * scale[b, i] * scale[b, i]
        energy = max(energy - added, (np.float32(1) - np.float32(MOST_NOISE)) * energy)
        fine[b] = min(product / math.sqrt(energy * slope_energies[b] + np.float32(1e-6)), np.float32(1))
        square = max(compared[b, 1], np.float32(0))
        square = max(square - variance * across.shape[1], (np.float32(1) - np.float32(MOST_NOISE)) * square)
        light[b] = min(compared[b, 0] / math.sqrt((energies[b] + faint) * (square + faint)), np.float32(1))
        if compared[b, 1] >= 0:
            light_weights[b], fine_weights[b] = math.sqrt(energies[b]), math.sqrt(slope_energies[b])
            total += light_weights[b]
            agreed += light_weights[b] if light[b] > alike else 0.0
    if total <= 0:
        return 0.0, 0.0
    light_part, fine_part = best_part(light, light_weights, part), best_part(fine, fine_weights, part)
    whole = max(best_part(fine, fine_weights, 1.0), 0.0)
    return max(light_part, 0.0) * max(fine_part, 0.0) * (0.5 + 0.5 * whole), agreed / total


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


@njit(cache=True, fastmath=True, error_model="numpy")
def settle(
    table, where, lens, placement, image, learned, energies, changes, hessians, slopes, slope_energies, prior,
    cells, steps, repeat_px, largest_step, judged_part, alike, noisy_below, fewest_pixels,
):  # fmt: skip
    """Improve `placement` in place by at most so many steps; returns confidence, share of it in the frame, share alike.

    Read, compare, step; again while a step is longer than `repeat_px`. A share of MORE_TO_READ: the placement left the
    table, go on with one of the whole frame. `image`: the frame, whose noise is measured where confidence is below
    `noisy_below`.
    """
    is_whole = table.shape[1] - 1 >= where[3] and table.shape[0] - 1 >= where[4]
    blocks = round(math.sqrt(len(learned)))
    patch, seen, step = np.empty((cells, cells), np.float32), np.ones((cells, cells), np.uint8), np.zeros(FREEDOMS)
    shown = cut_blocks(seen, blocks)
    compared, share = np.empty((len(learned), 3), np.float32), 1.0
    for turn in range(steps + 1):
        if lies(table, where, lens, placement) == IN_FRAME:
            sample_inside(table, where, lens, placement, patch)
            if share < 1:
                share, shown[:] = 1.0, 1
        elif not is_whole:
            return 0.0, MORE_TO_READ, 0.0
        else:
            share = sample_boxes(table, where, lens, placement, patch, seen)
            shown = cut_blocks(seen, blocks)
        cut = cut_blocks(patch, blocks)
        compared = compare_blocks(cut, shown, learned, energies)
        if turn == steps:
            break
        step[:] = 0.0
        robust_step(cut, compared, learned, energies, changes, hessians, prior, step)
        move(placement, step, largest_step)
        if math.hypot(step[X] * placement[WIDTH], step[Y] * placement[HEIGHT]) < repeat_px:
            break
    confidence, seen_alike = resemblance(
        patch, compared, energies, slopes, slope_energies, judged_part, alike, 0.0
    )  # fmt: skip
    pixels = placement[WIDTH] * placement[HEIGHT] / cells**2
    if confidence < noisy_below and pixels >= fewest_pixels:
        noise = pixel_noise(image, placement) / math.sqrt(pixels)
        confidence, seen_alike = resemblance(
            patch, compared, energies, slopes, slope_energies, judged_part, alike, noise
        )  # fmt: skip
    return confidence, share, seen_alike
