"""The last step of following a rigid target: the patch itself, cell by cell, held against the learned one.

The signature's bands have lost what its cells knew: a part that is covered, a picture that is mirrored, the last tenth
of a pixel. So the patch is cut into blocks, each with its own offset and gain of light. One step of Gauss and Newton
(the inverse compositional one of Baker and Matthews, IJCV 2004: all derivatives are learned) weighs each block by how
well it fits. How sure one can be is told by the better half of the blocks: up to half may be covered.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.trackers.ztransform.alignment_kernels import (
    compare_blocks,
    cut_blocks,
    robust_step,
    settle,
    slope_directions,
)
from base_station.trackers.ztransform.kernels import FREEDOMS, move
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.refinement import MORE_TO_READ
from base_station.trackers.ztransform.signature import SignatureReader


@dataclass(frozen=True, kw_only=True)
class AlignmentSettings:
    """How the patch is compared."""

    blocks: int = 8
    """Along each side; divides the patch's cells."""
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
    """After a step longer than this comes another one."""
    steps: int = 5
    """At most, of the fine ones."""
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


@dataclass(frozen=True)
class _Level:
    """What is learned of the patch, smoothed by `smoothing` cells; see `alignment_kernels`."""

    smoothing: float
    learned: np.ndarray
    energies: np.ndarray
    changes: np.ndarray
    hessians: np.ndarray


@dataclass(frozen=True)
class Alignment:
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
        self._prior = settings.doubt / np.square(np.array(settings.likely_step))

    def learn(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> None:
        """Remember the patch, and how it changes when the placement moves."""
        settings, probes = self._settings, []
        for freedom, reach in enumerate((1, 1, 2, 2, 4)):
            step = np.zeros(FREEDOMS)
            step[freedom] = settings.probe_cells * reach / self._reader.cells
            ahead, back = (self._means(pyramid, _moved(placement, s), lens)[0] for s in (step, -step))
            probes.append((ahead - back) / (2 * step[freedom]))
        patch = self._means(pyramid, placement, lens)[0]
        self._fine, self._coarse = (self._level(patch, probes, s) for s in (0.0, settings.smoothing_cells))
        self._slopes = np.stack([cut_blocks(slope, settings.blocks) for slope in slope_directions(patch)[0]])
        self._slope_energies = np.square(self._slopes).sum((0, 2))

    def settle(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> Alignment:
        """From a few tenths of a cell away to where it is exactly."""
        placement = placement.copy()
        for whole in (False, True):
            found = self.settle_in(
                self._reader.source(pyramid, placement, lens, whole=whole), pyramid.image, placement, lens
            )
            if found.share != MORE_TO_READ:
                break
        return found

    def settle_in(
        self, source: tuple[np.ndarray, np.ndarray], image: np.ndarray, placement: np.ndarray, lens: np.ndarray
    ) -> Alignment:
        """The same by the running sums that are at hand, in place. A share of MORE_TO_READ: it left them."""
        settings, fine = self._settings, self._fine
        confidence, share, alike = settle(
            *source, lens, placement, image, fine.learned, fine.energies, fine.changes, fine.hessians, self._slopes,
            self._slope_energies, self._prior, self._reader.cells, settings.steps, settings.repeat_px,
            settings.largest_step, settings.judged_part, settings.alike, settings.noisy_below, settings.fewest_pixels,
        )  # fmt: skip
        return Alignment(placement, confidence, share, alike)

    def approach(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> Alignment:
        """From a cell or two away: some steps on the smoothed patch, then as `settle`."""
        placement = placement.copy()
        for _ in range(self._settings.coarse_steps):
            patch, seen, _ = self._means(pyramid, placement, lens)
            cut, compared = self._compare(self._coarse, patch, seen)
            self._step(self._coarse, placement, cut, compared)
        return self.settle(pyramid, placement, lens)

    def _means(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        return self._reader.means(pyramid, placement, lens, self._reader.cells)

    def _level(self, patch: np.ndarray, probes: list[np.ndarray], smoothing: float) -> _Level:
        learned, *changes = (self._deviations(p, smoothing) for p in (patch, *probes))
        energies = np.square(learned).sum(1)
        as_light = [(change * learned).sum(1) / (energies + 1e-3) for change in changes]
        kept = np.stack([c - a[:, None] * learned for c, a in zip(changes, as_light, strict=True)], 1)
        return _Level(smoothing, learned, energies, kept, np.einsum("bki,bji->bkj", kept, kept))

    def _deviations(self, patch: np.ndarray, smoothing: float) -> np.ndarray:
        cut = cut_blocks(_smoothed(patch, smoothing), self._settings.blocks)
        return cut - cut.mean(1, keepdims=True)

    def _compare(self, level: _Level, patch: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        cut = cut_blocks(_smoothed(patch, level.smoothing), self._settings.blocks)
        shown = cut_blocks(seen, self._settings.blocks)
        return cut, compare_blocks(cut, shown, level.learned, level.energies)

    def _step(self, level: _Level, placement: np.ndarray, cut: np.ndarray, compared: np.ndarray) -> None:
        """Move the placement in place."""
        step = np.zeros(FREEDOMS)
        robust_step(
            cut, compared, level.learned, level.energies, level.changes, level.hessians, self._prior, step
        )  # fmt: skip
        move(placement, step, self._settings.largest_step)


def _moved(placement: np.ndarray, step: np.ndarray) -> np.ndarray:
    out = placement.copy()
    move(out, step, 1.0)
    return out


def _smoothed(patch: np.ndarray, cells: float) -> np.ndarray:
    return cv2.GaussianBlur(patch, (0, 0), cells) if cells else patch
