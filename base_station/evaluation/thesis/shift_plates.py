"""Figures 4.2 to 4.4: algorithm 4.1, the three causes of its failure one at a time, and the mend."""

from __future__ import annotations

from typing import Any

import numpy as np

from base_station.evaluation.thesis.listings import answer, errors
from base_station.evaluation.thesis.pictures import blacked, view
from base_station.evaluation.thesis.plotting import Palette, Plate

ROW = 199
"""Row 200 of listing A.3, which counts from 1."""
LISTED_SHIFTS, ALL_SHIFTS = np.arange(1, 11), np.arange(1, 101)
TEXT_SHIFTS = (5, 10, 20, 50)
THESIS_Z, MENDED_Z = 0.9, 1.1


def two_images(picture: np.ndarray, dx: int, *, number: int) -> list[Plate]:
    """Figures 4.2 and 4.3, or 4.5 and 4.6: an image, itself moved with zeros coming in, and a row of both."""
    before = view(picture)
    after = blacked(before, dx)

    def draw_images(figure: Any, palette: Palette) -> None:
        for axes, image, title in zip(
            figure.subplots(1, 2), (before, after), ("I1", f"I2: moved by {dx} px"), strict=True
        ):
            axes.imshow(image, cmap="gray", vmin=0, vmax=255)
            axes.axhline(ROW, color=palette.series[1], lw=1.4)
            axes.axvline(before.shape[1] / 2, color=palette.series[0], lw=1, ls=":")
            axes.set(title=title, xticks=[], yticks=[])
            axes.grid(False)

    def draw_rows(figure: Any, palette: Palette) -> None:
        axes = figure.subplots()
        axes.plot(before[ROW], color=palette.series[0], lw=1.2, label="I1")
        axes.plot(after[ROW], color=palette.series[1], lw=1.2, label="I2")
        axes.axvline(before.shape[1] / 2, color=palette.ink, lw=1, ls=":")
        axes.annotate("the middle, n = 0", (before.shape[1] / 2 + 4, 246), fontsize=8.5)
        axes.set(xlabel="column (px)", ylabel="x[n], grey level", ylim=(-5, 262), xlim=(0, before.shape[1] - 1))
        axes.legend(loc="lower left", ncols=2)

    return [
        Plate(
            name=f"figure-4-{number}",
            title=f"Figure 4.{number}: two images artificially shifted",
            thesis="An image, and the same moved to the left with MATLAB's imtranslate, which fills in zeros at the "
            "right.",
            ours=f"A view, and the same moved by {dx} px with zeros at the border. Orange: the row used. Blue: the "
            f"middle, from where listing A.3 reads to the right.",
            alt=f"A grey picture, and the same {abs(dx)} px farther to the left with a black strip at its right "
            f"border.",
            size_in=(8, 3.2),
            draw=draw_images,
        ),
        Plate(
            name=f"figure-4-{number + 1}",
            title=f"Figure 4.{number + 1}: the row to be used as x[n]",
            thesis="Grey levels of the row in both images. (The listing takes row 200, the axis says 100th row.)",
            ours="Row 200 of both. The zeros at the right of I2 are what makes z = 0.9 work, and no camera delivers "
            "them.",
            alt="Two curves of grey levels over the column, the second the first shifted; it ends in zeros.",
            size_in=(9, 2.6),
            draw=draw_rows,
        ),
    ]


