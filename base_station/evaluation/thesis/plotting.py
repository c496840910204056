"""How the figures look, in one place; the only one that knows matplotlib (extra `figures`)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from base_station.errors import StationError


@dataclass(frozen=True, kw_only=True)
class Palette:
    """Colours of one appearance, as matplotlib takes them."""

    paper: str
    ink: str
    faint: str
    series: tuple[str, ...]
    good: str
    bad: str
    unknown: str


LIGHT = Palette(
    paper="#ffffff", ink="#20242c", faint="#dcdfe6",
    series=("#1f6fb4", "#d9720e", "#2e8b57", "#8e44ad", "#c0392b", "#6b7280", "#0e9aa7", "#a0730b", "#d6589f"),
    good="#2e8b57", bad="#c0392b", unknown="#b8bec9",
)  # fmt: skip
DARK = Palette(
    paper="#171b22", ink="#e4e7ed", faint="#343a46",
    series=("#6db3f2", "#f5a04c", "#63c990", "#c890e8", "#f27d72", "#a2a9b6", "#4fd0dc", "#dcb34c", "#f19ccb"),
    good="#4fb67c", bad="#e5675b", unknown="#565e6c",
)  # fmt: skip

Draw = Callable[[Any, Palette], None]
"""Draws on an empty matplotlib Figure."""


@dataclass(frozen=True, kw_only=True)
class Plate:
    """One figure of the page, and what is to be said about it. Texts are plain; `numbers` go into a small table."""

    name: str
    """Of the file, without its ending."""
    title: str
    thesis: str
    """What the thesis shows there."""
    ours: str
    """What is shown here."""
    alt: str
    size_in: tuple[float, float]
    draw: Draw
    numbers: tuple[tuple[str, str], ...] = ()
    for_readme: bool = False
    """Shown in the tracker's README as well."""


def _pyplot() -> Any:
    try:
        import matplotlib
    except ImportError:
        raise StationError("the figures need matplotlib: pip install 'zservo[figures]'", usage=False) from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def save(plate: Plate, path: Path, palette: Palette, *, dpi: int, tidy: bool = True) -> None:
    """Draw the plate and write it as PNG. Not `tidy`: labels may collide, in half the time."""
    draw_to(path, plate.draw, palette, size_in=plate.size_in, dpi=dpi, tidy=tidy)


def draw_to(
    path: Path, draw: Draw, palette: Palette, *, size_in: tuple[float, float], dpi: int, tidy: bool = True
) -> None:
    """Call `draw` with an empty figure in the palette's colours, and write it as PNG."""
    plt = _pyplot()
    style = {
        "figure.facecolor": palette.paper, "axes.facecolor": palette.paper, "savefig.facecolor": palette.paper,
        "text.color": palette.ink, "axes.labelcolor": palette.ink, "axes.edgecolor": palette.ink,
        "xtick.color": palette.ink, "ytick.color": palette.ink, "axes.titlecolor": palette.ink,
        "grid.color": palette.faint, "axes.grid": True, "axes.axisbelow": True, "grid.linewidth": 0.6,
        "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.8,
        "font.family": "DejaVu Sans", "font.size": 9.5, "axes.titlesize": 10.5, "axes.titleweight": "bold",
        "axes.titlelocation": "left", "axes.labelsize": 9.5, "legend.fontsize": 8.5, "legend.frameon": False,
        "lines.linewidth": 1.7, "xtick.labelsize": 8.5, "ytick.labelsize": 8.5,
        "axes.prop_cycle": plt.cycler(color=palette.series),
    }  # fmt: skip
    with plt.rc_context(style):
        figure = plt.figure(figsize=size_in, layout="constrained" if tidy else None)
        try:
            draw(figure, palette)
            figure.savefig(path, dpi=dpi, metadata={"Software": None})
        finally:
            plt.close(figure)


def require() -> None:
    """Raise StationError now, not after a minute of measuring, when matplotlib is missing."""
    _pyplot()
