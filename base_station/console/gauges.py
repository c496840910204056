"""Numbers and meters: rates, delays, battery, wheels, proximity."""

from __future__ import annotations

from typing import Any

from base_station.publication.schema import State

CONTACT = 4500
"""What a proximity sensor tells at contact..."""
NEAR = 2000
"""...and where it is near."""
FRONT, REAR = 5, 2
LOOP, DELAY, TRACKER, DROPPED, BATTERY, CONFIDENCE = FACTS = (
    "Loop", "Frame to command, p50 | p95", "Tracker, median", "Frames dropped, robot + loop", "Battery",
    "Confidence",
)  # fmt: skip


class Gauges:
    """Of the robot and the loop."""

    def __init__(self, ui: Any) -> None:
        self._ui = ui
        self._facts: dict[str, Any] = {}
        self._numbers: dict[str, Any] = {}
        self._meters: dict[tuple[str, str], Any] = {}
        self._shown: dict[Any, float] = {}
        with ui.element("div").classes("panel gauges"):
            with ui.element("div").classes("facts"):
                for name in FACTS:
                    self._facts[name] = self._fact(name)
            with ui.element("div").classes("wheels"):
                for side in ("left", "right"):
                    self._wheel(side)
            self._proximity()

    def show(self, state: State) -> None:
        """Bring in what has changed."""
        for name, text in facts(state).items():
            self._facts[name].set_text(text)
        telemetry = state.telemetry
        asked = telemetry.wheels_asked if telemetry is not None else (0, 0)
        measured = telemetry.wheels_measured if telemetry is not None else None
        for i, side in enumerate(("left", "right")):
            told = "-" if telemetry is None else str(asked[i]) + (f" / {measured[i]}" if measured is not None else "")
            self._numbers[side].set_text(told)
            self._set(self._meters[side, "asked"], asked[i] / state.speed_limit)
            self._set(self._meters[side, "measured"], (measured[i] if measured is not None else 0) / state.speed_limit)
        proximity = telemetry.proximity if telemetry is not None else None
        self._sensors.set_visibility(proximity is not None)
        for cell, value in zip(self._cells, proximity or (), strict=False):
            self._set(cell, value / CONTACT)
            if ("near" in cell.classes) != (value > NEAR):
                cell.classes(toggle="near")

    def _fact(self, name: str) -> Any:
        with self._ui.element("div").classes("fact"):
            self._ui.label(name)
            return self._ui.label("-")

    def _wheel(self, side: str) -> None:
        ui = self._ui
        ui.label(side).classes("soft")
        with ui.element("div").classes("meter"):
            for kind in ("asked", "measured"):
                self._meters[side, kind] = ui.element("div").classes(kind)
        self._numbers[side] = ui.label("-").classes("num")

    def _proximity(self) -> None:
        ui = self._ui
        with ui.element("div") as self._sensors:
            with ui.element("div").classes("prox"):
                front = [ui.element("div").classes("cell") for _ in range(FRONT)]
                ui.element("div")
                self._cells = front + [ui.element("div").classes("cell") for _ in range(REAR)]
            with ui.element("div").classes("captions"):
                ui.label("proximity, front left to right")
                ui.element("div")
                ui.label("rear")

    def _set(self, element: Any, share: float) -> None:
        share = round(max(-1.0, min(1.0, share)), 2)
        if self._shown.get(element.id) != share:
            self._shown[element.id] = share
            element.style(f"--v: {share}")


def facts(state: State) -> dict[str, str]:
    """The numbers as texts."""
    telemetry, seen = state.telemetry, state.seen
    dropped = telemetry.frame.dropped if telemetry is not None and telemetry.frame is not None else None
    battery_v = telemetry.battery_v if telemetry is not None else None
    delay_ms, p95_ms = state.frame_to_command_ms, state.frame_to_command_p95_ms
    return {
        LOOP: f"{state.loop_hz:.1f} Hz",
        DELAY: "-"
        if delay_ms is None or p95_ms is None
        else f"{delay_ms:.{1 if delay_ms < 100 else 0}f} | {p95_ms:.{1 if p95_ms < 100 else 0}f} ms",
        TRACKER: "-" if state.tracker_ms is None else f"{state.tracker_ms:.1f} ms",
        DROPPED: f"{'-' if dropped is None else dropped} + {state.passed_over}",
        BATTERY: "-" if battery_v is None else f"{battery_v:.2f} V",
        CONFIDENCE: f"{seen.confidence:.2f}" if seen is not None and seen.state == "TRACKING" else "-",
    }
