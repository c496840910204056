"""The comparison as figures: the scenes, who is right where, brightness, cost."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from base_station.evaluation.thesis.comparison import CASES, GAINS, TARGET, WITHIN_PX, Tally
from base_station.evaluation.thesis.pictures import SCENES, view
from base_station.evaluation.thesis.plotting import Palette, Plate

ORB_FEATURES = 1000


def scenes(pictures: dict[str, np.ndarray]) -> Plate:
    """What the trackers look at, and how many corners ORB finds there."""
    views = {name: view(picture, noise=2, rng=np.random.default_rng(1)) for name, picture in pictures.items()}
    orb = cv2.ORB.create(ORB_FEATURES)
    corners = {name: len(orb.detect(image, None)) for name, image in views.items()}

    def draw(figure: Any, palette: Palette) -> None:
        for axes, (name, image) in zip(figure.subplots(1, len(views)), views.items(), strict=True):
            axes.imshow(image, cmap="gray", vmin=0, vmax=255)
            left, right, top, bottom = TARGET.x, TARGET.x + TARGET.width, TARGET.y, TARGET.y + TARGET.height
            axes.plot(
                (left, right, right, left, left), (top, top, bottom, bottom, top), color=palette.series[1], lw=1.5
            )
            axes.set(title=name, xticks=[], yticks=[], xlabel=SCENES[name][1].split(":")[0])
            axes.grid(False)

    return Plate(
        name="comparison-scenes",
        title="The scenes",
        thesis="Named as the cases where ORB-SLAM fails: changed brightness, featureless places, mines between "
        "mountains, deserts. Not shown.",
        ours="One view of each scene, with the target that is learned. The seeded rock and sand are smoother than real "
        "ones, and ORB has its default threshold: how few corners it finds there says as much of them as of ORB.",
        alt="Four grey pictures: a room full of things, an even wall, a dark mine with timbers, desert ripples.",
        size_in=(11, 2.7),
        draw=draw,
        numbers=tuple(
            (f"corners that ORB finds, of {ORB_FEATURES} asked for: {name}", str(n)) for name, n in corners.items()
        ),
    )


def answers(results: dict[str, dict[str, Tally]], frames: int) -> Plate:
    """Right, wrong, LOST, refused: every tracker in every case."""
    names = list(next(iter(results.values())))

    def draw(figure: Any, palette: Palette) -> None:
        colors = {"right": palette.good, "lost": palette.unknown, "refused": palette.faint, "wrong": palette.bad}
        panels = np.atleast_1d(figure.subplots(1, len(results), sharey=True))
        for axes, (case, tallies) in zip(panels, results.items(), strict=True):
            left = np.zeros(len(names))
            for what, color in colors.items():
                widths = np.array([100 * tallies[name].share(what) for name in names])
                axes.barh(names, widths, left=left, color=color, height=0.72, label=what, lw=0)
                left += widths
            axes.set(title=case, xlim=(0, 100), xticks=(0, 50, 100), xlabel="frames (%)")
            axes.grid(False)
        panels[0].invert_yaxis()
        handles, labels = panels[0].get_legend_handles_labels()
        labels = [
            {
                "right": f"right (within {WITHIN_PX} px)",
                "lost": "says LOST, or no bearing",
                "refused": "refuses to learn",
                "wrong": "wrong",
            }[label]
            for label in labels
        ]
        figure.legend(handles, labels, loc="outside upper center", ncols=4)

    return Plate(
        name="comparison-answers",
        title="Who is right where",
        thesis="A comparison with ORB “won't be fair or accurate” as the code stood; the aims are named: cost, "
        "brightness, featureless places.",
        ours=f"{frames} frames per case, the same for all. On the plain wall refusing, or saying LOST, is right: "
        f"there is nothing to see. z-regions is built for a still camera, and the camera moves here.",
        alt="Stacked bars per case and tracker: the share of frames answered rightly, lost, refused and wrongly. "
        "The table below has the numbers.",
        size_in=(12, 1.3 + 0.33 * len(names)),
        draw=draw,
    )


def brightness(curves: dict[str, list[float]]) -> Plate:
    """Share of right answers over the light."""

    def draw(figure: Any, palette: Palette) -> None:
        axes = figure.subplots()
        for index, (name, shares) in enumerate(curves.items()):
            color = palette.series[index % len(palette.series)]
            style = ("-", "--")[index // len(palette.series) % 2]
            axes.plot(
                GAINS, 100 * np.array(shares), color=color, ls=style, marker="osvD^Px"[index % 7], ms=4, label=name
            )
        axes.set(
            xscale="log", xlabel="light, times that when learned", ylabel="right (%)", ylim=(-4, 106), xticks=GAINS
        )
        axes.set_xticklabels([f"{gain:g}" for gain in GAINS])
        axes.minorticks_off()
        axes.invert_xaxis()
        axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5))

    return Plate(
        name="comparison-brightness",
        title="Brightness: learned in good light, seen in less",
        thesis="“The abrupt change in brightness can be confusing for the Orb”; brightness is future work for the "
        "Z-transform.",
        ours="A room learned in full light, then seen in a fraction of it, moved by up to 30 px at once. Noise stays "
        "the same (2 grey levels), so that the darkest views have little left.",
        alt="Share of right answers over the light, from full to a sixteenth, one curve per tracker.",
        size_in=(8.5, 3.4),
        draw=draw,
        numbers=tuple(
            (f"{name}: right at {GAINS[4]:g} of the light", f"{100 * shares[4]:.0f} %")
            for name, shares in curves.items()
        ),
    )


def cost(results: dict[str, dict[str, Tally]]) -> Plate:
    """Microseconds per frame, and error, in good light."""
    tallies = results[CASES[0].name]
    times = {name: float(np.median(tally.times_us)) for name, tally in tallies.items() if tally.times_us}
    order = sorted(times, key=times.__getitem__)

    def draw(figure: Any, palette: Palette) -> None:
        axes = figure.subplots()
        own = [palette.series[0] if name.startswith("z") else palette.unknown for name in order]
        bars = axes.barh(order, [times[name] for name in order], color=own, height=0.7)
        axes.bar_label(bars, [f"{times[name]:.0f}" for name in order], padding=4, fontsize=8.5)
        axes.set(xscale="log", xlabel="time per frame (µs), median", xlim=(10, 4 * max(times.values())))
        axes.invert_yaxis()
        axes.grid(axis="y", visible=False)

    return Plate(
        name="comparison-cost",
        title="Cost",
        thesis="“We are more interested in overcoming the very high computational cost of the ORB system.” No figures.",
        ours="Time of one update on a 640x480 frame in the room in good light, one thread, on the machine named "
        "above. A wrong answer may be quick: see it together with the table.",
        alt="Bars of the time per frame of each tracker, on a logarithmic scale. The table below has the numbers.",
        size_in=(7.5, 1.0 + 0.32 * len(order)),
        draw=draw,
        numbers=tuple((name, f"{times[name]:.0f} µs") for name in order),
    )
