"""Figures 2.5, 2.6 and 3.5: what the transform is, and why not Fourier's."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np

from base_station.evaluation.thesis.listings import half, transform
from base_station.evaluation.thesis.pictures import ROWS, view
from base_station.evaluation.thesis.plotting import Palette, Plate

STEP_LOW, STEP_HIGH, STEP_FROM, STEP_TO, STEP_LENGTH = 0.2, 0.5, 10, 70, 100
"""The signal of figure 2.5; its length is not told, 100 fits the text."""


def fourier_and_z() -> Plate:
    """Figure 2.5: the summands of both transforms, and what each loses when the signal is cut short."""
    n = np.arange(STEP_LENGTH)
    signal = np.where((n >= STEP_FROM) & (n <= STEP_TO), STEP_HIGH, STEP_LOW)
    z, omega = 1.1, 2 * np.pi * 3 / STEP_LENGTH
    fading, turning = signal * z**-n, signal * np.exp(-1j * omega * n)

    def lost(summands: np.ndarray) -> np.ndarray:
        """Share of the result that the summands from n on make."""
        return np.abs(np.cumsum(summands[::-1])[::-1]) / np.abs(summands.sum())

    def draw(figure: Any, palette: Palette) -> None:
        left, middle, right = figure.subplots(1, 3)
        left.step(n, signal, where="mid", color=palette.ink)
        left.set(title="the signal x[n]", xlabel="n (pixel)", ylabel="value", ylim=(0, 0.6))
        middle.plot(n, turning.real, color=palette.series[2], label="Fourier: Re x[n] exp(-jωn)")
        middle.plot(n, fading, color=palette.series[4], label=f"Z: x[n] z⁻ⁿ, z = {z}")
        middle.axvspan(60, 70, color=palette.faint, alpha=0.6, lw=0)
        middle.set(title="what each pixel adds", xlabel="n (pixel)", ylim=(-0.6, 0.85))
        middle.legend(loc="upper right")
        right.semilogy(n, lost(turning), color=palette.series[2], label="Fourier")
        right.semilogy(n, lost(fading), color=palette.series[4], label="Z")
        right.set(title="lost without pixels n…", xlabel="n (pixel)", ylabel="share of the result", ylim=(1e-5, 10))
        right.legend(loc="lower left")

    return Plate(
        name="figure-2-5",
        title="Figure 2.5: Fourier transform against Z-transform",
        thesis="A step of 0.5 (pixels 10 to 70, else 0.2): the Fourier transform goes on fluctuating, the Z-transform "
        "decays, so that a part of the signal far from its start may be neglected. Given as the main reason to use Z.",
        ours="The same signal. The argument holds, with one condition that the thesis does not keep: z⁻ⁿ decays for "
        "|z| > 1 only. At its z = 0.9 the far pixels outweigh the near ones.",
        alt="Three plots: the step signal; the summands of the Fourier transform, which keep turning, and of the "
        "Z-transform, which fade; the share of either result that is lost when pixels from n on are left out.",
        size_in=(10, 2.9),
        draw=draw,
        numbers=(
            (f"share of X(z), z = {z}, that pixels 60 and on make", f"{100 * lost(fading)[60]:.1f} %"),
            ("the same of the Fourier transform, 3 periods", f"{100 * lost(turning)[60]:.0f} %"),
            ("the same of X(z), z = 0.9", f"{100 * lost(signal * 0.9**-n)[60]:.0f} %"),
        ),
    )


def laplace_cells() -> Plate:
    """Figure 2.6 a, b: Laplace cells after an input, and Post's inverse of them."""
    t = np.linspace(0, 10, 600)
    rates, peaks, order = np.geomspace(0.2, 3, 7), np.geomspace(0.6, 8, 7), 8

    def time_cell(peak: float) -> np.ndarray:
        """Post's inverse of exp(-s t) at s = order / peak: s^(k+1) t^k exp(-s t) / k!, the input being at t = 0."""
        s = order / peak
        return s ** (order + 1) * t**order * np.exp(-s * t) / factorial(order)

    cells = [time_cell(peak) for peak in peaks]

    def draw(figure: Any, palette: Palette) -> None:
        left, right = figure.subplots(1, 2)
        for index, (rate, cell) in enumerate(zip(rates, cells, strict=True)):
            color = palette.series[index]
            left.plot(t, np.exp(-rate * t), color=color, label=f"s = {rate:.2g}")
            right.plot(t, cell / cell.max(), color=color)
        left.set(
            title="Laplace cells: F(s) after an input at t = 0", xlabel="time since the input (s)", ylabel="firing"
        )
        left.legend(ncols=2)
        right.set(title=f"time cells: Post's inverse, order k = {order}", xlabel="time since the input (s)")

    def width(cell: np.ndarray) -> float:
        above = t[cell > cell.max() / 2]
        return float(above[-1] - above[0])

    return Plate(
        name="figure-2-6",
        title="Figure 2.6: the Laplace transform in the brain",
        thesis="After Howard and others (2018): cells that decay at different rates hold the Laplace transform of the "
        "past; sequentially active cells hold its inverse, later ones with wider fields.",
        ours="Both computed. Each time cell is a bank of neighbouring Laplace cells, combined with the k-th "
        "derivative in s. The tracker takes k = 1: its second-order window u exp(-su) peaks away from the anchor, "
        "as a time cell does.",
        alt="Left: seven exponentials that decay at different rates. Right: seven bumps, one after another, "
        "the later the wider.",
        size_in=(10, 3.0),
        draw=draw,
        numbers=(
            (
                "width of a time cell's field over its peak time: first cell, fourth (the same: logarithmic)",
                f"{width(cells[0]) / peaks[0]:.2f}, {width(cells[3]) / peaks[3]:.2f}",
            ),
        ),
        for_readme=True,
    )