def equation_solving(picture: np.ndarray) -> Plate:
    """Figure 4.4: the error of listing A.3 over n0, and the same on a real pair of views."""
    first = view(picture)
    before, listed, real = first[ROW], blacked(first, -10)[ROW], view(picture, -10)[ROW]
    as_listed = np.abs(errors(before, listed, THESIS_Z, LISTED_SHIFTS, as_listed=True))
    on_real = np.abs(errors(before, real, THESIS_Z, LISTED_SHIFTS, as_listed=True))

    def draw(figure: Any, palette: Palette) -> None:
        left, right = figure.subplots(1, 2)
        for axes, values, title in (
            (left, as_listed, "zeros at the border (imtranslate)"),
            (right, on_real, "real pixels at the border"),
        ):
            axes.plot(LISTED_SHIFTS, values, color=palette.series[0], marker="o", ms=4)
            axes.axvline(10, color=palette.good, ls="--", lw=1.2, label="true n0")
            axes.set(title=title, xlabel="n0 (px)", ylabel="|error|", xticks=LISTED_SHIFTS, ylim=(0, None))
            axes.legend()

    return Plate(
        name="figure-4-4",
        title="Figure 4.4: result of the equation solving technique",
        thesis="The error over n0 at z = 0.9, of which the text says that “the solution doesn't converge”. The "
        "figure itself is known by its caption only.",
        ours="Listing A.3 as it stands, its slips included, n0 = 1..10, for a shift of 10. On its own artificial "
        "pair the error does vanish at the true n0, though among numbers of 10¹⁶ and more; on two views of a camera "
        "it has its smallest value at 1 or 2, whatever the shift.",
        alt="Two curves of the error over n0 from 1 to 10. With zeros at the border it falls to zero at 10; with "
        "real pixels it grows from n0 = 1 on.",
        size_in=(9, 3.0),
        draw=draw,
        numbers=(
            ("n0 found, zeros at the border", str(LISTED_SHIFTS[as_listed.argmin()])),
            ("n0 found, real border", str(LISTED_SHIFTS[on_real.argmin()])),
            ("error at n0 = 1, zeros at the border", f"{as_listed[0]:.1e}"),
        ),
    )


def _found(
    pictures: list[np.ndarray], shift: int, z: complex, *, real: bool, listed: bool, shifts: np.ndarray
) -> list[int]:
    answers = []
    for picture in pictures:
        first = view(picture)
        second = view(picture, -shift) if real else blacked(first, -shift)
        answers.append(answer(first[ROW], second[ROW], z, shifts, as_listed=listed))
    return answers


def causes(pictures: list[np.ndarray]) -> Plate:
    """The three causes, each with nothing else wrong: true shift against the n0 found."""
    cases: list[tuple[str, list[tuple[str, dict[str, Any]]]]] = [
        (
            "1. z = 0.9 and the border",
            [
                ("z = 0.9, zeros enter", {"z": THESIS_Z, "real": False, "listed": False, "shifts": ALL_SHIFTS}),
                ("z = 0.9, real pixels enter", {"z": THESIS_Z, "real": True, "listed": False, "shifts": ALL_SHIFTS}),
            ],
        ),
        (
            "2. the excess weighted twice",
            [
                ("z = 1.1, eq. (3.4)", {"z": MENDED_Z, "real": False, "listed": False, "shifts": ALL_SHIFTS}),
                ("z = 1.1, as listed", {"z": MENDED_Z, "real": False, "listed": True, "shifts": ALL_SHIFTS}),
                ("z = 0.9, as listed", {"z": THESIS_Z, "real": False, "listed": True, "shifts": ALL_SHIFTS}),
            ],
        ),
        (
            "3. n0 = 1..10",
            [
                ("n0 = 1..100", {"z": THESIS_Z, "real": False, "listed": True, "shifts": ALL_SHIFTS}),
                ("n0 = 1..10", {"z": THESIS_Z, "real": False, "listed": True, "shifts": LISTED_SHIFTS}),
            ],
        ),
        (
            "mended: all three",
            [
                ("z = 1.1, real pixels enter", {"z": MENDED_Z, "real": True, "listed": False, "shifts": ALL_SHIFTS}),
            ],
        ),
    ]
    truths = (3, 5, 8, 10, 15, 20, 30, 40, 50, 70)
    curves = {
        name: [float(np.median(_found(pictures, shift, **case))) for shift in truths]
        for _, entries in cases
        for name, case in entries
    }

    def draw(figure: Any, palette: Palette) -> None:
        for axes, (title, entries) in zip(figure.subplots(1, 4, sharey=True), cases, strict=True):
            axes.plot((0, 75), (0, 75), color=palette.faint, lw=5, zorder=0)
            for index, (name, _) in enumerate(entries):
                color = palette.good if title.startswith("mended") else palette.series[index]
                style = {"marker": "osv"[index], "ms": 6 - 1.5 * index, "lw": 1.3, "color": color}
                axes.plot(truths, curves[name], label=name, **style)
            axes.set(title=title, xlabel="true shift (px)", xlim=(0, 75), ylim=(-2, 102))
            axes.legend(loc="upper left")
        figure.axes[0].set_ylabel("n0 found (px), median")

    numbers = [
        (
            f"{name}: shifts {', '.join(map(str, TEXT_SHIFTS))} read as",
            ", ".join(f"{curves[name][truths.index(s)]:.0f}" for s in TEXT_SHIFTS),
        )
        for name in curves
    ]
    return Plate(
        name="figure-4-4-causes",
        title="Why algorithm 4.1 did not work: three causes apart, and the mend",
        thesis="“Changing the parameters won't be the solution”, says section 4.2. It is: |z| > 1 with the equation "
        "as it stands in chapter 3.",
        ours=f"Medians over {len(pictures)} pictures; the broad grey line is right. 1: the weights of z = 0.9 grow, "
        f"so that the pixels that enter at the border are the signature; only zeros there are harmless. 2: the "
        f"listing multiplies the excess pixels by z^n0 twice, invisible at 0.9 (the excess is nothing beside 10¹⁶), "
        f"wrong at 1.1. 3: it tries n0 = 1..10, the text says 1..100 and shifts by 20. Mended: z = 1.1, eq. (3.4), "
        f"n0 = 1..100, real border.",
        alt="Four plots of the shift found against the true one. Zeros at the border: right; real pixels: always 1. "
        "Eq. 3.4: right; as listed at z = 1.1: wrong. n0 up to 100: right; up to 10: never above 10. Mended: right.",
        size_in=(11, 3.3),
        draw=draw,
        numbers=tuple(numbers),
        for_readme=True,
    )


