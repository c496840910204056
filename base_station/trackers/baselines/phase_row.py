"""Phase correlation of rows: the Fourier transform in the place of the Z-transform, on the same few numbers.

The thesis asks why not the Fourier transform; this is what it does. The target's rows are averaged to a few bands, and
the bands where the target was last are compared with the learned ones in one dimension. A shift that is large against
the target leaves little in common under the window, so it is found in two passes. It knows neither height nor distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from base_station.trackers.baselines.patch import (
    LEAST_CONTRAST,
    Found,
    Learned,
    Missed,
    RowsOfPatch,
    agreement,
    cut,
    gone,
    peak_offset,
)


@dataclass(frozen=True, kw_only=True)
class PhaseRowSettings:
    """What is read, and when to believe it."""

    bands: int = 4
    """The target's rows are averaged to so many signals."""
    passes: int = 2
    least_agreement: float = 0.5
    """Correlation of the learned bands with those at the peak."""


class PhaseRowTracker(RowsOfPatch):
    """One-dimensional, with numpy's FFT."""

    def __init__(self, *, settings: PhaseRowSettings | None = None) -> None:
        super().__init__()
        self._settings = settings or PhaseRowSettings()

    @property
    def landmark_bytes(self) -> int:
        """What must be kept to find it again: the bands."""
        return int(self._bands.nbytes)

    def _prepare(self, image: np.ndarray, patch: np.ndarray, learned: Learned) -> None:
        columns = learned.shape[1]
        self._window = np.hanning(columns + 2)[1:-1].astype(np.float32)
        self._bands = self._read(patch)
        if float(self._bands.std()) < LEAST_CONTRAST / 2:
            raise ValueError(f"featureless: the rows' contrast is {self._bands.std():.1f} grey levels")

    def _read(self, patch: np.ndarray) -> np.ndarray:
        """(bands, columns), each less its mean and under the window."""
        parts = np.array_split(patch, self._settings.bands)
        bands = np.stack([part.mean(0) for part in parts])
        return np.asarray((bands - bands.mean(1, keepdims=True)) * self._window)

    def _look(self, image: np.ndarray, learned: Learned) -> Found | Missed:
        (rows, columns), y = learned.shape, learned.center_px[1]
        x = learned.center_px[0] if learned.is_place else self._last.x
        for _ in range(self._settings.passes):
            x += _shift_px(self._bands, self._read(cut(image, x, y, columns, rows)))
        alike = agreement(self._bands, self._read(cut(image, x, y, columns, rows)))
        return Found(x=x, confidence=alike) if alike >= self._settings.least_agreement else gone(alike)


def _shift_px(learned: np.ndarray, seen: np.ndarray) -> float:
    """How far the seen bands are to the right of the learned ones. The peak of the phase correlation is as wide as the
    window's spectrum makes it, and has a parabola's top."""
    size = learned.shape[1]
    cross = np.fft.rfft(learned, axis=1).conj() * np.fft.rfft(seen, axis=1)
    whitened = (cross / (np.abs(cross) + 1e-9)).mean(0)
    soft = np.exp(-0.5 * (np.fft.rfftfreq(size) / 0.2) ** 2)  # a Gaussian peak, which a parabola fits in its logarithm
    peaks = np.fft.irfft(whitened * soft, size)
    top = int(np.argmax(peaks))
    around = np.log(np.maximum(peaks[[top - 1, top, (top + 1) % size]], 1e-9))
    shift = top + peak_offset(*around.tolist())
    return shift if shift <= size / 2 else shift - size
