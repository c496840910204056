"""How a signature changes when the target moves, learned once from the picture that it was learned in.

The learned placement is disturbed at random a few hundred times, the signature is read each time, and a ridge
regression finds the linear map from the change of signature to the correction. One map per size of disturbance: a wide
one pulls in from afar, a fine one ends without bias. Afterwards tracking needs no search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from base_station.trackers.ztransform.kernels import FREEDOMS, HEIGHT, KEYSTONE, WIDTH, X, Y
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.signature import SignatureReader


@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """Uniform within +- each."""

    shift: float
    """Of the width, and of the height."""
    log_zoom: float
    """Both sides together, natural logarithm."""
    log_aspect: float
    """Width against height, natural logarithm."""
    keystone: float
    """Kept small where the shift is large: it is the weakest of the five in the picture."""


@dataclass(frozen=True, kw_only=True)
class RegressionSettings:
    """How the maps are learned."""

    levels: tuple[Disturbance, ...] = (
        Disturbance(shift=0.35, log_zoom=0.30, log_aspect=0.06, keystone=0.1),
        Disturbance(shift=0.12, log_zoom=0.12, log_aspect=0.06, keystone=0.1),
        Disturbance(shift=0.04, log_zoom=0.04, log_aspect=0.03, keystone=0.06),
    )
    """From wide to fine."""
    samples: int = 500
    """Disturbances per level."""
    ridge: float = 0.015
    """Weight of the ridge against the mean energy of a sample's change."""
    seed: int = 0
    """Of the disturbances: learning the same picture twice gives the same maps."""


def learn_maps(
    pyramid: Pyramid,
    placement: np.ndarray,
    lens: np.ndarray,
    reader: SignatureReader,
    settings: RegressionSettings,
) -> np.ndarray:
    """The maps, float32 (levels, 5, signature size): map @ (signature - learned signature) is the step to take.

    A step is (dx / width, dy / height, d log width, d log height, dq) in units of the placement it starts from.
    """
    rng = np.random.default_rng(settings.seed)
    learned_patch = reader.patch(pyramid, placement, lens)[0]
    learned = reader.signature(learned_patch)[0]
    maps = np.empty((len(settings.levels), FREEDOMS, reader.size), np.float32)
    for level, disturbance in enumerate(settings.levels):
        placements, steps = _disturb(placement, disturbance, settings.samples, rng)
        changes = np.stack([reader.read(pyramid, p, lens, learned_patch) - learned for p in placements])
        gram = (changes @ changes.T).astype(np.float64)
        gram[np.diag_indices_from(gram)] += settings.ridge * np.trace(gram) / len(gram) + 1e-9
        maps[level] = np.linalg.solve(gram, steps).T @ changes
    return maps


def _disturb(
    placement: np.ndarray, size: Disturbance, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Disturbed placements and the steps that lead back from them; both (count, 5)."""
    draw = rng.uniform(-1, 1, (count, FREEDOMS))
    shift = draw[:, :2] * size.shift
    log_width = draw[:, 2] * size.log_zoom + draw[:, 3] * size.log_aspect
    log_height = draw[:, 2] * size.log_zoom - draw[:, 3] * size.log_aspect
    keystone = draw[:, 4] * size.keystone
    placements = np.repeat(placement[None], count, 0)
    placements[:, X] += shift[:, 0] * placement[WIDTH]
    placements[:, Y] += shift[:, 1] * placement[HEIGHT]
    placements[:, WIDTH] *= np.exp(log_width)
    placements[:, HEIGHT] *= np.exp(log_height)
    placements[:, KEYSTONE] = keystone
    back_x, back_y = -shift[:, 0] / np.exp(log_width), -shift[:, 1] / np.exp(log_height)
    return placements, np.stack([back_x, back_y, -log_width, -log_height, -keystone], 1)
