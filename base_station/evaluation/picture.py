"""A picture of a run: the last view with the target's box, the path from above, bearing and distance over time.

Drawn with OpenCV, so that showing a run needs no plotting library.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from base_station.display import describe
from base_station.evaluation.closed_loop import Summary
from base_station.evaluation.drawing import BLUE, FAINT, GREEN, INK, ORANGE, RED, WHITE, as_ascii, draw_text
from base_station.station import Step
from base_station.types import Frame, TrackerResult, TrackingState
from protocol import Truth

WIDTH, HEIGHT = 1280, 960
PANEL_W, PANEL_H = WIDTH // 2, HEIGHT // 2
MARGIN = 44
UNSENT_GRAY = 60
"""Of rows that the robot was not asked for."""


class RunPicture:
    """Collects what it needs while the run goes on."""

    def __init__(self) -> None:
        self._frame: Frame | None = None
        self._result: TrackerResult | None = None
        self._zero_s: float | None = None
        self._bearings: list[tuple[float, float]] = []
        self._pans: list[tuple[float, float]] = []
        self._zooms: list[tuple[float, float]] = []

    def note_step(self, step: Step) -> None:
        """Keep the measurements, and the newest picture without copying it."""
        self._frame, self._result = step.frame, step.result
        if self._zero_s is None:
            self._zero_s = step.frame.time_s
        time_s = step.frame.time_s - self._zero_s
        if step.result.bearing_rad is not None:
            self._bearings.append((time_s, math.degrees((step.pan_rad or 0.0) + step.result.bearing_rad)))
        if step.pan_rad is not None:
            self._pans.append((time_s, math.degrees(step.pan_rad)))
        if step.result.zoom is not None:
            self._zooms.append((time_s, 100 / step.result.zoom))

    def png(self, truths: list[tuple[float, Truth]], summary: Summary) -> bytes:
        """The picture as PNG data."""
        canvas = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)
        true_bearings = [(t, math.degrees(truth.bearing_rad)) for t, truth in truths if truth.bearing_rad is not None]
        ranges = [(t, truth.range_m * 100) for t, truth in truths if truth.range_m is not None]
        self._draw_view(canvas[:PANEL_H, :PANEL_W])
        _draw_path(canvas[:PANEL_H, PANEL_W:], truths)
        _draw_curves(
            canvas[PANEL_H:, :PANEL_W],
            "bearing of the target, degrees (left positive)",
            [("true", BLUE, true_bearings), ("seen", ORANGE, self._bearings), ("pan", GREEN, self._pans)],
        )
        if ranges:
            _draw_curves(canvas[PANEL_H:, PANEL_W:], "distance to the target, cm", [("true", BLUE, ranges)])
        else:
            _draw_curves(
                canvas[PANEL_H:, PANEL_W:],
                "depth against the learned one, % (from zoom)",
                [("seen", ORANGE, self._zooms)],
            )
        title = f"{summary.scenario or 'live'}: {summary.tracker}, {summary.behaviour}, {summary.duration_s:.0f} s"
        draw_text(canvas, title, (12, HEIGHT - 10), scale=0.5)
        return bytes(cv2.imencode(".png", canvas)[1])

    def _draw_view(self, panel: np.ndarray) -> None:
        if self._frame is None or self._result is None:
            draw_text(panel, "no frame came", (MARGIN, PANEL_H // 2))
            return
        rows, columns = self._frame.shape
        scale = min(PANEL_W / columns, PANEL_H / rows)
        whole = np.full((rows, columns), UNSENT_GRAY, np.uint8)
        whole[self._frame.first_row : self._frame.first_row + len(self._frame.image)] = self._frame.image
        size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
        view = cv2.resize(cv2.cvtColor(whole, cv2.COLOR_GRAY2BGR), size)
        box = self._result.box
        color = GREEN if self._result.state is TrackingState.TRACKING else RED
        if box is not None:
            corner = (round((box.x - 0.5) * scale), round((box.y - 0.5) * scale))
            opposite = (round((box.x + box.width - 0.5) * scale), round((box.y + box.height - 0.5) * scale))
            cv2.rectangle(view, corner, opposite, color, 2, cv2.LINE_AA)
        height, width = view.shape[:2]
        view[:26] = view[:26] // 4
        draw_text(view, f"{self._result.state.value}  {as_ascii(describe(self._result))}", (8, 18), color=WHITE)
        panel[:height, :width] = view


def _draw_path(panel: np.ndarray, truths: list[tuple[float, Truth]]) -> None:
    robot = np.array([truth.robot[:2] for _, truth in truths]).reshape(-1, 2)
    target = np.array([truth.target[:2] for _, truth in truths if truth.target is not None]).reshape(-1, 2)
    draw_text(panel, "path from above: robot blue, target orange", (MARGIN, 24))
    if not len(robot):
        draw_text(panel, "unknown: no truth outside of the simulation", (MARGIN, PANEL_H // 2))
        return
    both = np.vstack([robot, target])
    low, high = both.min(0) - 0.15, both.max(0) + 0.15
    scale = min((PANEL_W - 2 * MARGIN) / (high[0] - low[0]), (PANEL_H - 2 * MARGIN) / (high[1] - low[1]))
    offset = np.array([PANEL_W, PANEL_H]) / 2

    def to_px(points: np.ndarray) -> np.ndarray:
        centred = (points - (low + high) / 2) * scale
        return np.round(offset + centred * (1, -1)).astype(np.int32)

    for points, color in ((target, ORANGE), (robot, BLUE)):
        if len(points):
            px = to_px(points)
            cv2.polylines(panel, [px], False, color, 2, cv2.LINE_AA)
            cv2.circle(panel, tuple(int(v) for v in px[0]), 4, color, 1, cv2.LINE_AA)
            cv2.circle(panel, tuple(int(v) for v in px[-1]), 6, color, -1, cv2.LINE_AA)
    _draw_ruler(panel, scale)


def _draw_ruler(panel: np.ndarray, px_per_m: float) -> None:
    length_m = next(m for m in (2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.01) if m * px_per_m < PANEL_W / 3 or m == 0.01)
    y, x = PANEL_H - 20, PANEL_W - MARGIN
    cv2.line(panel, (x - round(length_m * px_per_m), y), (x, y), INK, 2)
    draw_text(panel, f"{length_m * 100:g} cm", (x - round(length_m * px_per_m), y - 8))


Curve = tuple[str, tuple[int, int, int], list[tuple[float, float]]]


def _draw_curves(panel: np.ndarray, title: str, curves: list[Curve]) -> None:
    draw_text(panel, title, (MARGIN, 24))
    points = np.array([point for _, _, curve in curves for point in curve]).reshape(-1, 2)
    if not len(points):
        draw_text(panel, "not measured", (MARGIN, PANEL_H // 2))
        return
    end_s = max(float(points[:, 0].max()), 1e-3)
    low, high = _span(points[:, 1])
    left, right, top, bottom = MARGIN + 10, PANEL_W - 20, 40, PANEL_H - 44

    def to_px(curve: list[tuple[float, float]]) -> np.ndarray:
        values = np.array(curve)
        x = left + values[:, 0] / end_s * (right - left)
        y = bottom - (np.clip(values[:, 1], low, high) - low) / (high - low) * (bottom - top)
        return np.round(np.stack([x, y], 1)).astype(np.int32)

    for value in _ticks(low, high):
        y = round(bottom - (value - low) / (high - low) * (bottom - top))
        cv2.line(panel, (left, y), (right, y), FAINT, 1)
        draw_text(panel, f"{value:g}", (4, y + 4), scale=0.4)
    for number, (name, color, curve) in enumerate(curves):
        if curve:
            cv2.polylines(panel, [to_px(curve)], False, color, 1, cv2.LINE_AA)
            draw_text(panel, name, (right - 170 + 60 * number, 24), color=color)
    draw_text(panel, "0", (left, bottom + 18), scale=0.4)
    draw_text(panel, f"{end_s:.0f} s", (right - 30, bottom + 18), scale=0.4)


def _span(values: np.ndarray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    room = max((high - low) * 0.08, 0.5)
    return low - room, high + room


def _ticks(low: float, high: float) -> list[float]:
    """Four to nine round numbers in the span."""
    step = 10.0 ** math.floor(math.log10((high - low) / 4))
    step *= next(factor for factor in (1, 2, 5) if (high - low) / (step * factor) < 10)
    first = math.ceil(low / step)
    return [round(number * step, 10) for number in range(first, math.floor(high / step) + 1)]