def row_and_transform(picture: np.ndarray) -> Plate:
    """Figure 3.5: a row, the weights, and what is summed, at three z."""
    row = half(view(picture)[ROWS // 2])
    n = np.arange(len(row))
    zs = (0.9, 1.0, 1.1)

    def last_share(z: float) -> float:
        weights = row * z**-n
        return float(weights[-10:].sum() / weights.sum())

    def draw(figure: Any, palette: Palette) -> None:
        left, middle, right = figure.subplots(1, 3)
        left.plot(n, row, color=palette.ink, lw=1)
        left.set(title="half a row, x[n]", xlabel="n (pixels from the middle)", ylabel="grey level", ylim=(0, 260))
        for z, color in zip(zs, palette.series, strict=False):
            middle.semilogy(n, z**-n, color=color, label=f"z = {z}")
            parts = np.cumsum(row * z**-n)
            right.plot(n, parts / parts[-1], color=color, label=f"z = {z}")
        middle.set(title="weights z⁻ⁿ", xlabel="n (pixels from the middle)", ylabel="weight")
        middle.legend()
        right.set(title="X(z), summed up to n", xlabel="n (pixels from the middle)", ylabel="share of X(z)")
        right.legend(loc="center")

    return Plate(
        name="figure-3-5",
        title="Figure 3.5: the Z-transform of a row",
        thesis="“Each application of the theorem is expected to be as in the following graph”: the transform on the "
        "signal x[n].",
        ours="The right half of the middle row, the weights z⁻ⁿ and the sum as it grows, at three z. With 0.9 the "
        "sum is the last few pixels, with 1.1 the first few, which are about the anchor.",
        alt="Three plots: grey levels of half a row; the weights, growing for z = 0.9 and fading for z = 1.1; the "
        "running sum, which for 0.9 rises at the very end and for 1.1 at the very start.",
        size_in=(10, 2.9),
        draw=draw,
        numbers=(
            *((f"share of X({z}) that the last 10 pixels make", f"{100 * last_share(z):.2g} %") for z in zs),
            ("weight of the last pixel over the first, z = 0.9", f"{0.9 ** -float(n[-1]):.1e}"),
            ("X(0.9), X(1.1)", f"{float(transform(row, 0.9).real):.2e}, {float(transform(row, 1.1).real):.0f}"),
        ),
    )
