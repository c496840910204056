"""The compiled parts of the correlation filter do what a line of numpy says."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.ztransform.channels import light_channel
from base_station.trackers.ztransform.correlation import (
    CorrelationFilter,
    FilterSettings,
    blend,
    cut_out,
    fade,
    highest,
    highest_near,
    respond,
)

COUNT, ROWS, COLUMNS = 3, 12, 18


def parts(seed: int, *shape: int) -> np.ndarray:
    """Real and imaginary parts, last."""
    return np.random.default_rng(seed).normal(size=(*shape, 2)).astype(np.float32)


def as_complex(both: np.ndarray) -> np.ndarray:
    return both[..., 0] + 1j * both[..., 1]


def some(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 1, (ROWS, COLUMNS)).astype(np.float32)


def test_a_patch_is_faded_cell_by_cell():
    channels, window = parts(0, COUNT, ROWS, COLUMNS), some(1)
    out = np.empty_like(channels)
    fade(channels, window, out)
    assert out == pytest.approx(channels * window[..., None])


@pytest.mark.parametrize(("down", "right"), [(0, 0), (3, -4), (-5, 6), (ROWS, 0), (0, COLUMNS), (-ROWS - 2, -40)])
def test_what_is_cut_out_comes_to_the_middle(down, right):
    channels, mask = parts(0, COUNT, ROWS, COLUMNS), some(1)
    padded = np.pad(channels, ((0, 0), (60, 60), (60, 60), (0, 0)))
    expected = padded[:, 60 + down : 60 + down + ROWS, 60 + right : 60 + right + COLUMNS] * mask[..., None]
    out = np.full_like(channels, np.nan)
    cut_out(channels, down, right, mask, out)
    assert out == pytest.approx(expected)


def test_the_answer_is_the_learned_times_what_is_seen_over_the_energy():
    numerator, spectrum, energy = parts(0, COUNT, ROWS, COLUMNS), parts(1, COUNT, ROWS, COLUMNS), some(2)
    out = np.empty((ROWS, COLUMNS, 2), np.float32)
    respond(numerator, energy, np.float32(0.2), spectrum, out)
    expected = (as_complex(numerator).conj() * as_complex(spectrum)).sum(0) / (energy + 0.2)
    assert as_complex(out) == pytest.approx(expected, abs=1e-4)


def test_a_share_of_the_new_is_taken_moved_back_by_the_rest():
    target, whole = parts(0, COUNT, ROWS, COLUMNS), parts(1, COUNT, ROWS, COLUMNS)
    numerator, label, energy = parts(2, COUNT, ROWS, COLUMNS), parts(3, ROWS, COLUMNS), some(4)
    rate, down, right = 0.25, 0.3, -0.4
    ramp = np.exp(2j * np.pi * (np.fft.fftfreq(ROWS)[:, None] * down + np.fft.fftfreq(COLUMNS)[None] * right))
    taken = as_complex(target) * ramp * as_complex(label).conj()
    # at the highest even frequency a rest has no one meaning; there both signs are as good
    inner = np.ix_(range(COUNT), [i for i in range(ROWS) if i != ROWS // 2], [i for i in range(COLUMNS) if i != 9])
    expected = 0.75 * as_complex(numerator) + rate * taken
    expected_energy = 0.75 * energy + rate * (np.abs(as_complex(whole)) ** 2).sum(0)
    blend(np.float32(rate), label, down, right, target, whole, numerator, energy)
    assert as_complex(numerator)[inner] == pytest.approx(expected[inner], abs=1e-4)
    assert energy == pytest.approx(expected_energy, rel=1e-4)


@pytest.mark.parametrize(("row", "column"), [(0.0, 0.0), (2.3, -4.4), (-5.25, 7.5), (-0.4, 0.2)])
def test_the_peak_is_found_between_cells_and_round_the_border(row, column):
    y, x = np.fft.fftfreq(ROWS, 1 / ROWS)[:, None] - row, np.fft.fftfreq(COLUMNS, 1 / COLUMNS)[None] - column
    y, x = (y + ROWS / 2) % ROWS - ROWS / 2, (x + COLUMNS / 2) % COLUMNS - COLUMNS / 2
    answer = np.zeros((ROWS, COLUMNS, 2), np.float32)
    answer[..., 0] = 9 - y**2 - 2 * x**2
    height, sharpness, found_row, found_column, mean, spread = highest(answer)
    real = answer[..., 0].astype(float)
    assert (found_row, found_column) == pytest.approx((row, column), abs=1e-4)
    assert (height, mean, spread) == pytest.approx((real.max(), real.mean(), real.std()), rel=1e-4)
    assert sharpness == pytest.approx((real.max() - real.mean()) / real.std(), rel=1e-4)
    assert highest_near(answer, round(row), round(column)) == real.max()
    assert highest_near(answer, round(row) + 4, round(column)) < real.max()


def test_a_look_without_the_likelihoods_is_that_of_channels_without_them():
    one = CorrelationFilter(some(0), FilterSettings(label_cells=0.8, regularisation=1e-3, rate=0.03))
    channels, seen = parts(1, COUNT, ROWS, COLUMNS), parts(2, COUNT, ROWS, COLUMNS)
    one.learn(channels)
    without = seen.copy()
    without[-1, ..., 1] = 0
    expected = one.find(without)
    one.find(seen)
    found = one.find_without(seen)
    assert (found.height, found.sharpness) == pytest.approx((expected.height, expected.sharpness), rel=1e-4)
    assert (found.rows, found.columns) == pytest.approx((expected.rows, expected.columns), abs=1e-3)


def test_the_light_says_how_likely_its_grey_level_is():
    patch = np.random.default_rng(0).integers(0, 256, (16, 16)).astype(np.float32)
    likelihood = np.linspace(-1, 1, 32).astype(np.float32) ** 3
    out = np.empty((16, 16, 2), np.float32)
    light_channel(patch, likelihood, np.float32(2), out)
    assert out[..., 0] == pytest.approx((patch - patch.mean()) / patch.std(), abs=1e-4)
    assert out[..., 1] == pytest.approx(2 * np.interp(patch, np.arange(32) * 8 + 4, likelihood), abs=1e-2)
