"""The compiled inner loops of alignment: how a patch differs from the learned one, block by block.

A patch (cells, cells) is cut into square blocks, numbered row by row. Each block has its own offset and gain of
light; what is learned of a block is its deviation from its mean, and how that changes with the five parts of a step
and with appearance, less what a change of gain would do as well. All of that lies cell by cell as the patch does, so
that whole rows of cells are reckoned side by side; only their sums are cut into blocks. `reference.py` has the plain
meaning.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from base_station.trackers.ztransform.boxes import sample_boxes
from base_station.trackers.ztransform.cells import covers, is_inside, part_about, read_cells, sums_down
from base_station.trackers.ztransform.kernels import FREEDOMS, HEIGHT, WIDTH, X, Y, inner, move
from base_station.trackers.ztransform.resemblance import pixel_noise, resemblance, sum_blocks

ROUNDING = 0.02
"""Grey levels squared: a block's misfit is never taken for less."""
LEAST_GAIN, LARGEST_GAIN = 0.05, 3.0
"""Of light: the whole patch's is at least the one, a block's at most the other times the whole patch's."""
LEAST_ALIKE = 0.5
"""Correlation of all blocks with the learned ones, where the target is to be near."""
MOST_LEFT = 0.5
"""Of the way, after a step: a larger share is an accident."""
ANYWHERE_PX = 1e9
"""Fast mathematics know no infinity."""
MARGIN = 0.04
"""Of a target's width and height: how far settling usually goes."""
MORE_TO_READ = -1.0
"""In the place of a share: the placement sticks out of the frame, and no running sums of the whole frame were given."""


@njit(cache=True, fastmath=True, error_model="numpy")
def spread_blocks(values, out):
    """The other way: to every cell of a row of cells the value of its block."""
    side = len(out) // len(values)
    for b in range(len(values)):
        for i in range(side):
            out[b * side + i] = values[b]


@njit(cache=True, fastmath=True, error_model="numpy")
def are_shown(seen, out):
    """Which blocks are shown whole, into `out`, uint8, from which cells are, uint8 (cells, cells)."""
    blocks = round(math.sqrt(len(out)))
    side = len(seen) // blocks
    for b in range(len(out)):
        top, left = b // blocks * side, b % blocks * side
        out[b] = 1
        for y in range(side):
            for x in range(side):
                out[b] &= seen[top + y, left + x]


@njit(cache=True, fastmath=True, error_model="numpy")
def compare_blocks(patch, shown, learned, deviations, compared):
    """Of each block: gain-wise product with the learned one and energy about its mean, into `compared` (2, blocks).

    Into `deviations`: the patch, less each block's mean. A block that is not shown whole has energy -1.
    """
    cells, blocks = len(patch), round(math.sqrt(len(shown)))
    side = cells // blocks
    one, two = np.empty(cells, np.float32), np.empty(cells, np.float32)
    share = np.float32(1 / (side * side))
    for row in range(blocks):
        here = slice(row * blocks, (row + 1) * blocks)
        one[:] = np.float32(0)
        for y in range(row * side, (row + 1) * side):
            line = patch[y]
            for x in range(cells):
                one[x] += line[x]
        sum_blocks(one, compared[0, here])
        spread_blocks(compared[0, here], two)
        for x in range(cells):
            two[x] *= share
        mean = two.copy()
        one[:] = two[:] = np.float32(0)
        for y in range(row * side, (row + 1) * side):
            line, then, out = patch[y], learned[y], deviations[y]
            for x in range(cells):
                away = line[x] - mean[x]
                out[x] = away
                one[x] += away * then[x]
                two[x] += away * away
        sum_blocks(one, compared[0, here])
        sum_blocks(two, compared[1, here])
    for b in range(len(shown)):
        if shown[b] == 0:
            compared[1, b] = np.float32(-1)


@njit(cache=True, fastmath=True, error_model="numpy")
def likeness(compared, energies):
    """Correlation with the learned patch of all blocks that are shown whole, each about its mean."""
    product, square, energy = np.float32(0), np.float32(1e-6), np.float32(1e-6)
    for b in range(len(energies)):
        if compared[1, b] >= 0:
            product += compared[0, b]
            square += compared[1, b]
            energy += energies[b]
    return product / math.sqrt(square * energy)


