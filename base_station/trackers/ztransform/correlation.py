"""A correlation filter: where in a patch is what was learned, by one product of spectra.

The filter that answers a learned patch with a narrow peak at its middle has, frequency by frequency, a closed form: the
patch's spectrum over its energy (Bolme et al. 2010, MOSSE; several channels: Henriques et al. 2015). Two things are
done differently here. What is learned is cut out by a mask about the target, while the energy is that of the whole
window, background included: frequencies in which the background is loud then count less, and the background itself is
never learned. And a patch is read once a frame: the part to learn from is moved to the middle by whole cells, and by
the rest of the way through a phase ramp of its spectrum. Spectra are float32 with real and imaginary part last.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit


@dataclass(frozen=True, kw_only=True)
class FilterSettings:
    """How a filter is learned."""

    label_cells: float
    """Width (standard deviation) of the peak that it should answer with."""
    regularisation: float
    """Of the strongest frequency's energy, added to all: what has less does not count."""
    rate: float
    """How much of the newest frame is taken over into what was learned."""


@dataclass(frozen=True, kw_only=True)
class Peak:
    """The highest answer. `rows`, `columns`: where it is from the middle, in cells, between cells by parabolas."""

    height: float
    """1 for the patch that was learned, had nothing else been learned since."""
    sharpness: float
    """By how many standard deviations of all answers it stands out of them. Of 270 looks at other photographs 99 %
    stayed below 6, whatever their contrast; the mirrored picture reached 10."""
    rows: float
    columns: float


MIDDLE = Peak(height=1.0, sharpness=math.inf, rows=0.0, columns=0.0)


@njit(cache=True, fastmath=True, error_model="numpy")
def fade(channels, window, out):
    """out = window times the channels. Here and below a row is read as one line, real and imaginary parts in turn: so
    compiled code takes several cells at a time."""
    count, rows, columns, _ = channels.shape
    lines, faded = channels.reshape(count, rows, 2 * columns), out.reshape(count, rows, 2 * columns)
    for c in range(count):
        for y in range(rows):
            source, weight, into = lines[c, y], window[y], faded[c, y]
            for x in range(columns):
                into[2 * x] = source[2 * x] * weight[x]
                into[2 * x + 1] = source[2 * x + 1] * weight[x]


@njit(cache=True, fastmath=True, error_model="numpy")
def cut_out(channels, down, right, mask, out):
    """out = mask times the channels moved so that the cell (down, right) from the middle comes to the middle."""
    count, rows, columns, _ = channels.shape
    lines, cut = channels.reshape(count, rows, 2 * columns), out.reshape(count, rows, 2 * columns)
    first, last = max(0, -right), min(columns, columns - right)
    for c in range(count):
        for y in range(rows):
            into = cut[c, y]
            if y + down < 0 or y + down >= rows or first >= last:
                for i in range(2 * columns):
                    into[i] = np.float32(0.0)
                continue
            for i in range(2 * first):
                into[i] = np.float32(0.0)
            for i in range(2 * last, 2 * columns):
                into[i] = np.float32(0.0)
            source, weight = lines[c, y + down, 2 * (first + right) : 2 * (last + right)], mask[y, first:last]
            into = into[2 * first : 2 * last]
            for x in range(last - first):
                into[2 * x] = source[2 * x] * weight[x]
                into[2 * x + 1] = source[2 * x + 1] * weight[x]


@njit(cache=True, fastmath=True, error_model="numpy")
def respond(numerator, energy, least, spectrum, out):
    """out = sum over channels of conj(numerator) * spectrum, over energy + least: the answer's spectrum."""
    count, rows, columns, _ = spectrum.shape
    learned, seen = numerator.reshape(count, rows, 2 * columns), spectrum.reshape(count, rows, 2 * columns)
    answer = out.reshape(rows, 2 * columns)
    re, im = np.empty(columns, np.float32), np.empty(columns, np.float32)
    for y in range(rows):
        for x in range(columns):
            re[x] = im[x] = np.float32(0.0)
        for c in range(count):
            a, b = learned[c, y], seen[c, y]
            for x in range(columns):
                a_re, a_im, b_re, b_im = a[2 * x], a[2 * x + 1], b[2 * x], b[2 * x + 1]
                re[x] += a_re * b_re + a_im * b_im
                im[x] += a_re * b_im - a_im * b_re
        into, power = answer[y], energy[y]
        for x in range(columns):
            share = np.float32(1.0) / (power[x] + least)
            into[2 * x] = re[x] * share
            into[2 * x + 1] = im[x] * share


