"""Complex poles on a logarithmic spiral: the scales at which a row of pixels is read.

A pole p = 1/z = exp(-s (1 + j b)) weighs the pixel at distance u by p^u: it fades over 1/s pixels and turns by b s per
pixel. The fading is what makes |z| > 1 (a transform that forgets what is far from its anchor), the turning carries the
phase, hence the sub-pixel position. With s in a geometric series, enlarging the picture by g maps X(s) to g X(g s): the
same numbers, read further along the series.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class PoleSettings:
    """A bank of poles. Lengths are in cells of the profile they read, whatever that is in pixels."""

    count: int = 6
    """How many scales."""
    longest_cells: float = 12.0
    """1/s of the slowest pole."""
    shortest_cells: float = 1.5
    """1/s of the fastest pole."""
    slope: float = 2.0
    """b: radians turned per e-fold of fading. 0 are real poles, which only blur."""


def decay_rates(settings: PoleSettings) -> np.ndarray:
    """s of every pole, per cell, ascending; shape (count,)."""
    return np.geomspace(1 / settings.longest_cells, 1 / settings.shortest_cells, settings.count)


def spiral_poles(settings: PoleSettings) -> np.ndarray:
    """The poles p = 1/z, complex, shape (count,), all inside the unit circle."""
    return np.exp(-decay_rates(settings) * (1 + 1j * settings.slope))


def scale_weights(settings: PoleSettings) -> np.ndarray:
    """s^1.5 for every pole, shape (count,): with it the window u exp(-s u) has the same energy at every scale."""
    return decay_rates(settings) ** 1.5
