"""The last minute of shift, zoom, bearing and confidence, and the signature against the learned one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from base_station.console.feed import HISTORY_S, Feed, Sample
from base_station.publication.schema import State

EVERY = 5
"""Refreshes of the page between two of the plots."""
CURVES = (
    ("shift", "px", "#3b8ff0"),
    ("zoom", "", "#e08a1e"),
    ("bearing", "°", "#2fa968"),
    ("confidence", "", "#9a6bd8"),
)
LEAST = {"shift": (-5.0, 5.0), "zoom": (0.95, 1.05), "bearing": (-1.0, 1.0)}
"""What a plot shows at the least: where nothing moves, its lines are flat, and their noise is not made large."""
GRAY, LINE = "#7d8894", "rgba(125, 136, 148, 0.25)"
LABEL = {"color": GRAY, "fontSize": 11}
ENDS = {**LABEL, "alignMinLabel": "left", "alignMaxLabel": "right"}

FROM_0_TO_1 = {"min": 0, "max": 1.04, "interval": 0.5, "axisLabel": {**LABEL, "showMaxLabel": False}}
"""With room for a line along 1."""


class HistoryPlot:
    """Light lines, drawn anew some times a second."""

    def __init__(self, ui: Any, feed: Feed) -> None:
        self._feed, self._refreshes = feed, 0
        with ui.element("div").classes("panel plots"):
            self._chart = ui.echart(history_options()).style("height: 100%; width: 100%")

    def show(self, state: State) -> None:
        """Bring in what has changed."""
        self._refreshes += 1
        if self._refreshes % EVERY == 0:
            self._chart.run_chart_method("setOption", {"series": history_series(list(self._feed.history))})


class SignaturePlot:
    """Hidden while the tracker has no signature."""

    def __init__(self, ui: Any) -> None:
        self._refreshes = 1
        with ui.element("div").classes("panel signature hide") as self._panel:
            with ui.element("div").classes("title"):
                ui.label("Signature: now (blue), learned (grey)")
                self._likeness = ui.label()
            self._chart = ui.echart(signature_options()).style("height: 96px; width: 100%")

    def show(self, state: State) -> None:
        """Bring in what has changed."""
        self._refreshes += 1
        if self._refreshes % EVERY:
            return
        signature = state.signature
        if ("hide" in self._panel.classes) != (signature is None):
            self._panel.classes(toggle="hide")
        if signature is None:
            return
        now, learned = np.frombuffer(signature.now, "<f4"), np.frombuffer(signature.learned, "<f4")
        if now.shape == learned.shape:
            self._likeness.set_text(f"likeness {float(now @ learned):.3f}")
            series = [{"data": np.round(values, 4).tolist()} for values in (learned, now)]
            self._chart.run_chart_method("setOption", {"series": series})


def history_options() -> dict[str, Any]:
    """Four small plots, two by two, for ECharts."""
    places = [(left, low) for low in (False, True) for left in (0, 52)]
    grids = [
        {
            "left": f"{left}%", "right": f"{52 - left}%", "top": "58%" if low else 20, "bottom": 0 if low else "52%",
            "containLabel": True,
        }
        for left, low in places
    ]  # fmt: skip
    bare = {"axisLine": {"show": False, "onZero": False}, "axisTick": {"show": False}, "axisLabel": LABEL}
    bare["splitLine"] = {"lineStyle": {"color": LINE}}
    return {
        "animation": False,
        "title": [
            {
                "text": f"{name} {unit}".strip(), "left": f"{left}%", "top": "50%" if low else 0, "padding": [3, 0],
                "textStyle": {**LABEL, "fontWeight": 600},
            }
            for (name, unit, _), (left, low) in zip(CURVES, places, strict=True)
        ],
        "grid": grids,
        "xAxis": [
            {
                **bare, "axisLabel": ENDS, "gridIndex": i, "type": "value", "min": -HISTORY_S, "max": 0,
                "interval": HISTORY_S / 2,
            }
            for i in range(len(CURVES))
        ],
        "yAxis": [
            {
                **bare, "gridIndex": i, "type": "value", "scale": True, "splitNumber": 2,
                **(FROM_0_TO_1 if name == "confidence" else _ends(*LEAST[name])),
            }
            for i, (name, _, _) in enumerate(CURVES)
        ],
        "series": [
            {
                "type": "line", "xAxisIndex": i, "yAxisIndex": i, "showSymbol": False, "silent": True, "data": [],
                "lineStyle": {"width": 1.5, "color": colour},
            }
            for i, (_, _, colour) in enumerate(CURVES)
        ],
    }  # fmt: skip


def _ends(low: float, high: float) -> dict[str, str]:
    """Of an axis, by what is on it (null: round numbers, as ECharts finds them). NiceGUI takes names with a
    colon for JavaScript."""
    return {":min": f"(on) => (on.min < {low} ? null : {low})", ":max": f"(on) => (on.max > {high} ? null : {high})"}


def history_series(samples: list[Sample]) -> list[dict[str, Any]]:
    """The lines' points: seconds before the last sample (negative), and the value; none where there is no value."""
    if not samples:
        return [{"data": []} for _ in CURVES]
    end_s = samples[-1].time_s
    times_s = [round(sample.time_s - end_s, 1) for sample in samples]
    columns = (
        [_rounded(sample.shift_px, 1) for sample in samples],
        [_rounded(sample.zoom, 3) for sample in samples],
        [_rounded(None if sample.bearing_rad is None else math.degrees(sample.bearing_rad), 2) for sample in samples],
        [_rounded(sample.confidence, 3) for sample in samples],
    )
    return [{"data": [list(point) for point in zip(times_s, column, strict=True)]} for column in columns]


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def signature_options() -> dict[str, Any]:
    """Two lines over each other."""
    axis = {"show": False, "type": "value", "scale": True}
    return {
        "animation": False,
        "grid": {"left": 4, "right": 4, "top": 4, "bottom": 4},
        "xAxis": {"show": False, "type": "category", "boundaryGap": False},
        "yAxis": axis,
        "series": [
            {
                "type": "line",
                "showSymbol": False,
                "silent": True,
                "data": [],
                "lineStyle": {"width": width, "color": colour},
            }
            for width, colour in ((2.5, "#9aa6b2"), (1.2, "#3b8ff0"))
        ],
    }
