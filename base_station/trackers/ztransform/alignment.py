"""The last step of following a rigid target: the patch itself, cell by cell, held against the learned one.

The signature's bands have lost what its cells knew: a part that is covered, a picture that is mirrored, the last
tenth of a pixel. So the patch is cut into blocks, each with its own offset and gain of light. One step of Gauss and
Newton (the inverse compositional one of Baker and Matthews, IJCV 2004: all derivatives are learned) weighs each block
by how well it fits. What changes a picture without moving it (`appearance`) is estimated with the step, and
forgotten. How sure one can be is told by the better half of the blocks: up to half may be covered.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from base_station.trackers.ztransform.alignment_kernels import (
    ANYWHERE_PX,
    MORE_TO_READ,
    are_shown,
    compare_blocks,
    least_squares,
    settle,
    weigh_blocks,
)
from base_station.trackers.ztransform.appearance import appearances
from base_station.trackers.ztransform.kernels import FREEDOMS, WIDTH, move
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.resemblance import slope_directions
from base_station.trackers.ztransform.signature import SignatureReader


@dataclass(frozen=True, kw_only=True)
class AlignmentSettings:
    """How the patch is compared."""

    blocks: int = 8
    """Along each side; divides half of the patch's cells."""
    probe_cells: float = 0.25
    """How far the placement is moved to learn how the patch changes."""
    likely_step: tuple[float, ...] = (0.03, 0.03, 0.03, 0.03, 0.05)
    """Standard deviation of a step: of the width, of the height, two logarithms, keystone. It holds what the patch
    knows nothing about."""
    doubt: float = 4.0
    """Neighbouring cells err together: their misfit counts for so many times its variance against `likely_step`."""
    largest_step: float = 0.1
    """Of width and height."""
    repeat_px: float = 0.2
    """After a step longer than this comes another one..."""
    exact_px: float = 0.0005
    """... and after one longer than this over 1 - the correlation with what was learned, while steps are left."""
    steps: int = 5
    """At most, of the fine ones."""
    near_cells: float = 1.0
    """Settled further away than this, a target is not where it was expected..."""
    near_steps: int = 3
    """... nor if more steps are needed."""
    smoothing_cells: float = 1.5
    """Of the coarse steps, which come from further away."""
    coarse_steps: int = 3
    """Of them."""
    judged_part: float = 0.5
    """Of the target that must be alike; the rest may be covered."""
    noisy_below: float = 0.9
    """Where the resemblance is below this, the pixels' noise is measured, and what it explains is forgiven."""
    fewest_pixels: float = 4.0
    """In a cell, for that: where there are fewer, neighbouring cells are alike by themselves, and much looks alike."""
    alike: float = 0.7
    """A block with a correlation above this is seen."""


class _Level(NamedTuple):
    """What is learned of the patch, as the kernels take it."""

    planes: np.ndarray
    """float32 (3 + n, cells, cells): deviations from each block's mean; the directions of the slopes across and down;
    the n changes of the deviations, with the five parts of a step and with appearance."""
    block_sums: np.ndarray
    """float32 (2, blocks): energy of the deviations, of the slopes."""
    products: np.ndarray
    """float32 (n (n + 1) / 2, blocks): of any two changes, see `alignment_kernels`."""
    strong: float
    """Median of the blocks' energies."""
    prior: np.ndarray
    """(n,): 1 / variance of each change, against the misfit's variance."""


class Alignment(NamedTuple):
    """`confidence` 0..1. `share`: of the target that lies in the frame; `alike`: of that, what looks as it was learned,
    by its contrast."""

    placement: np.ndarray
    confidence: float
    share: float
    alike: float