@njit(cache=True, fastmath=True, error_model="numpy")
def weigh_blocks(deviations, compared, energies, strong, gains):
    """How much each block counts; returns the usual misfit, 0 when no block is shown whole.

    A block counts the less, the worse it fits whatever its light: what covers a part of the target fits nowhere.
    `deviations`: as `compare_blocks` leaves them; they are weighed in place. `strong`: the median of `energies`. Into
    `gains` (blocks,): what the `products` of the learned changes are weighed by.
    """
    blocks, cells = len(energies), len(deviations)
    across = round(math.sqrt(blocks))
    side = cells // across
    misfits, weights = np.empty(blocks, np.float32), np.empty(blocks, np.float32)
    shown_misfits, shown_gains = np.empty(blocks, np.float32), np.empty(blocks, np.float32)
    n, firm = 0, 0
    for b in range(blocks):
        gain = compared[0, b] / (energies[b] + np.float32(1e-3))
        misfits[b] = max(compared[1, b] - gain * compared[0, b], np.float32(0)) / np.float32(side * side - 2)
        if compared[1, b] >= 0:
            shown_misfits[n] = misfits[b]
            n += 1
            if energies[b] > strong:
                shown_gains[firm] = gain
                firm += 1
    if n == 0:
        return np.float32(0)
    usual = np.float32(np.median(shown_misfits[:n]) + ROUNDING)
    whole_gain = np.float32(LEAST_GAIN)
    if firm > 0:
        whole_gain = np.float32(max(float(np.median(shown_gains[:firm])), LEAST_GAIN))
    trust, most = np.float32(0.2 * strong + 1e-3), np.float32(LARGEST_GAIN) * whole_gain
    row_weights = np.empty(cells, np.float32)
    for b in range(blocks):
        gain = (compared[0, b] + trust * whole_gain) / (energies[b] + trust)
        gain = min(max(gain, np.float32(0)), most)
        weight = usual / (misfits[b] + usual) * gain
        weights[b] = weight if compared[1, b] >= 0 else np.float32(0)
        gains[b] = weights[b] * gain
    for row in range(across):
        spread_blocks(weights[row * across : (row + 1) * across], row_weights)
        for y in range(row * side, (row + 1) * side):
            line = deviations[y]
            for x in range(cells):
                line[x] *= row_weights[x]
    return usual


@njit(cache=True, fastmath=True, error_model="numpy")
def least_squares(deviations, gains, usual, changes, products, prior, step):
    """The step that brings the placement to the learned one, into `step`.

    `deviations`, `gains`, `usual`: see `weigh_blocks`. `changes`: (n, cells, cells), those with the step first, the
    others' parts are left out of it; `products`: (n (n + 1) / 2, blocks) of any two, those of the first with itself,
    of the second with the first and with itself, and so on. `prior`: (n,) 1 / variance of a part, against the
    misfit's variance.
    """
    parts, pair = len(changes), 0
    hessian, slope, found = np.empty((parts, parts)), np.empty(parts), np.empty(parts)
    for k in range(parts):
        slope[k] = -inner(changes[k].ravel(), deviations.ravel())
        for j in range(k + 1):
            hessian[k, j] = inner(products[pair], gains)
            pair += 1
        hessian[k, k] += prior[k] * usual
    solve(hessian, slope, found)
    step[:] = found[:FREEDOMS]


@njit(cache=True, fastmath=True, error_model="numpy")
def follow_on(step, before, placement):
    """Lengthen a step, to the side and down, by all the steps that would come after it: of what is blurred each is the
    same share of the one before it (Aitken 1926). In place."""
    width, height = placement[WIDTH] ** 2, placement[HEIGHT] ** 2
    along = step[X] * before[X] * width + step[Y] * before[Y] * height
    share = along / (before[X] ** 2 * width + before[Y] ** 2 * height + 1e-12)
    longer = 1 / (1 - min(max(share, 0.0), MOST_LEFT))
    step[X] *= longer
    step[Y] *= longer


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
def rough_step(image, part, sums, placement, horizon_px, planes, energies, products, strong, prior, step):
    """The first step, on cells twice as large, for a third of the cost, into `step`; returns the `likeness` there."""
    cells, blocks = planes.shape[1], len(energies)
    patch, deviations = np.empty((cells, cells), np.float32), np.empty((cells, cells), np.float32)
    shown, compared = np.ones(blocks, np.uint8), np.empty((2, blocks), np.float32)
    gains = np.empty(blocks, np.float32)
    read_cells(image, part, sums, placement, horizon_px, patch)
    compare_blocks(patch, shown, planes[0], deviations, compared)
    usual = weigh_blocks(deviations, compared, energies, strong, gains)
    least_squares(deviations, gains, usual, planes[3:], products, prior, step)
    return likeness(compared, energies)


