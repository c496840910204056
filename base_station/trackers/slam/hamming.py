"""Hamming distance of 256-bit descriptors in compiled code: four 64-bit words each, one population count per word."""

from __future__ import annotations

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

BYTES, WORDS = 32, 4
"""Of a descriptor: as OpenCV gives it, and as 64-bit words."""


def as_words(descriptors: np.ndarray) -> np.ndarray:
    """(n, 32) uint8 to (n, 4) uint64, without a copy where the rows are contiguous. Raises ValueError for any other
    shape or type."""
    if descriptors.ndim != 2 or descriptors.shape[1] != BYTES or descriptors.dtype != np.uint8:
        raise ValueError(f"descriptors must be (n, {BYTES}) uint8, not {descriptors.shape} {descriptors.dtype}")
    return np.ascontiguousarray(descriptors).view(np.uint64)


@intrinsic
def popcount(typing_context, word):
    """How many bits of a uint64 are set: the processor's own instruction."""

    def build(context, builder, signature, arguments):
        return builder.ctpop(arguments[0])

    return (types.uint64(types.uint64), build) if word == types.uint64 else None


@njit(cache=True, nogil=True, inline="always")
def distance(a, b):
    """Differing bits of two descriptors, each (4,) uint64."""
    bits = 0
    for word in range(4):
        bits += popcount(a[word] ^ b[word])  # type: ignore[call-arg]  # numba passes the context itself
    return bits
