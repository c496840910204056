"""Figures 4.5 to 4.7: algorithm 4.2, what its greatest change says, and what the tracker z-regions makes of it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from base_station.evaluation.thesis.listings import regions
from base_station.evaluation.thesis.pictures import CAMERA, COLUMNS, blacked, frame, view
from base_station.evaluation.thesis.plotting import Palette, Plate
from base_station.evaluation.thesis.shift_plates import ROW
from base_station.trackers.ztransform.thesis.z_regions import ZRegionsSettings, ZRegionsTracker

ZS, COUNT, SHIFT = (0.7, 0.8, 0.9), 4, 20


def greatest_change(pictures: list[np.ndarray]) -> Plate:
    """Figure 4.7: differences of each region, and which region has the greatest in many pictures."""
    first = view(pictures[0])
    pairs = {"zeros at the border": blacked(first, -SHIFT), "real pixels at the border": view(pictures[0], -SHIFT)}
    changes = {
        name: [np.abs(regions(first[ROW], z, COUNT) - regions(second[ROW], z, COUNT)) for z in ZS]
        for name, second in pairs.items()
    }
    votes = {"zeros, left": np.zeros(COUNT), "real, left": np.zeros(COUNT), "real, right": np.zeros(COUNT)}
    for picture in pictures:
        one = view(picture)
        others = (blacked(one, -SHIFT), view(picture, -SHIFT), view(picture, SHIFT))
        for row in range(40, 440, 40):
            here = regions(one[row], 0.9, COUNT)
            for name, other in zip(votes, others, strict=True):
                votes[name][np.abs(here - regions(other[row], 0.9, COUNT)).argmax()] += 1
    shares = {name: 100 * count / count.sum() for name, count in votes.items()}

    def draw(figure: Any, palette: Palette) -> None:
        axes_row = figure.subplots(1, 3, width_ratios=(1, 1, 1.2))
        where = np.arange(1, COUNT + 1)
        for axes, (name, per_z) in zip(axes_row, changes.items(), strict=False):
            for index, (z, values) in enumerate(zip(ZS, per_z, strict=True)):
                axes.bar(
                    where + 0.26 * (index - 1),
                    values / values.max(),
                    0.24,
                    color=palette.series[index],
                    label=f"z = {z}",
                )
            axes.set(title=name, xlabel="region", xticks=where, ylabel="|X before - X after| / greatest", ylim=(0, 1.3))
            axes.legend(ncols=3, columnspacing=0.8, handlelength=1, loc="upper left")
        for index, (name, share) in enumerate(shares.items()):
            axes_row[2].bar(where + 0.26 * (index - 1), share, 0.24, color=palette.series[3 + index], label=name)
        axes_row[2].axhline(100 / COUNT, color=palette.ink, lw=1, ls=":")
        axes_row[2].set(
            title="greatest change is in…", xlabel="region", xticks=where, ylabel="share of rows (%)", ylim=(0, 125)
        )
        axes_row[2].legend(ncols=3, columnspacing=0.8, handlelength=1, loc="upper left")

    rows = len(pictures) * 10
    return Plate(
        name="figure-4-7",
        title="Figure 4.7: maximum difference in z-values of each region",
        thesis="z = 0.9, four regions, a shift of -20: the greatest difference is in the first region, “which is "
        "correct because we shifted the image -20 (negative means to the left)”.",
        ours=f"Left and middle: one row. Right: {rows} rows of {len(pictures)} pictures. When the whole view moves, "
        f"every region changes. With zeros at the border the last region wins, because z⁻ⁿ makes its last pixels, now "
        f"zeros, the heaviest; with real pixels each wins about as often (dotted: chance), for a shift to the left "
        f"and to the right alike. So the thesis's first region is one picture's chance, and no sign of the direction.",
        alt="Bars of the difference per region for three z; bars of how often each region has the greatest "
        "difference: with zeros always the fourth, with real pixels each about a quarter.",
        size_in=(11, 3.2),
        draw=draw,
        numbers=tuple(
            (f"{name}: region 1, 2, 3, 4 wins", ", ".join(f"{value:.0f} %" for value in share))
            for name, share in shares.items()
        ),
    )


def moving_thing(pictures: list[np.ndarray]) -> Plate:
    """What 4.2 can do: the bearing of a thing that moves before a still background."""
    truth = np.linspace(30, COLUMNS - 31, 41)
    found: dict[int, list[float]] = {}
    for count in (4, 16):
        found[count] = []
        for number, picture in enumerate(pictures):
            background = view(picture)
            tracker = ZRegionsTracker(settings=ZRegionsSettings(regions=count))
            tracker.learn(frame(background, 1), None)
            for x in truth:
                result = tracker.update(frame(_with_thing(background, x), 2 + number))
                found[count].append(np.nan if result.bearing_rad is None else np.degrees(result.bearing_rad))
    true_deg = np.degrees([CAMERA.bearing_rad(x) for x in truth])
    offs = {count: np.abs(np.array(values) - np.tile(true_deg, len(pictures))) for count, values in found.items()}

    def draw(figure: Any, palette: Palette) -> None:
        axes = figure.subplots()
        axes.plot(true_deg, true_deg, color=palette.faint, lw=5, zorder=0)
        for color, (count, values) in zip((palette.series[1], palette.series[0]), found.items(), strict=True):
            axes.plot(np.tile(true_deg, len(pictures)), values, ".", color=color, ms=4, label=f"{count} regions")
        axes.set(xlabel="true bearing of the thing (degrees)", ylabel="bearing told (degrees)")
        axes.legend()

    return Plate(
        name="figure-4-7-mended",
        title="What algorithm 4.2 is good for: where something moves",
        thesis="“The maximum change in z values is the region of the shift.”",
        ours="True as long as the camera stands still and the regions are small. A thing 40 px wide before a still "
        "background; the tracker z-regions tells the middle of the region that changed most. It reads each region "
        "from both ends, over the sum of the weights; with the thesis's 4 regions a thing in the middle of one is "
        "out of sight.",
        alt="Told bearing over true bearing: with 16 regions a fine staircase along the diagonal, with 4 a coarse one.",
        size_in=(6, 3.4),
        draw=draw,
        numbers=tuple(
            (f"{count} regions: bearing error, median and worst", f"{np.nanmedian(off):.1f}°, {np.nanmax(off):.1f}°")
            for count, off in offs.items()
        ),
    )


def _with_thing(background: np.ndarray, x: float) -> np.ndarray:
    image = background.copy()
    left, right = round(x - 19.5), round(x + 19.5)
    under = float(background[190:290, max(left, 0) : right + 1].mean())
    cv2.rectangle(image, (left, 180), (right, 300), 240.0 if under < 128 else 10.0, -1)
    return image
