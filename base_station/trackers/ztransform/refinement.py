"""From about where the target is to exactly where: a few steps of the learned maps, wide ones first."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from base_station.trackers.ztransform.kernels import (
    HEIGHT,
    KEYSTONE,
    WIDTH,
    X,
    Y,
    fill_unseen,
    inner,
    match_light,
    move,
    read_signature,
    sample_patch,
    seen_correlation,
)

LARGEST_STEP = 0.4
LARGEST_KEYSTONE = 0.5
ENOUGH_SEEN = 0.15


@njit(cache=True, fastmath=True, error_model="numpy")
def refine(
    image, scale, samples, lens, placement, learned_patch, learned, maps, levels, gains, tolerance,
    patch, seen, signature, bands, windows,
):  # fmt: skip
    """Improve `placement` in place; returns confidence -1..1, the share of the target in the frame, contrast.

    `levels`: the map to use in each step; the last steps end early once a step is below `tolerance` (in widths).
    `gains`: what to take of each of the five parts of a step; 0 holds it. A negative third one means that width and
    height go together.
    """
    confidence, share, contrast = 0.0, 0.0, 0.0
    together = gains[WIDTH] < 0
    step = np.zeros(5)
    for turn in range(len(levels) + 1):
        share = sample_patch(image, scale, placement, lens, samples, patch, seen)
        if share < ENOUGH_SEEN:
            return 0.0, share, 0.0
        confidence = 0.0
        if share < 1.0:
            gain, offset = match_light(patch, seen, learned_patch)
            last = turn == len(levels)
            if last:
                confidence = seen_correlation(patch, seen, learned_patch, bands, windows)
            fill_unseen(patch, seen, learned_patch, gain, offset)
        contrast = read_signature(patch, bands, windows, signature)
        if share >= 1.0:
            confidence = inner(signature, learned)
        if turn == len(levels):
            break
        for i in range(len(signature)):
            signature[i] -= learned[i]
        for row in range(5):
            step[row] = inner(maps[levels[turn], row], signature) * abs(gains[row])
        if share < 1.0:  # what is filled in says "no change", so the rest has to say more
            step[X] /= share
            step[Y] /= share
        if together:
            step[WIDTH] = step[HEIGHT] = 0.5 * (step[WIDTH] + step[HEIGHT])
        move(placement, step, LARGEST_STEP)
        placement[KEYSTONE] = min(max(placement[KEYSTONE], -LARGEST_KEYSTONE), LARGEST_KEYSTONE)
        if not math.isfinite(placement[X]):
            return 0.0, 0.0, 0.0
        small = max(abs(step[X]), abs(step[Y]), abs(step[WIDTH]), abs(step[HEIGHT])) < tolerance
        if small and share >= 1.0 and levels[turn] == len(maps) - 1:
            break
    return confidence, share, contrast
