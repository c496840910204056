"""Counting bits in compiled code: the Hamming distance of two ORB descriptors, each four 64-bit words."""

from __future__ import annotations

import numpy as np
from numba import njit, types
from numba.extending import intrinsic

WORDS = 4
"""An ORB descriptor's 256 bits as uint64."""


@intrinsic
def _ones(typing_context, word):
    """How many bits of a uint64 are set, by the processor's own instruction."""

    def generate(context, builder, signature, arguments):
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@njit(cache=True, nogil=True)
def hamming(a, b):
    """Bits in which two descriptors (4,) uint64 differ: 0..256."""
    bits = np.uint64(0)
    for word in range(WORDS):
        bits += _ones(a[word] ^ b[word])  # type: ignore[call-arg]  # numba itself gives the first argument
    return np.int64(bits)


def hamming_reference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The same by table, for tests: distances (n, m) between descriptors (n, 4) and (m, 4)."""
    differing = a[:, None] ^ b[None]
    return np.unpackbits(differing.view(np.uint8), axis=-1).sum(axis=-1, dtype=np.int64)
