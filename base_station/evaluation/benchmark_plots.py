"""The benchmark as pictures: how errors are distributed under each condition, and exactness against cost."""

from __future__ import annotations

import cv2
import numpy as np

from base_station.evaluation.drawing import FAINT, INK, SERIES, as_ascii, draw_text
from base_station.evaluation.tracker_benchmark import BenchmarkScores

PANEL_W, PANEL_H = 380, 300
LEFT, RIGHT, TOP, BOTTOM = 44, 14, 34, 34
LEGEND_H = 44
ERRORS_PX = (0.001, 100.0)
"""Ends of the axis of errors; it is logarithmic."""
SAMPLES = 200


def error_curves(scores: BenchmarkScores) -> np.ndarray:
    """BGR picture, a panel per condition: the share of frames (upwards) with at most this error (to the right)."""
    names = list(scores.errors_px)
    conditions = list(scores.errors_px[names[0]])
    across = min(len(conditions), 5)
    down = -(-len(conditions) // across)
    canvas = np.full((down * PANEL_H + LEGEND_H, across * PANEL_W, 3), 255, np.uint8)
    for number, condition in enumerate(conditions):
        row, column = divmod(number, across)
        panel = canvas[row * PANEL_H : (row + 1) * PANEL_H, column * PANEL_W : (column + 1) * PANEL_W]
        _draw_axes(panel, f"{condition}: share of frames within an error, px", ERRORS_PX)
        for place, name in enumerate(names):
            _draw_share(panel, scores.errors_px[name][condition], SERIES[place % len(SERIES)])
    _draw_legend(canvas[-LEGEND_H:], names)
    return canvas


def cost_against_exactness(scores: BenchmarkScores) -> np.ndarray:
    """BGR picture: per tracker a point per condition, share within 1.5 px (upwards) against us per frame; the mean is
    the large point."""
    names = list(scores.conditions)
    canvas = np.full((2 * PANEL_H, 2 * PANEL_W, 3), 255, np.uint8)
    panel = canvas[: 2 * PANEL_H - LEGEND_H]
    span = (10.0, 100_000.0)
    _draw_axes(panel, "share within 1.5 px against microseconds a frame", span)
    for place, name in enumerate(names):
        color = SERIES[place % len(SERIES)]
        points = np.array([(score.us_p50, score.within_1_5) for score in scores.conditions[name].values()])
        middle = (float(np.exp(np.log(np.maximum(points[:, 0], 1)).mean())), float(points[:, 1].mean()))
        for us, share in points:
            cv2.circle(panel, _to_px(panel, us, share, span), 3, color, 1, cv2.LINE_AA)
        at = _to_px(panel, *middle, span)
        cv2.circle(panel, at, 7, color, -1, cv2.LINE_AA)
        draw_text(panel, as_ascii(_short(name)), (at[0] + 10, at[1] + 4), color=color)
    _draw_legend(canvas[-LEGEND_H:], names)
    return canvas


def _to_px(panel: np.ndarray, value: float, share: float, span: tuple[float, float]) -> tuple[int, int]:
    height, width = panel.shape[:2]
    part = np.log(np.clip(value, *span) / span[0]) / np.log(span[1] / span[0])
    return round(LEFT + part * (width - LEFT - RIGHT)), round(height - BOTTOM - share * (height - TOP - BOTTOM))


def _draw_axes(panel: np.ndarray, title: str, span: tuple[float, float]) -> None:
    draw_text(panel, title, (LEFT, 20), scale=0.42)
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        cv2.line(panel, _to_px(panel, span[0], share, span), _to_px(panel, span[1], share, span), FAINT, 1)
        draw_text(panel, f"{share:.0%}", (4, _to_px(panel, span[0], share, span)[1] + 4), scale=0.36)
    decade = span[0]
    while decade <= span[1] * 1.001:
        cv2.line(panel, _to_px(panel, decade, 0, span), _to_px(panel, decade, 1, span), FAINT, 1)
        x, y = _to_px(panel, decade, 0, span)
        draw_text(panel, f"{decade:g}", (x - 12, y + 18), scale=0.36)
        decade *= 10


def _draw_share(panel: np.ndarray, errors_px: np.ndarray, color: tuple[int, int, int]) -> None:
    """LOST (NaN) frames are never within an error, so the curve ends below 100 %."""
    ends = np.geomspace(*ERRORS_PX, SAMPLES)
    points = [_to_px(panel, end, float((errors_px <= end).mean()), ERRORS_PX) for end in ends]
    cv2.polylines(panel, [np.array(points, np.int32)], False, color, 2, cv2.LINE_AA)


def _draw_legend(strip: np.ndarray, names: list[str]) -> None:
    x = LEFT
    for place, name in enumerate(names):
        text = as_ascii(_short(name))
        cv2.line(strip, (x, 20), (x + 18, 20), SERIES[place % len(SERIES)], 3)
        draw_text(strip, text, (x + 24, 24), color=INK)
        x += 44 + 9 * len(text)


def _short(name: str) -> str:
    """A tracker's name without the folders of its file."""
    return name.rpartition("/")[2]
