"""The compiled inner loops of the vocabulary tree and of the look-up of places."""

from __future__ import annotations

import numpy as np
from numba import njit

from base_station.trackers.slam.popcount import hamming


@njit(cache=True, nogil=True)
def descend(descriptors, centers, branching, depth, node_level, words, nodes):
    """Of each descriptor the leaf, and the node on the way at `node_level`, both counted within their level.

    `descriptors`: (n, 4) uint64. `centers`: (branching + branching^2 + ..., 4) uint64, level after level; the children
    of a level's node i are the next level's nodes i * branching and following. Of equally near children the first.
    `words`, `nodes`: (n,) int32, filled.
    """
    for n in range(len(descriptors)):
        first, node = 0, 0
        for level in range(1, depth + 1):
            begin = first + node * branching
            nearest = 1 << 62
            for child in range(branching):  # distance and child in one number: their minimum needs no branch
                nearest = min(nearest, hamming(descriptors[n], centers[begin + child]) * 64 + child)
            node = node * branching + nearest % 64
            first += branching**level
            if level == node_level:
                nodes[n] = node
        words[n] = node


@njit(cache=True, nogil=True)
def nearest_center(descriptors, centers, owners):
    """Of each descriptor the nearest of few centers, the first of equals. Returns the sum of distances.

    `descriptors`: (n, 4) uint64, `centers`: (k, 4) uint64, `owners`: (n,) int32, filled.
    """
    total = 0
    for n in range(len(descriptors)):
        nearest = 257
        for k in range(len(centers)):
            bits = hamming(descriptors[n], centers[k])
            if bits < nearest:
                owners[n], nearest = k, bits
        total += nearest
    return total


@njit(cache=True, nogil=True)
def majorities(descriptors, owners, centers):
    """Set every center's bits to what most of its descriptors have; a tie, and a center without any, stays as it was.

    Shapes as above.
    """
    clusters = len(centers)
    votes = np.zeros((clusters, 256), np.int64)
    for n in range(len(descriptors)):
        k = owners[n]
        for word in range(4):
            bits = descriptors[n, word]
            for place in range(64):
                votes[k, 64 * word + place] += 1 if bits >> np.uint64(place) & np.uint64(1) else -1
    for k in range(clusters):
        for word in range(4):
            for place in range(64):
                bit = np.uint64(1) << np.uint64(place)
                if votes[k, 64 * word + place] > 0:
                    centers[k, word] |= bit
                elif votes[k, 64 * word + place] < 0:
                    centers[k, word] &= ~bit


@njit(cache=True, nogil=True)
def scan(weight_of, words, weights, starts, scores, shared):
    """Of each place what it has in common with a picture: the sum of the lesser weights, and how many words.

    `weight_of`: the picture's weight of every word there is, 0 where it has none. `words`, `weights`: those of all
    places, one after the other, place n from `starts[n]` on; one more at the end. `scores`, `shared`: filled.
    """
    for n in range(len(scores)):
        total, count = np.float32(0.0), 0
        for at in range(starts[n], starts[n + 1]):
            weight = weight_of[words[at]]
            total += min(weight, weights[at])
            count += weight > 0
        scores[n], shared[n] = total, count
