"""Figures of the method that came of it: windows of the poles, the recursion as a look-up, zoom along the scales."""

from __future__ import annotations

from typing import Any

import numpy as np

from base_station.evaluation.thesis.pictures import COLUMNS, view
from base_station.evaluation.thesis.plotting import Palette, Plate
from base_station.trackers.ztransform import reference
from base_station.trackers.ztransform.poles import PoleSettings, decay_rates, spiral_poles


def windows() -> Plate:
    """What a pole sees about its anchor: real, complex, second order."""
    u = np.arange(0, 61)
    reach = 12.0
    real, turning = np.exp(-u / reach), np.exp(-(1 + 2j) * u / reach)
    second = u * turning

    def draw(figure: Any, palette: Palette) -> None:
        panels = figure.subplots(1, 3, sharex=True)
        panels[0].plot(u, real, color=palette.series[0], label="z = 1.087")
        panels[0].plot(u, 0.05 * 0.9**-u, color=palette.series[1], label="z = 0.9 (times 0.05)")
        panels[0].set(title="real, first order: z⁻ᵘ", ylabel="weight", ylim=(-1.1, 1.5))
        for axes, values, title in (
            (panels[1], turning, "on the spiral: exp(-s(1 + 2j)u)"),
            (panels[2], second / np.abs(second).max(), "second order: u exp(-s(1 + 2j)u)"),
        ):
            axes.plot(u, values.real, color=palette.series[0], label="real part")
            axes.plot(u, values.imag, color=palette.series[2], label="imaginary part")
            axes.plot(u, np.abs(values), color=palette.ink, lw=1, ls=":", label="size")
            axes.set(title=title, ylim=(-1.1, 1.5))
        for axes in panels:
            axes.set_xlabel("distance u from the anchor (px)")
            axes.legend(loc="lower right" if axes is panels[0] else "upper right")

    return Plate(
        name="method-windows",
        title="The windows of the poles",
        thesis="A real z, 0.9: the weight grows with the distance.",
        ours="|z| > 1 fades over 1/s pixels (here 12). A complex z turns besides: its phase is position to a fraction "
        "of a pixel. The second order starts at zero, so that nothing jumps when a pixel passes the anchor.",
        alt="Three plots of weights over the distance from the anchor: fading and growing exponentials; a fading "
        "oscillation; the same starting at zero.",
        size_in=(10.5, 3.0),
        draw=draw,
        for_readme=True,
    )


def recursion(picture: np.ndarray) -> Plate:
    """R(m) for every column, and which column has what the moved row has at its anchor."""
    shift, anchor = -37, COLUMNS // 2
    before, after = (view(picture, dx)[200].astype(float) for dx in (0, shift))
    poles = [np.exp((1 + 2j) / reach) for reach in (8.0, 24.0)]
    fields = [reference.recursive_transform(np.gradient(before), z) for z in poles]
    seen = [reference.one_sided_transform(np.gradient(after), anchor, z) for z in poles]
    distance = np.sqrt(sum(np.abs(field - value) ** 2 for field, value in zip(fields, seen, strict=True)))
    columns = np.arange(COLUMNS)
    found = int(distance[: COLUMNS - 60].argmin())

    def draw(figure: Any, palette: Palette) -> None:
        rows = figure.subplots(3, 1, sharex=True)
        rows[0].plot(columns, before, color=palette.series[0], lw=1, label="learned row")
        rows[0].plot(columns, after, color=palette.series[1], lw=1, label=f"row now: moved by {shift} px")
        rows[0].set(ylabel="grey level", ylim=(0, 330))
        rows[0].legend(ncols=2, loc="upper left")
        for field, color, reach in zip(fields, palette.series[2:], (8, 24), strict=False):
            rows[1].plot(columns, np.abs(field), color=color, lw=1.1, label=f"reach {reach} px")
        rows[1].set(ylabel="|R(m; z)|", ylim=(0, 1.45 * max(np.abs(field).max() for field in fields)))
        rows[1].legend(ncols=2, loc="upper left")
        rows[2].plot(columns, distance, color=palette.ink, lw=1.1)
        rows[2].plot(found, distance[found], "o", color=palette.bad)
        rows[2].annotate(
            f"column {found} = {anchor} + {found - anchor}",
            (found, distance[found]),
            (found + 12, 0.06 * distance.max()),
            fontsize=9,
        )
        rows[2].axvline(anchor, color=palette.ink, lw=1, ls=":")
        rows[2].set(xlabel="column m (px)", ylabel="distance to now", xlim=(0, COLUMNS - 1), ylim=(0, None))

    return Plate(
        name="method-recursion",
        title="The recursion turns solving for n0 into a look-up",
        thesis="Named as future work: “the recursive method of the algorithm has been implemented by Dr. Blanchard”.",
        ours="R(m; z) = x[m] + R(m + 1; z)/z gives the transform about every column of the learned row in one sweep. "
        "The row now is transformed about its middle (dotted) alone; the learned column with those numbers tells the "
        "shift.",
        alt="Three plots over the column: two rows of grey levels; the size of the transform about every column at two "
        "reaches; the distance to the transform seen now, zero at the column that tells the shift.",
        size_in=(9, 4.8),
        draw=draw,
        numbers=(
            ("shift found (true -37)", f"{anchor - found}"),
            (
                "multiply-adds for all 640 columns and one z: summed out, by recursion",
                f"{COLUMNS * (COLUMNS + 1) // 2}, {COLUMNS}",
            ),
        ),
        for_readme=True,
    )


