"""Two-dimensional channels of a patch: the transform about every cell, of which only the phase is kept.

The row bands of `signature.py` need a target that keeps its shape. Read about *every* cell of a patch, along rows and
along columns, the same second-order poles give complex pictures: where an edge is, and which way it goes, is in their
phase, how strong it is in their size. Dividing by the size (above a floor) leaves the phase; faint texture then
counts as much as the sharp border of what stands behind. That step is what makes a correlation filter on these channels
follow what changes its looks. Recursions run down the rows with the columns side by side, so that a processor takes
eight of them at a time; for the other direction the patch is transposed.

The last channel is not a transform: its real part is the light itself, its imaginary part how likely a cell of this
light belongs to the target. See the README, section 7; `reference.phase_channels` is the plain meaning.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit


@dataclass(frozen=True, kw_only=True)
class ChannelSettings:
    """Which channels are read. Lengths are in cells."""

    rates: tuple[float, ...] = (0.5, 1.2)
    """s of each scale, per cell: the window u exp(-s u) peaks 1/s cells away."""
    slope: float = 2.0
    """Radians turned per e-fold of fading."""
    across: float = 1.2
    """The real pole that smooths across the direction of reading is exp(-across s)."""
    floor: float = 0.3
    """Of the channel's root mean square: what is much weaker than this is noise and stays small."""


@njit(cache=True, fastmath=True, error_model="numpy")
def transpose(source, out):
    """out = source transposed, both square."""
    n = source.shape[0]
    for y in range(n):
        row = out[y]
        for x in range(n):
            row[x] = source[x, y]


@njit(cache=True, fastmath=True, error_model="numpy")
def difference_down(source, out):
    """Central difference down the rows (twice it), the border repeated."""
    n = source.shape[0]
    for y in range(n):
        below, above = source[min(y + 1, n - 1)], source[max(y - 1, 0)]
        for x in range(n):
            out[y, x] = below[x] - above[x]


@njit(cache=True, fastmath=True, error_model="numpy")
def smooth_down(source, pole, out):
    """First-order real pole down the rows, then up again."""
    n = source.shape[0]
    for x in range(n):
        out[0, x] = source[0, x]
    for y in range(1, n):
        for x in range(n):
            out[y, x] = source[y, x] + pole * (out[y - 1, x] - source[y, x])
    for y in range(n - 2, -1, -1):
        for x in range(n):
            out[y, x] += pole * (out[y + 1, x] - out[y, x])


@njit(cache=True, fastmath=True, error_model="numpy")
def transform_down(source, pole_re, pole_im, state, re, im):
    """sum_u u p^u d[y + u], looking down, plus the conjugate of the same looking up. `state`: scratch, (4, cells).

    The real part is even about y, the imaginary part odd: together they tell on which side of an edge a cell lies, and
    how far from it.
    """
    n = source.shape[0]
    first_re, first_im, second_re, second_im = state[0], state[1], state[2], state[3]
    for side in range(2):
        for x in range(n):
            first_re[x] = first_im[x] = second_re[x] = second_im[x] = np.float32(0.0)
        for i in range(n):
            y = n - 1 - i if side == 0 else i
            for x in range(n):
                t_re, t_im = second_re[x] + first_re[x], second_im[x] + first_im[x]
                s_re = pole_re * t_re - pole_im * t_im
                s_im = pole_re * t_im + pole_im * t_re
                second_re[x], second_im[x] = s_re, s_im
                f_re = pole_re * first_re[x] - pole_im * first_im[x] + source[y, x]
                first_im[x] = pole_re * first_im[x] + pole_im * first_re[x]
                first_re[x] = f_re
                if side == 0:
                    re[y, x], im[y, x] = s_re, s_im
                else:
                    re[y, x] += s_re
                    im[y, x] -= s_im


@njit(cache=True, fastmath=True, error_model="numpy")
def keep_phase(re, im, floor, out, turned):
    """out[..., 0] + j out[..., 1] = c / (|c| + floor * rms of |c|); `turned`: rows and columns change places."""
    n = re.shape[0]
    power = np.float32(0.0)
    for y in range(n):
        for x in range(n):
            power += re[y, x] * re[y, x] + im[y, x] * im[y, x]
    least = floor * np.sqrt(power / np.float32(n * n)) + np.float32(1e-6)
    for y in range(n):
        row_re, row_im = re[y], im[y]
        for x in range(n):
            gain = np.float32(1.0) / (np.sqrt(row_re[x] * row_re[x] + row_im[x] * row_im[x]) + least)
            row_re[x] *= gain
            row_im[x] *= gain
    lines = out.reshape(n, 2 * n)  # real and imaginary parts in turns, so that several cells are taken at a time
    for y in range(n):
        line = lines[y]
        if turned:
            for x in range(n):
                line[2 * x], line[2 * x + 1] = re[x, y], im[x, y]
        else:
            row_re, row_im = re[y], im[y]
            for x in range(n):
                line[2 * x], line[2 * x + 1] = row_re[x], row_im[x]


