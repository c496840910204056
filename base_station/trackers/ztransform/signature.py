"""From a placement in a picture to its signature: a few hundred complex numbers of length 1.

The patch under the placement is reduced to row bands and column bands; of each the light's offset is removed by the
central difference, the hard ends by a taper, and the rest is read by two-sided second-order poles about several
anchors. Normalising removes the gain of the light.

All but the last is linear in the bands' profiles, and the same for every band: a matrix of windows. They overlap, so
fewer numbers hold the same: with the root of their Gram matrix in their place, every length and every inner product of
signatures stays what it was, and so does all that is learned from them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from base_station.trackers.ztransform.boxes import sample_boxes
from base_station.trackers.ztransform.cells import read_inside
from base_station.trackers.ztransform.kernels import read_signature
from base_station.trackers.ztransform.poles import PoleSettings, scale_weights, spiral_poles
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.refinement import read_filled

MARGIN = 0.1
"""Of a target's width and height: how far a refinement usually goes."""


@dataclass(frozen=True, kw_only=True)
class SignatureSettings:
    """How a patch is read."""

    cells: int = 48
    """Side of the patch, in cells."""
    bands: int = 4
    """Row bands, and as many column bands."""
    anchors: int = 7
    """Anchors along each band."""
    spread: float = 0.8
    """The share of a band that the anchors span."""
    taper: float = 0.12
    """The share of a band at each end over which the difference fades in."""
    poles: PoleSettings = field(default_factory=PoleSettings)
    """The scales."""
    is_compact: bool = True
    """Read through the root of the windows' Gram matrix: as many numbers as cells, for each band."""


class SignatureReader:
    """Settings turned into the arrays that the kernels take, in the order in which they take them."""

    def __init__(self, settings: SignatureSettings) -> None:
        windows = _windows(settings)
        if settings.is_compact:
            windows = _compact(windows)
        self.cells = settings.cells
        self.size = 2 * settings.bands * len(windows)
        self.plan = settings.bands, np.ascontiguousarray(windows.T, np.float32)
        """bands, windows: float32 (cells, numbers)."""

    def source(
        self,
        pyramid: Pyramid,
        placement: np.ndarray,
        lens: np.ndarray,
        *,
        cells: int | None = None,
        whole: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Running sums to read this placement from, and where they are, see `boxes`; of the whole frame, or at least of
        the placement and a margin."""
        x, y, width, height, keystone = placement.tolist()
        cell_px = max(width, height) / (cells or self.cells)
        if whole or lens[0] > 0:
            return pyramid.sums(cell_px)
        horizon = float(lens[3])
        grow = 1 / (1 - min(0.5 * abs(keystone), 0.5))
        reach_x, reach_y = (0.5 * grow + MARGIN) * width, (0.5 + MARGIN) * height
        top = horizon + (y - reach_y - horizon) * (grow if y - reach_y < horizon else 1.0)
        bottom = horizon + (y + reach_y - horizon) * (grow if y + reach_y > horizon else 1.0)
        return pyramid.sums(cell_px, (x - reach_x, top, x + reach_x, bottom))

    def patch(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Patch float32 (cells, cells), which cells the frame shows (uint8), and their share 0..1."""
        patch, seen = np.empty((self.cells,) * 2, np.float32), np.empty((self.cells,) * 2, np.uint8)
        share = sample_boxes(*self.source(pyramid, placement, lens, whole=True), lens, placement, patch, seen)
        return patch, seen, share

    def means(
        self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray, cells: int
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """As `patch`, of any number of cells a side, from the frame's own pixels: exact for a flat lens."""
        patch, seen = np.empty((cells, cells), np.float32), np.ones((cells, cells), np.uint8)
        if lens[0] <= 0 and read_inside(pyramid.image, placement, float(lens[3]), patch):
            return patch, seen, 1.0
        return patch, seen, sample_boxes(*pyramid.sums(1.0), lens, placement, patch, seen)

    def signature(self, patch: np.ndarray) -> tuple[np.ndarray, float]:
        """Signature float32 (size,) of length 1, and its length before normalising: the contrast that was there."""
        out = np.empty(self.size, np.float32)
        length = read_signature(patch, *self.plan, out)
        return out, length

    def read(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray, learned: np.ndarray) -> np.ndarray:
        """Signature at a placement; cells outside of the frame are taken from the learned patch."""
        out, source = np.empty(self.size, np.float32), self.source(pyramid, placement, lens, whole=True)
        read_filled(*source, lens, placement, learned, *self.plan, out)
        return out


def _windows(settings: SignatureSettings) -> np.ndarray:
    """What a profile is read with: difference, taper and poles in one; (poles, 2 sides, anchors, 2) flat, by cells."""
    cells, reach = settings.cells, settings.spread / 2
    difference = np.zeros((cells, cells))
    middle = np.arange(1, cells - 1)
    u = (middle + 0.5) / cells
    fade = 0.5 * np.minimum(1, np.minimum(u, 1 - u) / settings.taper)
    difference[middle, middle + 1], difference[middle, middle - 1] = fade, -fade
    anchors = np.round(np.linspace(cells * (0.5 - reach), cells * (0.5 + reach), settings.anchors)).astype(int)
    away = np.arange(cells) - np.minimum(anchors, cells - 1)[:, None]
    read = []
    for pole, weight in zip(spiral_poles(settings.poles), scale_weights(settings.poles), strict=True):
        for side in (away, -away):
            window = np.where(side > 0, side * pole ** np.maximum(side, 0), 0) * weight @ difference
            read.append(np.stack([window.real, window.imag], 1).reshape(-1, cells))
    return np.concatenate(read)


def _compact(windows: np.ndarray) -> np.ndarray:
    """The symmetric root of windows^T windows, (cells, cells)."""
    values, vectors = np.linalg.eigh(windows.T @ windows)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)) @ vectors.T)
