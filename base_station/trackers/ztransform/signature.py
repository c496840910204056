"""From a placement in a picture to its signature: a few hundred complex numbers of length 1.

The patch under the placement is reduced to row bands and column bands; of each the light's offset is removed by the
central difference, the hard ends by a taper, and the rest is read by two-sided second-order poles about several
anchors. Normalising removes the gain of the light.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from base_station.trackers.ztransform.area import mean_cells
from base_station.trackers.ztransform.kernels import (
    HEIGHT,
    WIDTH,
    fill_unseen,
    match_light,
    read_signature,
    sample_patch,
)
from base_station.trackers.ztransform.poles import PoleSettings, scale_weights, spiral_poles
from base_station.trackers.ztransform.pyramid import Pyramid


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


class SignatureReader:
    """Settings turned into the arrays that the kernels take, in the order in which they take them."""

    def __init__(self, settings: SignatureSettings) -> None:
        cells = settings.cells
        poles = spiral_poles(settings.poles)
        reach = settings.spread / 2
        anchors = np.round(np.linspace(cells * (0.5 - reach), cells * (0.5 + reach), settings.anchors)).astype(np.int64)
        u = (np.arange(cells) + 0.5) / cells
        taper = np.minimum(1, np.minimum(u, 1 - u) / settings.taper).astype(np.float32)
        self.cells = cells
        self.size = 2 * settings.bands * settings.poles.count * 2 * settings.anchors * 2
        self.plan = (
            settings.bands,
            poles.real.astype(np.float32),
            poles.imag.astype(np.float32),
            scale_weights(settings.poles).astype(np.float32),
            np.minimum(anchors, cells - 1),
            taper,
        )
        """bands, pole_re, pole_im, weights, anchors, taper."""

    def source(self, pyramid: Pyramid, placement: np.ndarray) -> tuple[np.ndarray, int, int]:
        """Which image to read for this placement, its scale, reads per cell and axis."""
        return pyramid.for_cell(max(placement[WIDTH], placement[HEIGHT]) / self.cells)

    def patch(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Patch float32 (cells, cells), which cells the frame shows (uint8), and their share 0..1."""
        patch, seen = np.empty((self.cells,) * 2, np.float32), np.empty((self.cells,) * 2, np.uint8)
        image, scale, reads = self.source(pyramid, placement)
        share = sample_patch(image, scale, placement, lens, reads, patch, seen)
        return patch, seen, share

    def means(
        self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray, cells: int
    ) -> tuple[np.ndarray, np.ndarray, float]:
        """As `patch`, of any number of cells a side, each the mean of all of its pixels."""
        patch, seen = np.empty((cells, cells), np.float32), np.empty((cells, cells), np.uint8)
        image, scale, _ = pyramid.for_cell(max(placement[WIDTH], placement[HEIGHT]) / cells)
        share = mean_cells(image, scale, placement, lens, patch, seen)
        return patch, seen, share

    def signature(self, patch: np.ndarray) -> tuple[np.ndarray, float]:
        """Signature float32 (size,) of length 1, and its length before normalising: the contrast that was there."""
        out = np.empty(self.size, np.float32)
        length = read_signature(patch, *self.plan, out)
        return out, length

    def read(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray, learned: np.ndarray) -> np.ndarray:
        """Signature at a placement; cells outside of the frame are taken from the learned patch."""
        patch, seen, share = self.patch(pyramid, placement, lens)
        if share < 1:
            gain, offset = match_light(patch, seen, learned)
            fill_unseen(patch, seen, learned, gain, offset)
        return self.signature(patch)[0]
