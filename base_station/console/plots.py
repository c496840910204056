"""The last minute of shift, zoom, bearing and confidence, and the signature against the learned one."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from base_station.console.feed import HISTORY_S, Feed, Sample
from base_station.publication.schema import State

EVERY = 3
"""Refreshes of the page between two of the plots."""
CURVES = (
    ("shift", "px", "#3b8ff0"),
    ("zoom", "", "#e08a1e"),
    ("bearing", "°", "#2fa968"),
    ("confidence", "", "#9a6bd8"),
)
GRAY, LINE = "#7d8894", "rgba(125, 136, 148, 0.25)"
LABEL = {"color": GRAY, "fontSize": 11}


class Plots:
    """Light lines, drawn anew some times a second."""

    def __init__(self, ui: Any, feed: Feed) -> None:
        self._feed, self._refreshes = feed, 0
        with ui.element("div").classes("panel"):
            with ui.element("div").classes("title"):
                ui.label("Last minute")
            self._history = ui.echart(history_options()).style("height: 150px; width: 100%")
        with ui.element("div").classes("panel hide") as self._panel:
            with ui.element("div").classes("title"):
                ui.label("Signature: now (blue) against learned (grey)")
                self._likeness = ui.label()
            self._signature = ui.echart(signature_options()).style("height: 120px; width: 100%")

    def show(self, state: State) -> None:
        """Bring in what has changed."""
        self._refreshes += 1
        if self._refreshes % EVERY:
            return
        self._history.run_chart_method("setOption", {"series": history_series(list(self._feed.history))})
        signature = state.signature
        if ("hide" in self._panel.classes) != (signature is None):
            self._panel.classes(toggle="hide")
        if signature is not None:
            now, learned = np.frombuffer(signature.now, "<f4"), np.frombuffer(signature.learned, "<f4")
            if now.shape == learned.shape:
                self._likeness.set_text(f"likeness {float(now @ learned):.3f}")
                data = [{"data": np.round(values, 4).tolist()} for values in (learned, now)]
                self._signature.run_chart_method("setOption", {"series": data})


def history_options() -> dict[str, Any]:
    """Four small plots side by side, for ECharts."""
    width, gap = 22.0, 3.0
    lefts = [3.0 + i * (width + gap) for i in range(len(CURVES))]
    return {
        "animation": False,
        "title": [
            {"text": f"{name} {unit}".strip(), "left": f"{left}%", "top": 0, "textStyle": {**LABEL, "fontWeight": 600}}
            for (name, unit, _), left in zip(CURVES, lefts, strict=True)
        ],
        "grid": [{"left": f"{left}%", "width": f"{width - 2}%", "top": 24, "bottom": 20} for left in lefts],
        "xAxis": [
            {
                "gridIndex": i, "type": "value", "min": -HISTORY_S, "max": 0, "interval": HISTORY_S / 2,
                "axisLabel": LABEL,
                "splitLine": {"lineStyle": {"color": LINE}}, "axisLine": {"show": False}, "axisTick": {"show": False},
            }
            for i in range(len(CURVES))
        ],
        "yAxis": [
            {
                "gridIndex": i, "type": "value", "scale": True, "splitNumber": 2, "axisLabel": LABEL,
                "splitLine": {"lineStyle": {"color": LINE}},
                **({"min": 0, "max": 1} if name == "confidence" else {}),
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
