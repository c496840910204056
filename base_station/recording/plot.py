"""Several trackers over the same frames: shift, bearing, zoom and confidence over time, a colour for each."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from base_station.display import short_name
from base_station.errors import StationError
from base_station.evaluation.thesis.plotting import LIGHT, Palette, draw_to, require
from base_station.output_files import check_output
from base_station.recording.series import Series
from base_station.recording.sources import TargetTruth
from base_station.types import TrackingState

SIZE_IN, DPI = (10.0, 9.0), 110
LOST_HEIGHT = 0.07
"""Of the panel that shows who is LOST when, for each tracker."""


def check_picture(path: Path | None) -> None:
    """Find out now, not after a minute, that a picture cannot be drawn. Raises StationError."""
    if path is None:
        return
    require()
    check_output("--picture", path, (".png",))


def plot_series(path: Path, title: str, rows: Sequence[Series], truth: Mapping[int, TargetTruth]) -> None:
    """Draw them to a PNG file. Raises StationError when it cannot be written."""
    times = {place: time_s for series in rows for place, time_s in zip(series.places, series.times_s, strict=True)}
    zero_s = min(times.values(), default=0.0)
    known = sorted(place for place in truth if place in times)
    measures = (
        ("shift_px", "Shift, px (right positive)", 1.0),
        ("bearing_rad", "Bearing, degrees (left positive)", 180 / math.pi),
        ("zoom", "Zoom (larger is nearer)", 1.0),
    )

    def draw(figure: Any, palette: Palette) -> None:
        shape = figure.add_gridspec(5, 1, height_ratios=(1, 1, 1, 1, LOST_HEIGHT * 2 * (len(rows) + 1)))
        panels = [figure.add_subplot(shape[0])]
        panels += [figure.add_subplot(shape[number], sharex=panels[0]) for number in range(1, 5)]
        for panel, (name, heading, factor) in zip(panels, measures, strict=False):
            true_values = [getattr(truth[place], name) for place in known]
            if any(value is not None for value in true_values):
                shown = [math.nan if value is None else value * factor for value in true_values]
                when = [times[place] - zero_s for place in known]
                panel.plot(when, shown, color=palette.ink, linewidth=3.2, alpha=0.25, label="truth")
            _curves(panel, rows, name, factor, zero_s, palette)
            panel.set_title(heading)
        _curves(panels[3], rows, "confidence", 1.0, zero_s, palette)
        panels[3].set(title="Confidence", ylim=(-0.03, 1.05))
        _lost(panels[4], rows, zero_s, palette)
        panels[4].set(xlabel="s")
        for panel in panels[:4]:
            panel.tick_params(labelbottom=False)
        handles = {label: handle for panel in panels[:4] for handle, label in _named(panel)}
        figure.legend(handles.values(), handles.keys(), loc="outside upper right", ncols=min(7, len(handles)))
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")

    try:
        draw_to(path, draw, LIGHT, size_in=SIZE_IN, dpi=DPI)
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error


def _curves(panel: Any, rows: Sequence[Series], name: str, factor: float, zero_s: float, palette: Palette) -> None:
    for number, series in enumerate(rows):
        values = series.values(name) * factor
        if name == "confidence":
            values[[result.state is not TrackingState.TRACKING for result in series.results]] = math.nan
        color = _color(palette, number)
        panel.plot(np.array(series.times_s) - zero_s, values, color=color, linewidth=1.3, label=short_name(series.name))
    panel.margins(x=0.01)


def _lost(panel: Any, rows: Sequence[Series], zero_s: float, palette: Palette) -> None:
    """A bar for each tracker: coloured while it is tracking, red while it is LOST, pale before it has learned."""
    colors = {TrackingState.LOST: palette.bad, TrackingState.INITIALIZING: palette.faint}
    for number, series in enumerate(rows):
        ends = [*series.times_s[1:], series.times_s[-1]] if series.times_s else []
        for state in TrackingState:
            bars = [
                (begin - zero_s, end - begin)
                for begin, end, result in zip(series.times_s, ends, series.results, strict=True)
                if result.state is state
            ]
            color = colors.get(state, _color(palette, number))
            panel.broken_barh(bars, (number - 0.35, 0.7), color=color, linewidth=0)
    panel.set_yticks(range(len(rows)), [short_name(series.name) for series in rows])
    panel.set(title="TRACKING (LOST is red)", ylim=(len(rows) - 0.4, -0.6))
    panel.grid(visible=False)


def _color(palette: Palette, number: int) -> str:
    """Of a tracker; red is for LOST."""
    colors = [color for color in palette.series if color != palette.bad]
    return colors[number % len(colors)]


def _named(panel: Any) -> list[tuple[Any, str]]:
    return list(zip(*panel.get_legend_handles_labels(), strict=True))
