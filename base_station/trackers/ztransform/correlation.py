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
def cut_out(channels, down, right, mask, out):
    """out = mask times the channels moved so that the cell (down, right) from the middle comes to the middle."""
    count, rows, columns, _ = channels.shape
    for y in range(rows):
        source_y = y + down
        for x in range(columns):
            source_x = x + right
            inside = source_y >= 0 and source_y < rows and source_x >= 0 and source_x < columns
            weight = mask[y, x] if inside else np.float32(0.0)
            if weight > 0:
                for c in range(count):
                    out[c, y, x, 0] = channels[c, source_y, source_x, 0] * weight
                    out[c, y, x, 1] = channels[c, source_y, source_x, 1] * weight
            else:
                for c in range(count):
                    out[c, y, x, 0] = out[c, y, x, 1] = np.float32(0.0)


@njit(cache=True, fastmath=True, error_model="numpy")
def respond(numerator, energy, least, spectrum, out):
    """out = sum over channels of conj(numerator) * spectrum, over energy + least: the answer's spectrum."""
    count, rows, columns, _ = spectrum.shape
    for y in range(rows):
        for x in range(columns):
            out[y, x, 0] = out[y, x, 1] = np.float32(0.0)
        for c in range(count):
            for x in range(columns):
                a_re, a_im = numerator[c, y, x, 0], numerator[c, y, x, 1]
                x_re, x_im = spectrum[c, y, x, 0], spectrum[c, y, x, 1]
                out[y, x, 0] += a_re * x_re + a_im * x_im
                out[y, x, 1] += a_re * x_im - a_im * x_re
        for x in range(columns):
            share = np.float32(1.0) / (energy[y, x] + least)
            out[y, x, 0] *= share
            out[y, x, 1] *= share


@njit(cache=True, fastmath=True, error_model="numpy")
def highest(answer):
    """Row and column of the highest real part, its height, mean and standard deviation of all."""
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
    return best_row, best_column, best, mean, math.sqrt(max(squares / (rows * columns) - mean * mean, 1e-12))


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
    ramp_rows, ramp_columns = phase_ramp(rows, rest_rows), phase_ramp(columns, rest_columns)
    for y in range(rows):
        for x in range(columns):
            r_re = ramp_rows[y, 0] * ramp_columns[x, 0] - ramp_rows[y, 1] * ramp_columns[x, 1]
            r_im = ramp_rows[y, 0] * ramp_columns[x, 1] + ramp_rows[y, 1] * ramp_columns[x, 0]
            l_re = rate * (r_re * label[y, x, 0] + r_im * label[y, x, 1])
            l_im = rate * (r_im * label[y, x, 0] - r_re * label[y, x, 1])
            power = np.float32(0.0)
            for c in range(count):
                t_re, t_im = target[c, y, x, 0], target[c, y, x, 1]
                numerator[c, y, x, 0] = keep * numerator[c, y, x, 0] + l_re * t_re - l_im * t_im
                numerator[c, y, x, 1] = keep * numerator[c, y, x, 1] + l_re * t_im + l_im * t_re
                power += whole[c, y, x, 0] * whole[c, y, x, 0] + whole[c, y, x, 1] * whole[c, y, x, 1]
            energy[y, x] = keep * energy[y, x] + rate * power


class CorrelationFilter:
    """Learns one patch's channels, finds them again, and adapts. `window`: float32 (rows, columns), fades a patch in
    from its ends before it is transformed."""

    def __init__(self, window: np.ndarray, settings: FilterSettings) -> None:
        rows, columns = self._shape = window.shape
        self._window, self._settings = np.repeat(window.astype(np.float32)[..., None], 2, -1), settings
        distance = [(np.arange(n) + n // 2) % n - n // 2 for n in (rows, columns)]
        label = np.exp(-(distance[0][:, None] ** 2 + distance[1][None] ** 2) / (2 * settings.label_cells**2))
        spectrum = np.fft.fft2(label)
        self._label = np.stack([spectrum.real, spectrum.imag], -1).astype(np.float32)
        self._answer = np.empty((rows, columns, 2), np.float32)
        self._whole: np.ndarray | None = None

    def learn(self, channels: np.ndarray, mask: np.ndarray | None = None) -> None:
        """Begin anew with the target in the middle. `mask`: which cells are the target, 0..1; None: the window."""
        self._numerator = np.zeros_like(channels)
        self._energy = np.zeros(self._shape, np.float32)
        self._whole = self._transformed(channels)
        self._take(np.float32(1.0), channels, mask, MIDDLE)
        self._least = np.float32(self._settings.regularisation * self._energy.max() + 1e-6)

    def learn_also(self, channels: np.ndarray, mask: np.ndarray | None, number: int) -> None:
        """One more view of the target, in the middle too: the `number`-th, so that all of them weigh the same."""
        self._whole = self._transformed(channels)
        self._take(np.float32(1 / number), channels, mask, MIDDLE)

    def keep(self) -> None:
        """Remember what is learned by now, for `restore`, `recall` and `familiarity`."""
        self._kept = self._numerator.copy(), self._energy.copy()

    def restore(self) -> None:
        """Forget what was learned since `keep`."""
        self._numerator, self._energy = (part.copy() for part in self._kept)

    def find(self, channels: np.ndarray) -> Peak:
        """Where it is in this patch."""
        self._whole = self._transformed(channels)
        return self._highest(self._answered(self._numerator, self._energy))

    def recall(self, channels: np.ndarray) -> Peak:
        """As `find`, for what was kept. `adapt` needs another `find` first."""
        self._whole = self._transformed(channels)
        return self._highest(self._answered(*self._kept))

    def familiarity(self, peak: Peak) -> float:
        """The sharpness of what was kept at (within a cell of) a peak of the patch that was last looked at."""
        answer = self._answered(*self._kept)
        _, _, _, mean, spread = highest(answer)
        down, right = (
            (round(place) + np.arange(-1, 2)) % n
            for place, n in zip((peak.rows, peak.columns), self._shape, strict=True)
        )
        return float((answer[np.ix_(down, right)][..., 0].max() - mean) / spread)

    def _answered(self, numerator: np.ndarray, energy: np.ndarray) -> np.ndarray:
        respond(numerator, energy, self._least, self._whole, self._answer)
        return cv2.dft(self._answer, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE)

    @staticmethod
    def _highest(answer: np.ndarray) -> Peak:
        row, column, height, mean, spread = highest(answer)
        return Peak(
            height=float(height),
            sharpness=(height - mean) / spread,
            rows=_between(answer[:, column, 0], row),
            columns=_between(answer[row, :, 0], column),
        )

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
            cut = np.empty_like(channels)
            cut_out(channels, down, right, mask, cut)
            target = _transformed(cut)
        rest = peak.rows - down, peak.columns - right
        blend(rate, self._label, *rest, target, self._whole, self._numerator, self._energy)

    def _transformed(self, channels: np.ndarray) -> np.ndarray:
        return _transformed(channels * self._window)


def _transformed(channels: np.ndarray) -> np.ndarray:
    """The spectra of complex channels, in place."""
    for channel in channels:
        cv2.dft(channel, channel)
    return channels


def _between(line: np.ndarray, n: int) -> float:
    """Position of the peak on a circular line from its middle (index 0), refined by a parabola."""
    size = len(line)
    left, middle, right = (float(line[(n + k) % size]) for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    part = min(max(0.5 * (left - right) / bend, -0.5), 0.5) if bend < 0 else 0.0
    return (n + size // 2) % size - size // 2 + part