@njit(cache=True, fastmath=True, error_model="numpy")
def settle(
    image, table, where, lens, placement, rough_planes, rough_sums, rough_products, rough_strong, rough_prior, planes,
    block_sums, products, strong, prior, steps, repeat_px, exact_px, farthest_px, largest_step, judged_part, alike,
    noisy_below, fewest_pixels,
):  # fmt: skip
    """Improve `placement` in place by at most so many steps; returns confidence, share of it in the frame, share alike.

    First a rough step, where all of it lies in the frame. Then read, compare, step; again while a step is longer than
    `repeat_px`, and once more after a first one that is longer than `exact_px` in so far as what is seen differs from
    what was learned. With `farthest_px` below ANYWHERE_PX the target is taken to be near: confidence is 0 where steps
    lead further away, do not end, or the first look has little in common with it, from where they may lead anywhere.
    `rough_planes` to `prior`: see `alignment`. `table`: running sums of the whole frame, or nothing, and where they
    are (see `boxes`); only a placement that sticks out of the frame needs them. `image`: the frame, whose noise is
    measured where confidence is below `noisy_below`.
    """
    cells, blocks, horizon_px = planes.shape[1], block_sums.shape[1], lens[3]
    learned, slopes, changes = planes[0], planes[1:3], planes[3:]
    energies, slope_energies = block_sums[0], block_sums[1]
    patch, deviations = np.empty((cells, cells), np.float32), np.empty((cells, cells), np.float32)
    shown, compared = np.ones(blocks, np.uint8), np.empty((2, blocks), np.float32)
    gains, before = np.empty(blocks, np.float32), np.zeros(FREEDOMS)
    part, start_x, start_y = part_about(image, placement, horizon_px, 0.0), placement[X], placement[Y]
    sums, is_read, share, step = np.empty((0, 0), np.uint16), False, 1.0, np.zeros(FREEDOMS)
    if is_inside(image, placement, horizon_px, cells // 2):
        part = part_about(image, placement, horizon_px, MARGIN)
        sums, is_read = sums_down(image, part), True
        like = rough_step(
            image, part, sums, placement, horizon_px, rough_planes, rough_sums[0], rough_products, rough_strong,
            rough_prior, step,
        )  # fmt: skip
        if farthest_px < ANYWHERE_PX and like < LEAST_ALIKE:
            return 0.0, share, 0.0
        move(placement, step, largest_step)
    for turn in range(steps + 1):
        if is_inside(image, placement, horizon_px, cells):
            if not is_read or not covers(part, image, placement, horizon_px):
                part = part_about(image, placement, horizon_px, MARGIN)
                sums, is_read = sums_down(image, part), True
            read_cells(image, part, sums, placement, horizon_px, patch)
            if share < 1:
                share, shown[:] = 1.0, 1
        elif len(table) < 2:
            return 0.0, MORE_TO_READ, 0.0
        else:
            seen = np.empty((cells, cells), np.uint8)
            share = sample_boxes(table, where, lens, placement, patch, seen)
            are_shown(seen, shown)
        compare_blocks(patch, shown, learned, deviations, compared)
        if turn == steps:
            if farthest_px < ANYWHERE_PX:
                return 0.0, share, 0.0
            break
        like = likeness(compared, energies)
        if turn == 0 and not is_read and farthest_px < ANYWHERE_PX and like < LEAST_ALIKE:
            return 0.0, share, 0.0
        usual = weigh_blocks(deviations, compared, energies, strong, gains)
        step[:] = 0.0
        if usual > 0:
            least_squares(deviations, gains, usual, changes, products, prior, step)
        long_px = math.hypot(step[X] * placement[WIDTH], step[Y] * placement[HEIGHT])
        if turn > 0:
            follow_on(step, before, placement)
        before[:] = step
        move(placement, step, largest_step)
        if max(abs(placement[X] - start_x), abs(placement[Y] - start_y)) > farthest_px:
            return 0.0, share, 0.0
        if long_px < repeat_px and (turn == steps - 1 or turn > 0 or long_px * (1 - like) < exact_px):
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