@njit(cache=True, error_model="numpy")
def between(before, highest, after):
    """Where between the three, -0.5..0.5, a parabola through them is highest."""
    bend = before - 2.0 * highest + after
    return min(max(0.5 * (before - after) / bend, -0.5), 0.5) if bend < 0 else 0.0


@njit(cache=True, fastmath=True, error_model="numpy")
def highest(answer):
    """Height, sharpness, row and column of the highest real part (see `Peak`), mean and standard deviation of all."""
    rows, columns, _ = answer.shape
    best, best_row, best_column = answer[0, 0, 0], 0, 0
    total, squares = 0.0, 0.0
    for y in range(rows):
        for x in range(columns):
            value = answer[y, x, 0]
            total += value
            squares += value * value
            if value > best:
                best, best_row, best_column = value, y, x
    mean = total / (rows * columns)
    spread = math.sqrt(max(squares / (rows * columns) - mean * mean, 1e-12))
    above, below = answer[(best_row - 1) % rows, best_column, 0], answer[(best_row + 1) % rows, best_column, 0]
    left, right = answer[best_row, (best_column - 1) % columns, 0], answer[best_row, (best_column + 1) % columns, 0]
    row, column = between(above, best, below), between(left, best, right)
    row += (best_row + rows // 2) % rows - rows // 2
    column += (best_column + columns // 2) % columns - columns // 2
    return best, (best - mean) / spread, row, column, mean, spread


@njit(cache=True, error_model="numpy")
def highest_near(answer, down, right):
    """The highest real part at most a cell from the one (down, right) from the middle."""
    rows, columns, _ = answer.shape
    best = -np.inf
    for y in range(down - 1, down + 2):
        for x in range(right - 1, right + 2):
            best = max(best, answer[y % rows, x % columns, 0])
    return best


@njit(cache=True, fastmath=True, error_model="numpy")
def phase_ramp(size, rest):
    """exp(2 pi j f rest) for the frequencies f of a transform of this size; float32 (size, 2)."""
    out = np.empty((size, 2), np.float32)
    for k in range(size):
        turn = 2 * math.pi * ((k + size // 2) % size - size // 2) / size * rest
        out[k, 0], out[k, 1] = math.cos(turn), math.sin(turn)
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def blend(rate, label, rest_rows, rest_columns, target, whole, numerator, energy):
    """Take `rate` of the new target's spectrum (times conj(label), moved back by the rest, in cells) and of the whole's
    energy."""
    count, rows, columns, _ = target.shape
    keep = np.float32(1.0) - rate
    targets, wholes = target.reshape(count, rows, 2 * columns), whole.reshape(count, rows, 2 * columns)
    learned, labels = numerator.reshape(count, rows, 2 * columns), label.reshape(rows, 2 * columns)
    ramp_rows, ramp_columns = phase_ramp(rows, rest_rows), phase_ramp(columns, rest_columns).reshape(2 * columns)
    l_re, l_im, power = np.empty(columns, np.float32), np.empty(columns, np.float32), np.empty(columns, np.float32)
    for y in range(rows):
        down_re, down_im, line = ramp_rows[y, 0], ramp_rows[y, 1], labels[y]
        for x in range(columns):
            right_re, right_im = ramp_columns[2 * x], ramp_columns[2 * x + 1]
            r_re, r_im = down_re * right_re - down_im * right_im, down_re * right_im + down_im * right_re
            l_re[x] = rate * (r_re * line[2 * x] + r_im * line[2 * x + 1])
            l_im[x] = rate * (r_im * line[2 * x] - r_re * line[2 * x + 1])
            power[x] = np.float32(0.0)
        for c in range(count):
            t, w, a = targets[c, y], wholes[c, y], learned[c, y]
            for x in range(columns):
                a_re, a_im, t_re, t_im = a[2 * x], a[2 * x + 1], t[2 * x], t[2 * x + 1]
                w_re, w_im = w[2 * x], w[2 * x + 1]
                a[2 * x] = keep * a_re + l_re[x] * t_re - l_im[x] * t_im
                a[2 * x + 1] = keep * a_im + l_re[x] * t_im + l_im[x] * t_re
                power[x] += w_re * w_re + w_im * w_im
        energies = energy[y]
        for x in range(columns):
            energies[x] = keep * energies[x] + rate * power[x]


class CorrelationFilter:
    """Learns one patch's channels, finds them again, and adapts. `window`: float32 (rows, columns), fades a patch in
    from its ends before it is transformed."""

    def __init__(self, window: np.ndarray, settings: FilterSettings) -> None:
        rows, columns = self._shape = window.shape
        self._window, self._settings = window.astype(np.float32), settings
        distance = [(np.arange(n) + n // 2) % n - n // 2 for n in (rows, columns)]
        label = np.exp(-(distance[0][:, None] ** 2 + distance[1][None] ** 2) / (2 * settings.label_cells**2))
        spectrum = np.fft.fft2(label)
        self._label = np.stack([spectrum.real, spectrum.imag], -1).astype(np.float32)
        self._answer = np.empty((rows, columns, 2), np.float32)
        self._whole = self._cut = np.empty((0, rows, columns, 2), np.float32)

    def learn(self, channels: np.ndarray, mask: np.ndarray | None = None) -> None:
        """Begin anew with the target in the middle. `mask`: which cells are the target, 0..1; None: the window."""
        self._numerator = np.zeros_like(channels)
        self._energy = np.zeros(self._shape, np.float32)
        self._whole, self._cut = np.empty_like(channels), np.empty_like(channels)
        self._transform(channels)
        self._take(np.float32(1.0), channels, mask, MIDDLE)
        self._least = np.float32(self._settings.regularisation * self._energy.max() + 1e-6)

    def learn_also(self, channels: np.ndarray, mask: np.ndarray | None, number: int) -> None:
        """One more view of the target, in the middle too: the `number`-th, so that all of them weigh the same."""
        self._transform(channels)
        self._take(np.float32(1 / number), channels, mask, MIDDLE)

    def keep(self) -> None:
        """Remember what is learned by now, for `restore`, `recall` and `familiarity`."""
        self._kept = self._numerator.copy(), self._energy.copy()

    def restore(self) -> None:
        """Forget what was learned since `keep`."""
        self._numerator, self._energy = (part.copy() for part in self._kept)

    def find(self, channels: np.ndarray) -> Peak:
        """Where it is in this patch."""
        self._transform(channels)
        return self._highest(self._answered(self._numerator, self._energy))

    def find_without(self, channels: np.ndarray) -> Peak:
        """As the last `find`, its channels but without the last one's imaginary part: one transform instead of all."""
        last = channels[-1:].copy()
        last[..., 1] = 0.0
        fade(last, self._window, self._whole[-1:])
        _transformed(self._whole[-1:])
        return self._highest(self._answered(self._numerator, self._energy))

    def recall(self, channels: np.ndarray) -> Peak:
        """As `find`, for what was kept. `adapt` needs another `find` first."""
        self._transform(channels)
        return self._highest(self._answered(*self._kept))

    def familiarity(self, peak: Peak) -> float:
        """The sharpness of what was kept at (within a cell of) a peak of the patch that was last looked at."""
        answer = self._answered(*self._kept)
        *_, mean, spread = highest(answer)
        return float((highest_near(answer, round(peak.rows), round(peak.columns)) - mean) / spread)

    def _answered(self, numerator: np.ndarray, energy: np.ndarray) -> np.ndarray:
        respond(numerator, energy, self._least, self._whole, self._answer)
        return cv2.dft(self._answer, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE)

    @staticmethod
    def _highest(answer: np.ndarray) -> Peak:
        height, sharpness, row, column, _, _ = highest(answer)
        return Peak(height=float(height), sharpness=sharpness, rows=row, columns=column)

    def adapt(self, channels: np.ndarray, peak: Peak, mask: np.ndarray | None = None, times: int = 1) -> None:
        """Learn from the channels that `find` was last called with; `peak` says where the target is in them.

        `times`: as much as from so many frames that all look like this one.
        """
        self._take(np.float32(1 - (1 - self._settings.rate) ** times), channels, mask, peak)

    def _take(self, rate: np.float32, channels: np.ndarray, mask: np.ndarray | None, peak: Peak) -> None:
        down, right = (0, 0) if mask is None else (round(peak.rows), round(peak.columns))
        if mask is None:
            target = self._whole
        else:
            cut_out(channels, down, right, mask, self._cut)
            target = _transformed(self._cut)
        rest = peak.rows - down, peak.columns - right
        blend(rate, self._label, *rest, target, self._whole, self._numerator, self._energy)

    def _transform(self, channels: np.ndarray) -> None:
        fade(channels, self._window, self._whole)
        _transformed(self._whole)


def _transformed(channels: np.ndarray) -> np.ndarray:
    """The spectra of complex channels, in place."""
    for channel in channels:
        cv2.dft(channel, channel)
    return channels
