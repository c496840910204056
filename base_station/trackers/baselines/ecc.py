"""Direct alignment: the warp under which the learned patch correlates best with the picture, by gradient ascent.

cv2.findTransformECC (Evangelidis and Psarakis, IEEE T-PAMI 30, 2008), the direct method of the thesis's chapter 1.2.2.
An ascent needs a start nearby: a shift is looked for in a small copy of the picture first, an affine warp in larger
ones then. Of a place the middle is the patch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.baselines.patch import Found, Learned, Missed, PatchTracker, gone

STEPS = ((8, cv2.MOTION_TRANSLATION), (4, cv2.MOTION_AFFINE), (1, cv2.MOTION_AFFINE))
"""How many times smaller, and what may change."""


@dataclass(frozen=True, kw_only=True)
class EccSettings:
    """Of the ascent, and when to believe its end."""

    iterations: int = 30
    """At each step, at the most."""
    least_gain: float = 1e-4
    """An iteration that raises the correlation by less is the last."""
    blur_px: int = 5
    """Of both pictures before they are compared; odd."""
    least_correlation: float = 0.6
    place_share: float = 0.5
    """Of the view's width and height that is the patch of a place."""


class EccTracker(PatchTracker):
    """Starts where the target was last; when it was lost, where it was learned."""

    def __init__(self, *, settings: EccSettings | None = None) -> None:
        super().__init__()
        self._settings = settings or EccSettings()

    def _prepare(self, image: np.ndarray, patch: np.ndarray, learned: Learned) -> None:
        share = self._settings.place_share if learned.is_place else 1.0
        rows, columns = (max(round(side * share), 1) for side in learned.shape)
        self._template = cv2.getRectSubPix(image, (columns, rows), learned.center_px)
        self._start = _placed(self._template.shape, *learned.center_px, 1.0)

    def _look(self, image: np.ndarray, learned: Learned) -> Found | Missed:
        warp, correlation = self._start, 0.0
        for smaller, motion in STEPS:
            if min(self._template.shape) // smaller >= 8:
                warp, correlation = self._ascend(image, warp, smaller, motion)
        if not np.isfinite(warp).all() or correlation < self._settings.least_correlation:
            self._start = _placed(self._template.shape, *learned.center_px, 1.0)
            return gone(correlation)
        zoom = math.sqrt(max(float(np.linalg.det(warp[:, :2])), 1e-6))
        rows, columns = self._template.shape
        x, y = warp @ ((columns - 1) / 2, (rows - 1) / 2, 1.0)
        self._start = _placed(self._template.shape, x, y, zoom)
        return Found(x=float(x), y=float(y), zoom=zoom, confidence=correlation)

    def _ascend(self, image: np.ndarray, warp: np.ndarray, smaller: int, motion: int) -> tuple[np.ndarray, float]:
        """A better warp (2x3, template to picture px) and its correlation; the same and 0 when there is none."""
        s = self._settings
        template, picture = _shrunk(self._template, smaller), _shrunk(image, smaller)
        inner = np.vstack([warp, (0, 0, 1)])
        start = np.ascontiguousarray((_shrinking(smaller) @ inner @ np.linalg.inv(_shrinking(smaller)))[:2], np.float32)
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, s.iterations, s.least_gain)
        try:
            correlation, better = cv2.findTransformECC(
                template,
                picture,
                start,
                motion,
                criteria,
                None,
                s.blur_px,  # type: ignore[call-overload]
            )
        except cv2.error:  # it does not converge: OpenCV's way of saying so
            return warp, 0.0
        outer = np.linalg.inv(_shrinking(smaller)) @ np.vstack([better, (0, 0, 1)]) @ _shrinking(smaller)
        return outer[:2], float(correlation)


def _shrunk(image: np.ndarray, smaller: int) -> np.ndarray:
    if smaller == 1:
        return image
    size = (max(image.shape[1] // smaller, 1), max(image.shape[0] // smaller, 1))
    cropped = image[: size[1] * smaller, : size[0] * smaller]
    return np.asarray(cv2.resize(cropped, size, interpolation=cv2.INTER_AREA))


def _shrinking(smaller: int) -> np.ndarray:
    """3x3: px to px of a picture that is this many times smaller; pixel centres are at integer coordinates."""
    offset = (1 / smaller - 1) / 2
    return np.array([[1 / smaller, 0, offset], [0, 1 / smaller, offset], [0, 0, 1]])


def _placed(shape: tuple[int, ...], x: float, y: float, zoom: float) -> np.ndarray:
    """The warp that puts a template of this shape about x, y."""
    rows, columns = shape
    return np.array([[zoom, 0, x - zoom * (columns - 1) / 2], [0, zoom, y - zoom * (rows - 1) / 2]])
