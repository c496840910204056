"""Whether a pose is more than chance: as many points are not found again where they are not.

Among a thousand keypoints some look like any point that is asked for, and a pose that may be chosen finds a dozen of
them where it puts points. How many there are by chance depends on the picture and the map, so it is measured: the same
points are looked for beside where the pose puts them. From that follows how often, in a picture that shows nothing of
the map, so many points that look so like would be found: the number of false alarms (Desolneux, Moisan and Morel, "From
Gestalt Theory to Image Analysis", 2008; for a model fitted to some of its data, Moisan and Stival, IJCV 2004).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from base_station.trackers.slam.features import Features
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.matching import Grid, match_projections
from base_station.trackers.slam.popcount import hamming
from base_station.trackers.slam.pose_optimization import CHI2_TWO
from base_station.trackers.slam.visibility import Expected

BESIDE_PX = np.array([(30, 0), (25, 26), (0, 42), (-34, 34), (-54, 0), (-42, -43), (0, -66), (51, -52)], np.float64)
"""How far beside their place points are looked for: further than a keypoint that shows a point may be from it, in
the picture's neighbourhood, and all unlike, so that no regular pattern fits them all."""
ALIKE = np.arange(30, 101, 10)
"""Bits: how alike is asked one after the other, for few that look very alike say more than many that hardly do."""
FITTED_TO = 3
"""Points that any pose can be made to fit."""


@dataclass(frozen=True, kw_only=True)
class ChanceSettings:
    """When a pose is more than chance."""

    most_log10: float = -3.0
    """Decimal logarithm of the false alarms that are allowed a picture. Poses by chance had 0.5 to 5 in the simulated
    room, right ones of fewer than 40 points -3.9 and less, most of them less than -10."""
    beyond: int = 100
    """Points that are never found by chance, and are not asked about."""


def log10_false_alarms(
    world: Map, expected: Expected, features: Features, grid: Grid, point_of: np.ndarray, tried: int
) -> float:
    """How many poses as good as this one would be found in a picture by chance, as a decimal logarithm.

    `expected`: the points that should be seen from the pose; `point_of` (n,): those that the features show, where it
    puts them; `tried`: matches that the first pose could be chosen from.
    """
    shown = np.flatnonzero(point_of >= 0)
    found = bits(world.descriptors[point_of[shown]], features.descriptors[shown])
    by_chance = _found_beside(world, expected, features, grid)
    best = math.inf
    for alike in ALIKE:
        rate = (np.count_nonzero(by_chance <= alike) + 0.5) / len(BESIDE_PX)  # half a one more: none seen is not never
        best = min(best, log10_poisson_tail(rate, int(np.count_nonzero(found <= alike)) - FITTED_TO))
    choices = math.comb(max(tried, FITTED_TO), FITTED_TO) * len(ALIKE)
    return best + math.log10(choices)


def _found_beside(world: Map, expected: Expected, features: Features, grid: Grid) -> np.ndarray:
    """Bits (m,) of all that is found beside where the points should be."""
    looks, all_bits = world.descriptors[expected.rows], []
    for beside_px in BESIDE_PX:
        matches = match_projections(
            expected.uv_px + beside_px, math.sqrt(CHI2_TWO) * world.scales[expected.octave], expected.octave_range,
            looks, features, grid,
        )  # fmt: skip
        index = np.flatnonzero(matches >= 0)
        all_bits.append(bits(looks[index], features.descriptors[matches[index]]))
    return np.concatenate(all_bits)


@njit(cache=True, nogil=True)
def bits(one, two):
    """Bits (n,) in which descriptors (n, 4) differ, one by one."""
    differing = np.empty(len(one), np.int64)
    for i in range(len(one)):
        differing[i] = hamming(one[i], two[i])
    return differing


def log10_poisson_tail(rate: float, count: int) -> float:
    """Decimal logarithm of the probability of `count` or more, when `rate` are to be expected."""
    if count <= rate:
        return 0.0  # not rare, so how likely does not matter
    first = count * math.log(rate) - rate - math.lgamma(count + 1)
    rest, term, k = 1.0, 1.0, count
    while term > 1e-6:
        k += 1
        term *= rate / k
        rest += term
    return (first + math.log(rest)) / math.log(10.0)
