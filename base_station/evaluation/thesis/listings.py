"""The thesis's listing A.3 and algorithm 4.2, in numpy: as they stand, and with one slip mended at a time.

Rows are 1-D float arrays, `before` and `after` a move to the left by the wanted n0. Index 0 of a half row is the
pixel in the middle of the picture.
"""

from __future__ import annotations

import numpy as np


def half(row: np.ndarray) -> np.ndarray:
    """The right half, from the middle on: listing A.3, lines 16 and 17."""
    return np.asarray(row, float)[len(row) // 2 :]


def transform(row: np.ndarray, z: complex) -> complex | float:
    """Eq. (3.2): sum of row[n] z^-n."""
    return np.sum(row * np.asarray(z) ** -np.arange(len(row), dtype=float))


def errors(before: np.ndarray, after: np.ndarray, z: complex, shifts: np.ndarray, *, as_listed: bool) -> np.ndarray:
    """X_after(z) - z^n0 (X_before(z) - excess) for every n0 of `shifts` (all >= 1); 0 at the true one.

    `as_listed` weighs the excess term by z^n0 twice, as listing A.3 does (lines 48 to 54); otherwise eq. (3.4).
    The excess pixels are read where the listing reads them: in the row after the move, left of its middle.
    """
    middle = len(after) // 2
    x_before, x_after = transform(half(before), z), transform(half(after), z)
    found = []
    for n0 in shifts:
        excess = np.asarray(after, float)[middle - n0 : middle]
        k = np.arange(n0, dtype=float)
        weights = np.asarray(z) ** (n0 - k) if as_listed else np.asarray(z) ** -k
        found.append(x_after - np.asarray(z) ** float(n0) * (x_before - np.sum(excess * weights)))
    return np.array(found)


def answer(before: np.ndarray, after: np.ndarray, z: complex, shifts: np.ndarray, *, as_listed: bool = False) -> int:
    """The n0 of the smallest error: what algorithm 4.1 finds."""
    return int(shifts[np.abs(errors(before, after, z, shifts, as_listed=as_listed)).argmin()])


def regions(row: np.ndarray, z: float, count: int) -> np.ndarray:
    """Algorithm 4.2: X(z) of every region by itself, n from 0 in each; shape (count,)."""
    cuts = [slice(r * len(row) // count, (r + 1) * len(row) // count) for r in range(count)]
    return np.array([transform(np.asarray(row, float)[cut], z) for cut in cuts])