@njit(cache=True, fastmath=True, error_model="numpy")
def phase_channels(patch, pole_re, pole_im, across, floor, out):
    """The channels of a square patch into `out`, float32 (2 scales, cells, cells, 2): those read down the rows, one per
    scale, then those read along the rows."""
    n = patch.shape[0]
    turned, slope = np.empty((n, n), np.float32), np.empty((n, n), np.float32)
    slope_turned, smooth = np.empty((n, n), np.float32), np.empty((n, n), np.float32)
    re, im, state = np.empty((n, n), np.float32), np.empty((n, n), np.float32), np.empty((4, n), np.float32)
    transpose(patch, turned)
    scales = len(pole_re)
    for axis in range(2):
        difference_down(patch if axis == 0 else turned, slope)
        transpose(slope, slope_turned)
        for k in range(scales):
            smooth_down(slope_turned, across[k], re)
            transpose(re, smooth)
            transform_down(smooth, pole_re[k], pole_im[k], state, re, im)
            keep_phase(re, im, floor, out[axis * scales + k], axis == 1)


@njit(cache=True, fastmath=True, error_model="numpy")
def light_channel(patch, likelihood, weight, out):
    """The light, less its mean and by its spread, and weight * likelihood of every cell's grey level, into
    (cells, cells, 2). `likelihood`: -1..1 for evenly spaced grey levels, interpolated at whole ones."""
    n, bins = patch.shape[0], len(likelihood)
    total, squares = 0.0, 0.0
    for y in range(n):
        for x in range(n):
            total += patch[y, x]
            squares += patch[y, x] * patch[y, x]
    mean = np.float32(total / (n * n))
    gain = np.float32(1.0 / (np.sqrt(max(squares / (n * n) - (total / (n * n)) ** 2, 0.0)) + 1e-6))
    table = np.empty(256, np.float32)
    for level in range(256):
        place = min(max(level * bins / 256.0 - 0.5, 0.0), bins - 1.001)
        lower = int(place)
        table[level] = weight * (likelihood[lower] + (place - lower) * (likelihood[lower + 1] - likelihood[lower]))
    lines = out.reshape(n, 2 * n)
    for y in range(n):
        line, levels = lines[y], patch[y]
        for x in range(n):
            line[2 * x] = (levels[x] - mean) * gain
            line[2 * x + 1] = table[int(levels[x])]


@njit(cache=True, fastmath=True, error_model="numpy")
def learn_light(patch, inner, outer, rate, inside, outside, likelihood):
    """Take `rate` of the histograms of grey levels in the box `inner` and beyond the box `outer`, and say how likely a
    level is the target's, -1..1. Boxes: first row, past-last row, first column, past-last column."""
    n, bins = patch.shape[0], len(inside)
    step, one = np.float32(bins / 256.0), np.float32(1.0)
    counts = np.zeros((2, bins), np.float32)
    for y in range(n):
        for x in range(n):
            level = min(int(patch[y, x] * step), bins - 1)
            if inner[0] <= y and y < inner[1] and inner[2] <= x and x < inner[3]:
                counts[0, level] += one
            elif not (outer[0] <= y and y < outer[1] and outer[2] <= x and x < outer[3]):
                counts[1, level] += one
    for side in range(2):
        kept, total = (inside, inside.size) if side == 0 else (outside, outside.size)
        found = max(counts[side].sum(), one)
        for i in range(total):
            smooth = (counts[side, max(i - 1, 0)] + 2 * counts[side, i] + counts[side, min(i + 1, bins - 1)]) / (
                4 * found
            )
            kept[i] += rate * (np.float32(smooth) - kept[i])
    for i in range(bins):
        likelihood[i] = 2 * inside[i] / (inside[i] + outside[i] + np.float32(1e-3)) - one


class ChannelReader:
    """Settings turned into the arrays that the kernels take."""

    def __init__(self, settings: ChannelSettings) -> None:
        rates = np.array(settings.rates)
        poles = np.exp(-rates * (1 + 1j * settings.slope))
        self.count = 2 * len(rates) + 1
        """Complex channels, the light included."""
        self._plan = (
            poles.real.astype(np.float32),
            poles.imag.astype(np.float32),
            np.exp(-settings.across * rates).astype(np.float32),
            np.float32(settings.floor),
        )

    def read(self, patch: np.ndarray, likelihood: np.ndarray, weight: float) -> np.ndarray:
        """Channels of a square patch (uint8 or float32), float32 (count, cells, cells, 2): real and imaginary parts."""
        patch = patch.astype(np.float32, copy=False)
        out = np.empty((self.count, *patch.shape, 2), np.float32)
        phase_channels(patch, *self._plan, out)
        light_channel(patch, likelihood, np.float32(weight), out[-1])
        return out
