"""Colours (blue, green, red: OpenCV's order) and text for pictures that are drawn with OpenCV."""

from __future__ import annotations

import cv2
import numpy as np

Color = tuple[int, int, int]

WHITE, INK, FAINT = (255, 255, 255), (60, 50, 45), (225, 220, 215)
BLUE, ORANGE, GREEN, RED = (190, 110, 30), (20, 120, 235), (80, 175, 60), (60, 60, 220)
PURPLE, TEAL, BROWN = (170, 70, 130), (160, 150, 20), (50, 85, 130)
PINK, OLIVE, GRAY = (170, 110, 230), (40, 150, 150), (140, 140, 140)
SERIES: tuple[Color, ...] = (RED, BLUE, ORANGE, GREEN, PURPLE, TEAL, BROWN, PINK, OLIVE, GRAY)
"""For curves side by side, in this order."""
FONT = cv2.FONT_HERSHEY_SIMPLEX


def draw_text(panel: np.ndarray, text: str, at: tuple[int, int], *, color: Color = INK, scale: float = 0.45) -> None:
    """`at`: the left end of the baseline, px."""
    cv2.putText(panel, text, at, FONT, scale, color, 1, cv2.LINE_AA)


def as_ascii(text: str) -> str:
    """OpenCV's fonts know ASCII only."""
    return text.replace("°", " deg").encode("ascii", "replace").decode()