def which_z(pictures: list[np.ndarray]) -> Plate:
    """How often algorithm 4.1 (equation as in chapter 3) is right, over z, for both kinds of border."""
    zs = np.array([0.8, 0.85, 0.9, 0.95, 0.98, 1.01, 1.02, 1.03, 1.05, 1.1, 1.2, 1.3, 1.5])
    shifts = (3, 10, 20, 35, 50)

    def share(z: float, real: bool) -> float:
        return float(
            np.mean(
                [
                    found == shift
                    for shift in shifts
                    for found in _found(pictures, shift, z, real=real, listed=False, shifts=ALL_SHIFTS)
                ]
            )
        )

    zeros, reals = ([100 * share(z, real) for z in zs] for real in (False, True))

    def draw(figure: Any, palette: Palette) -> None:
        axes = figure.subplots()
        axes.plot(zs, zeros, color=palette.series[1], marker="o", ms=4, label="zeros enter at the border")
        axes.plot(zs, reals, color=palette.series[0], marker="s", ms=4, label="real pixels enter")
        axes.axvline(1, color=palette.ink, lw=1, ls=":")
        axes.annotate("weights grow", (0.99, 45), ha="right", fontsize=9)
        axes.annotate("weights fade", (1.03, 45) if reals[5] < 20 else (1.2, 45), xytext=(1.15, 45), fontsize=9)
        axes.set(xlabel="z", ylabel="found exactly (%)", ylim=(-4, 108))
        axes.legend(loc="center right")

    at = dict(zip(zs.round(2).tolist(), reals, strict=True))
    return Plate(
        name="figure-4-4-z",
        title="Which z? Algorithm 4.1 over z",
        thesis="z = 0.9 alone; a z of 0.9 + 0.9j, of size 1.27, stands in the listings as a comment. It would have "
        "worked.",
        ours=f"Share of {len(shifts)} shifts in {len(pictures)} pictures found exactly. Just above 1 is not enough: "
        f"1.02⁻³²⁰ is still 0.002, and that much of the border's pixels comes through. From 1.05 on nothing does.",
        alt="Two curves over z. With zeros at the border always 100 percent; with real pixels 0 below z = 1, rising "
        "to 100 at 1.05.",
        size_in=(7, 3.0),
        draw=draw,
        numbers=(
            *((f"real border, z = {z}: found exactly", f"{at[z]:.0f} %") for z in (0.9, 1.01, 1.02, 1.05, 1.1)),
            (
                "real border, z = 0.9 + 0.9j, shifts 5, 10, 20, 50 (median n0)",
                ", ".join(
                    f"{np.median(_found(pictures, s, 0.9 + 0.9j, real=True, listed=False, shifts=ALL_SHIFTS)):.0f}"
                    for s in TEXT_SHIFTS
                ),
            ),
        ),
    )
