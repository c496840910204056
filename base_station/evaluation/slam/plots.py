"""A SLAM run as two pictures: the path beside the true one with its errors, and the map."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from base_station.evaluation.slam.trajectory import Trajectory
from base_station.evaluation.slam.trajectory_errors import absolute_errors, aligned
from base_station.evaluation.thesis.plotting import LIGHT, Palette, draw_to

AXES = "xyz"
SIZE_IN, DPI = (9.0, 6.5), 110
GAP_STEPS = 10
"""A path is broken where poses are missing for so many usual steps."""
SHOWN_SHARE = 98.0
"""Percent of the map's points that are within the plot: a few lie far away and would leave the rest no room."""


def plot_trajectory(path: Path, found: Trajectory, truth: Trajectory | None, milliseconds: np.ndarray) -> None:
    """The path from the side that shows most of it, its error over time, and the time that each picture took."""
    pairs = aligned(found, truth) if truth is not None else None
    ours = pairs.found[:, :3, 3] if pairs is not None else found.positions
    times = pairs.times_s if pairs is not None else found.times_s
    theirs = None if truth is None or (pairs is None and len(found)) else truth.positions

    def draw(figure: Any, palette: Palette) -> None:
        shape = figure.add_gridspec(2, 2, width_ratios=(1.5, 1))
        above, off, took = (figure.add_subplot(cell) for cell in (shape[:, 0], shape[0, 1], shape[1, 1]))
        across, up = _widest_axes(ours if theirs is None else theirs)
        if theirs is not None:
            above.plot(theirs[:, across], theirs[:, up], color=palette.unknown, label="truth")
        whole = _with_gaps(ours, times)
        above.plot(whole[:, across], whole[:, up], color=palette.series[0], linewidth=1.2, label="SLAM")
        above.set(title="Path", xlabel=AXES[across], ylabel=AXES[up], aspect="equal", adjustable="datalim")
        above.legend(loc="best")
        if pairs is not None:
            off.plot(pairs.times_s - found.times_s[0], absolute_errors(pairs), ".", markersize=3)
            off.set(title="Distance from the truth", xlabel="s", ylim=(0, None))
        else:
            off.set_axis_off()
            off.set_title("No truth to compare with" if truth is None else "Too few poses to compare")
        shown = milliseconds[np.isfinite(milliseconds)]
        took.plot(milliseconds, ".", markersize=2, color=palette.series[1])
        title = f"ms per picture, at most {shown.max():.0f}" if len(shown) else "No picture was shown"
        top = 1.3 * float(np.percentile(shown, 99)) if len(shown) else 1.0
        took.set(title=title, xlabel="picture", ylim=(0, top))

    draw_to(path, draw, LIGHT, size_in=SIZE_IN, dpi=DPI)


def plot_map(path: Path, points: np.ndarray, keyframes: Trajectory) -> None:
    """Points and keyframes from the side that shows most of the keyframes' path."""
    places = keyframes.positions

    def draw(figure: Any, palette: Palette) -> None:
        axes = figure.add_subplot()
        across, up = _widest_axes(places if len(places) > 1 else points)
        axes.plot(points[:, across], points[:, up], ".", markersize=1.2, color=palette.unknown, label="points")
        axes.plot(places[:, across], places[:, up], "-o", markersize=3, color=palette.series[4], label="keyframes")
        tails = [(100 - SHOWN_SHARE) / 2, (100 + SHOWN_SHARE) / 2]
        ends = [np.percentile(points, tails, axis=0)] if len(points) else []
        ends += [places.min(0, keepdims=True), places.max(0, keepdims=True)] if len(places) else []
        if ends:
            low, high = np.concatenate(ends).min(0), np.concatenate(ends).max(0)
            room = 0.05 * (high - low).max() + 1e-9
            axes.set(
                xlim=(low[across] - room, high[across] + room),
                ylim=(low[up] - room, high[up] + room),
            )
        axes.set(title=f"Map: {len(points)} points, {len(places)} keyframes", xlabel=AXES[across], ylabel=AXES[up])
        axes.set_aspect("equal", adjustable="box")
        axes.legend(loc="best")

    draw_to(path, draw, LIGHT, size_in=SIZE_IN, dpi=DPI)


def _with_gaps(places: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """With a row of NaN, which draws no line, wherever poses are missing for long."""
    steps = np.diff(times_s)
    if not len(steps):
        return places
    return np.insert(places, np.flatnonzero(steps > GAP_STEPS * np.median(steps)) + 1, np.nan, axis=0)


def _widest_axes(places: np.ndarray) -> tuple[int, int]:
    """The two axes along which the places extend most, in their order."""
    if not len(places):
        return 0, 2
    across, up = sorted(np.argsort(np.ptp(places, axis=0))[-2:].tolist())
    return across, up
