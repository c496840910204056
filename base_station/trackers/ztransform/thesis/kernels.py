"""The compiled inner loops of the thesis's two algorithms. `reference.py` has their plain meaning.

Complex z may be given, real ones too; transforms are complex128: with z = 0.9 the weights span fifteen decades.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def transform_about(row, anchor, z, out):
    """Into `out` (zs, 2): sum_{u >= 0} row[anchor + u] z^-u, and the same to the left: Horner's rule, from the ends."""
    for k in range(len(z)):
        step = 1.0 / z[k]
        right, left = 0j, 0j
        for m in range(len(row) - 1, anchor - 1, -1):
            right = row[m] + step * right
        for m in range(anchor + 1):
            left = row[m] + step * left
        out[k, 0], out[k, 1] = right, left


@njit(cache=True)
def predict_shifts(row, anchor, z, span, out):
    """What the transforms about the anchor become when the row moves by -span..span; into `out` (2 span + 1, zs, 2).

    Algorithm 4.1 with a pixel at a time: moving on takes eq. (3.4), moving back eq. (3.3) and the pixel that enters.
    """
    transform_about(row, anchor, z, out[span])
    for k in range(len(z)):
        step = 1.0 / z[k]
        for n in range(span):
            here, to_left, to_right = span - n, span - n - 1, span + n + 1
            out[to_left, k, 0] = z[k] * (out[here, k, 0] - row[anchor + n])
            out[to_left, k, 1] = step * out[here, k, 1] + row[anchor + n + 1]
            here = span + n
            out[to_right, k, 0] = step * out[here, k, 0] + row[anchor - n - 1]
            out[to_right, k, 1] = z[k] * (out[here, k, 1] - row[anchor - n])


@njit(cache=True)
def fit_shift(predicted, seen, any_gain):
    """Which prediction is seen: index (with its fraction), residual 0..1 and gain.

    `predicted`: (shifts, numbers) complex, `seen`: (numbers,). Between two neighbours the prediction is interpolated,
    which has its best fraction in closed form. Residual: the length of what is left over against that of `seen`. With
    `any_gain` the prediction may be multiplied by any positive factor.
    """
    best_index, best_residual, best_gain = 0.0, np.inf, 0.0
    energy = 0.0
    for j in range(len(seen)):
        energy += seen[j].real ** 2 + seen[j].imag ** 2
    if energy == 0.0:
        return best_index, 1.0, 0.0
    for i in range(len(predicted) - 1):
        aa, ab, bb, ay, by = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(len(seen)):
            a, b, y = predicted[i, j], predicted[i + 1, j], seen[j]
            aa += a.real * a.real + a.imag * a.imag
            bb += b.real * b.real + b.imag * b.imag
            ab += a.real * b.real + a.imag * b.imag
            ay += a.real * y.real + a.imag * y.imag
            by += b.real * y.real + b.imag * y.imag
        if any_gain:
            of_a, of_b = bb * ay - ab * by, aa * by - ab * ay
            part = of_b / (of_a + of_b) if of_a + of_b > 0 else (0.0 if ay > by else 1.0)
        else:
            apart = aa - 2 * ab + bb
            part = (by - ay - ab + aa) / apart if apart > 0 else 0.0
        part = min(max(part, 0.0), 1.0)
        length = (1 - part) ** 2 * aa + 2 * part * (1 - part) * ab + part**2 * bb
        along = (1 - part) * ay + part * by
        gain = 1.0
        if any_gain:
            gain = max(along / length, 0.0) if length > 0 else 0.0
        residual = np.sqrt(max(energy - 2 * gain * along + gain * gain * length, 0.0) / energy)
        if residual < best_residual:
            best_index, best_residual, best_gain = i + part, residual, gain
    return best_index, best_residual, best_gain


@njit(cache=True)
def transform_regions(row, regions, z, out):
    """Algorithm 4.2: z^(L-1) X(z) of every region of L pixels, over the sum of its weights; into (regions, zs, 2).

    With |z| < 1 that is a mean weighted towards the region's right end, and the second number one towards its left.
    """
    for r in range(regions):
        first, beyond = r * len(row) // regions, (r + 1) * len(row) // regions
        for k in range(len(z)):
            right, left, weights = 0.0, 0.0, 0.0
            for n in range(beyond - first):
                right = right * z[k] + row[first + n]
                left = left * z[k] + row[beyond - 1 - n]
                weights = weights * z[k] + 1.0
            out[r, k, 0], out[r, k, 1] = right / weights, left / weights
