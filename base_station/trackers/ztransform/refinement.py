"""From about where the target is to exactly where: a few steps of the learned maps, wide ones first."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from base_station.trackers.ztransform.boxes import IN_FRAME, lies, read_profiles, sample_boxes
from base_station.trackers.ztransform.kernels import (
    HEIGHT,
    KEYSTONE,
    WIDTH,
    X,
    Y,
    band_means,
    fill_unseen,
    inner,
    match_light,
    move,
    read_bands,
    seen_correlation,
)

LARGEST_STEP = 0.4
LARGEST_KEYSTONE = 0.5
ENOUGH_SEEN = 0.15
NEAR = 0.025
"""A step in all of whose parts a finer map is right."""
MORE_TO_READ = -1.0
"""In the place of a share: the placement left the running sums."""


@njit(cache=True, fastmath=True, error_model="numpy")
def read_filled(table, where, lens, placement, learned_patch, bands, windows, signature):
    """The signature at a placement that may stick out of the frame, into `signature`; for a table of the whole frame.

    Cells outside of the frame are taken from the learned patch in the present light. Returns the share inside of it.
    """
    cells = learned_patch.shape[0]
    profiles = np.empty((2 * bands, cells), np.float32)
    share = 1.0
    if lies(table, where, lens, placement) == IN_FRAME:
        read_profiles(table, where, lens, placement, profiles)
    else:
        patch, seen = np.empty((cells, cells), np.float32), np.empty((cells, cells), np.uint8)
        share = sample_boxes(table, where, lens, placement, patch, seen)
        if share < 1.0:
            gain, offset = match_light(patch, seen, learned_patch)
            fill_unseen(patch, seen, learned_patch, gain, offset)
        band_means(patch, bands, profiles)
    read_bands(profiles, windows, signature)
    return share


@njit(cache=True, fastmath=True, error_model="numpy")
def confidence_of_seen(table, where, lens, placement, learned_patch, bands, windows):
    """`seen_correlation` with the learned patch, of what a placement shows inside of the frame."""
    cells = learned_patch.shape[0]
    patch, seen = np.empty((cells, cells), np.float32), np.empty((cells, cells), np.uint8)
    sample_boxes(table, where, lens, placement, patch, seen)
    return seen_correlation(patch, seen, learned_patch, bands, windows)


@njit(cache=True, fastmath=True, error_model="numpy")
def refine(
    table, where, lens, placement, learned_patch, learned, maps, levels, gains, tolerance, bands, windows
):  # fmt: skip
    """Improve `placement` in place; returns confidence -1..1 and the share of the target in the frame.

    `levels`: the map to use in each step, or a finer one where the step turns out to be small; the last steps end early
    once a step is below `tolerance` (in widths).
    `gains`: what to take of each of the five parts of a step; 0 holds it. A negative third one means that width and
    height go together. A share of MORE_TO_READ: the placement left the table, go on with one of the whole frame.
    """
    is_whole = table.shape[1] - 1 >= where[3] and table.shape[0] - 1 >= where[4]
    confidence, share = 0.0, 0.0
    together = gains[WIDTH] < 0
    step, signature = np.zeros(5), np.empty(len(learned), np.float32)
    for turn in range(len(levels) + 1):
        if not is_whole and lies(table, where, lens, placement) != IN_FRAME:
            return 0.0, MORE_TO_READ
        share = read_filled(table, where, lens, placement, learned_patch, bands, windows, signature)
        if share < ENOUGH_SEEN:
            return 0.0, share
        confidence = 0.0
        if share >= 1.0:
            confidence = inner(signature, learned)
        if turn == len(levels):
            if share < 1.0:
                confidence = confidence_of_seen(table, where, lens, placement, learned_patch, bands, windows)
            break
        for i in range(len(signature)):
            signature[i] -= learned[i]
        level, largest = levels[turn] - 1, 0.0
        while level < len(maps) - 1 and largest < NEAR:
            level, largest = level + 1, 0.0
            for row in range(5):
                step[row] = inner(maps[level, row], signature) * abs(gains[row])
                largest = max(largest, abs(step[row]))
        if share < 1.0:  # what is filled in says "no change", so the rest has to say more
            step[X] /= share
            step[Y] /= share
        if together:
            step[WIDTH] = step[HEIGHT] = 0.5 * (step[WIDTH] + step[HEIGHT])
        move(placement, step, LARGEST_STEP)
        placement[KEYSTONE] = min(max(placement[KEYSTONE], -LARGEST_KEYSTONE), LARGEST_KEYSTONE)
        if not math.isfinite(placement[X]):
            return 0.0, 0.0
        small = max(abs(step[X]), abs(step[Y]), abs(step[WIDTH]), abs(step[HEIGHT])) < tolerance
        if small and share >= 1.0 and level == len(maps) - 1:
            break
    return confidence, share
