"""The page: what stands where. Each visitor has one of his own; a timer brings in what has changed.

The picture, the emergency stop and driving are the page's scripts (`static/`), which need nothing of this but places
with the ids `view`, `rate` and `scheme`.
"""

from __future__ import annotations

from typing import Any

from base_station.console.controls import Controls
from base_station.console.feed import Feed
from base_station.console.gauges import Gauges
from base_station.console.line import Lines
from base_station.console.plots import HistoryPlot, SignaturePlot
from base_station.console.scene import Scene

REFRESH_S = 0.2
HEAD = """
<link rel="stylesheet" href="/static/console.css">
<meta name="color-scheme" content="light dark">
"""
BODY = """
<div id="banner" role="alert" hidden></div>
<div id="toasts" role="status"></div>
<div id="emergency">
  <button id="stop" aria-label="emergency stop"><span id="stop-title">STOP</span>
    <span id="stop-hint">emergency stop · space bar</span></button>
  <button id="release" hidden>Release</button>
</div>
<script type="module" src="/static/console.js"></script>
"""


def add_page(library: Any, feed: Feed, lines: Lines) -> None:
    """`library`: NiceGUI's module."""
    ui = library.ui

    @ui.page("/")
    def page() -> None:
        ui.colors(primary="#0b6bcb")
        ui.add_head_html(HEAD)
        ui.add_body_html(BODY)
        with ui.element("div").classes("page"):
            _build(ui, feed, lines)


def _build(ui: Any, feed: Feed, lines: Lines) -> None:
    top, controls = Top(ui), Controls(ui, feed, lines)
    with ui.element("div").classes("main"):
        with ui.element("div").classes("left"):
            controls.stage()
            signature, scene = SignaturePlot(ui), Scene(ui, feed)
        with ui.element("div").classes("middle"):
            controls.choices()
            controls.landmarks()
        with ui.element("div").classes("right"):
            gauges, history = Gauges(ui), HistoryPlot(ui, feed)
    parts = (top, controls, gauges, history, signature, scene)

    def refresh() -> None:
        if feed.state is not None:
            for part in parts:
                part.show(feed.state)

    ui.timer(REFRESH_S, refresh)


class Top:
    """Name, robot, link and safety."""

    def __init__(self, ui: Any) -> None:
        with ui.element("div").classes("top"):
            ui.label("zservo").classes("name")
            self._robot = ui.label().classes("soft")
            self._link = ui.label().classes("chip link")
            self._safety = ui.label().classes("chip")
            ui.html('<button id="scheme" class="plain" aria-label="colours"></button>', sanitize=False)

    def show(self, state: Any) -> None:
        """Bring in what has changed."""
        self._robot.set_text(state.robot)
        self._link.set_text(state.link)
        _colour(self._link, "link good" if state.connected else "link bad")
        telemetry = state.telemetry
        if telemetry is None:
            self._safety.set_text("no telemetry")
            _colour(self._safety, "warn")
        else:
            self._safety.set_text("wheels " + telemetry.safety + (f": {telemetry.reason}" if telemetry.reason else ""))
            _colour(self._safety, {"ok": "good", "limited": "warn"}.get(telemetry.safety, "bad"))


def _colour(chip: Any, names: str) -> None:
    if not set(names.split()) <= set(chip.classes):
        chip.classes(replace=f"chip {names}")