class Aligner:
    """One learned patch. `learn` first."""

    def __init__(self, settings: AlignmentSettings, reader: SignatureReader) -> None:
        self._settings, self._reader = settings, reader

    def learn(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> None:
        """Remember the patch, and how it changes when the placement moves, and in other light."""
        settings, probes = self._settings, []
        for freedom, reach in enumerate((1, 1, 2, 2, 4)):
            step = np.zeros(FREEDOMS)
            step[freedom] = settings.probe_cells * reach / self._reader.cells
            ahead, back = (self._means(pyramid, _moved(placement, s), lens)[0] for s in (step, -step))
            probes.append((ahead - back) / (2 * step[freedom]))
        patch = self._means(pyramid, placement, lens)[0]
        looks = appearances(pyramid, placement, lambda seen: self._means(seen, placement, lens)[0])
        self._fine = self._level(patch, probes + looks)
        self._rough = self._level(_halved(patch), [_halved(probe) for probe in probes])
        self._coarse = self._level(patch, probes, settings.smoothing_cells)

    def settle(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray, *, is_near: bool = False) -> Alignment:
        """From a few tenths of a cell away to where it is exactly. `is_near`: with confidence 0 where that is not near,
        for a target that may be elsewhere."""
        steps, farthest_px = self._settings.steps, ANYWHERE_PX
        if is_near:
            steps = self._settings.near_steps
            farthest_px = self._settings.near_cells * float(placement[WIDTH]) / self._reader.cells
        settings, placement, source = self._settings, placement.copy(), _NOTHING
        while True:
            confidence, share, alike = settle(
                pyramid.image, *source, lens, placement, *self._rough, *self._fine, steps, settings.repeat_px,
                settings.exact_px, farthest_px, settings.largest_step, settings.judged_part, settings.alike,
                settings.noisy_below, settings.fewest_pixels,
            )  # fmt: skip
            if share != MORE_TO_READ:
                return Alignment(placement, confidence, share, alike)
            source = pyramid.sums(1.0)

    def approach(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> Alignment:
        """From a cell or two away: some steps on the smoothed patch, then as `settle`."""
        placement, shown = placement.copy(), np.ones(self._settings.blocks**2, np.uint8)
        for _ in range(self._settings.coarse_steps):
            patch, seen, share = self._means(pyramid, placement, lens)
            if share < 1 or not shown.all():
                are_shown(seen, shown)
            self._step(self._coarse, placement, patch, shown)
        return self.settle(pyramid, placement, lens)

    def _means(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        return self._reader.means(pyramid, placement, lens, self._reader.cells)

    def _level(self, patch: np.ndarray, changes: list[np.ndarray], smoothing: float = 0.0) -> _Level:
        learned, *changes = (self._deviations(p, smoothing) for p in (patch, *changes))
        energies = self._in_blocks(np.square(learned))
        as_light = [self._in_blocks(change * learned) / (energies + 1e-3) for change in changes]
        kept = [c - self._in_cells(a, len(c)) * learned for c, a in zip(changes, as_light, strict=True)]
        slopes = np.empty((2, *patch.shape), np.float32)
        slope_directions(patch, slopes, np.empty_like(patch))
        planes = np.concatenate([learned[None], slopes, np.stack(kept)]).astype(np.float32)
        block_sums = np.stack([energies.ravel(), self._in_blocks(np.square(slopes).sum(0)).ravel()]).astype(np.float32)
        pairs = [one * other for k, one in enumerate(kept) for other in kept[: k + 1]]
        products = np.array([self._in_blocks(pair).ravel() for pair in pairs], np.float32)
        likely = np.ones(len(kept))
        likely[:FREEDOMS] = self._settings.likely_step
        prior = self._settings.doubt / np.square(likely)
        return _Level(planes, block_sums, products, float(np.median(energies)), prior)

    def _in_blocks(self, values: np.ndarray) -> np.ndarray:
        """Sums of each block, (blocks, blocks) of them."""
        blocks, side = self._settings.blocks, len(values) // self._settings.blocks
        return np.asarray(values.reshape(blocks, side, blocks, side).sum((1, 3)))

    def _in_cells(self, values: np.ndarray, cells: int) -> np.ndarray:
        """The other way: to each of (cells, cells) the value of its block."""
        side = cells // self._settings.blocks
        return np.asarray(values.repeat(side, 0).repeat(side, 1))

    def _deviations(self, patch: np.ndarray, smoothing: float) -> np.ndarray:
        smooth, cells = _smoothed(patch, smoothing), len(patch)
        return np.asarray(smooth - self._in_cells(self._in_blocks(smooth) * self._settings.blocks**2 / cells**2, cells))

    def _step(self, level: _Level, placement: np.ndarray, patch: np.ndarray, shown: np.ndarray) -> None:
        """Move the placement in place."""
        step, deviations, compared = np.zeros(FREEDOMS), np.empty_like(patch), np.empty((2, len(shown)), np.float32)
        planes, energies, gains = level.planes, level.block_sums[0], np.empty(len(shown), np.float32)
        compare_blocks(_smoothed(patch, self._settings.smoothing_cells), shown, planes[0], deviations, compared)
        usual = weigh_blocks(deviations, compared, energies, level.strong, gains)
        if usual > 0:
            least_squares(deviations, gains, usual, planes[3:], level.products, level.prior, step)
        move(placement, step, self._settings.largest_step)


_NOTHING = np.empty((0, 0), np.int32), np.zeros(5)
"""In the place of running sums that nobody needs yet."""


def _moved(placement: np.ndarray, step: np.ndarray) -> np.ndarray:
    out = placement.copy()
    move(out, step, 1.0)
    return out


def _halved(patch: np.ndarray) -> np.ndarray:
    """Of cells twice as large, float32."""
    return np.asarray(cv2.resize(patch.astype(np.float32), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))


def _smoothed(patch: np.ndarray, cells: float) -> np.ndarray:
    return cv2.GaussianBlur(patch, (0, 0), cells) if cells else patch