def zoom() -> Plate:
    """A signal and itself enlarged: the same signature, read further along the scales."""
    bank = PoleSettings(count=17, longest_cells=400.0, shortest_cells=6.25)
    rates, steps = decay_rates(bank), 3
    g = float(rates[steps] / rates[0])
    u = np.arange(6000.0)

    def signal(x: np.ndarray) -> np.ndarray:
        return np.exp(-(((x - 45) / 20) ** 2)) - 0.8 * np.exp(-(((x - 100) / 25) ** 2))

    one, other = (
        np.array([abs(np.sum(values * pole**u)) for pole in spiral_poles(bank)])
        for values in (signal(u), signal(u / g))
    )
    index = np.arange(bank.count)
    off = np.abs(other[:-steps] / g - one[steps:]).max() / one.max()

    def draw(figure: Any, palette: Palette) -> None:
        left, right = figure.subplots(1, 2)
        left.plot(u[:320], signal(u[:320]), color=palette.series[0], label="learned")
        left.plot(u[:320], signal(u[:320] / g), color=palette.series[1], label=f"enlarged {g:.2f} times")
        left.set(
            title="a signal about its anchor", xlabel="distance from the anchor (px)", ylabel="value", ylim=(-1, 1.5)
        )
        left.legend(ncols=2, loc="upper left")
        right.plot(index, one, color=palette.series[0], marker="o", ms=4, label="learned: |X(s)|")
        right.plot(index, other / g, color=palette.series[1], marker="s", ms=4, label="enlarged: |X(s)| / g")
        right.annotate(
            "",
            (index[5], other[5] / g),
            (index[5 + steps], one[5 + steps]),
            arrowprops={"arrowstyle": "->", "color": palette.ink},
        )
        right.set(
            title=f"its signature: {steps} scales farther along",
            xlabel="index of the scale s",
            ylabel="size",
            ylim=(0, 1.3 * one.max()),
        )
        right.legend(loc="upper left")

    return Plate(
        name="method-zoom",
        title="Zoom is a shift along the scale index",
        thesis="Future work: “the zooming algorithm of the z-transform code”.",
        ours="A signal enlarged by g has the transform g X(g s). With the rates s in a geometric series, that is the "
        "same curve moved along the index: zoom is found as a shift is.",
        alt="Left: a signal and itself enlarged. Right: the sizes of their transforms over the index of the scale, "
        "the same curve moved by three.",
        size_in=(9.5, 3.2),
        draw=draw,
        numbers=(("largest difference of the curves, moved over one another", f"{100 * off:.2g} % of the peak"),),
        for_readme=True,
    )
