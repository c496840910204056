"""Where a target may be of which a part is covered: each piece of it says where it would fit, and the most votes win.

The learned picture is kept as a few cells, cut into square pieces. Around where the target is expected, each piece's
correlation with every place is a vote, bounded, so that what covers some pieces cannot outvote the others. The place
that comes out is good to half a cell: `alignment` makes it exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.signature import SignatureReader


@dataclass(frozen=True, kw_only=True)
class PieceSettings:
    """How finely, how far."""

    cells: int = 24
    """Across the target."""
    pieces: int = 6
    """Along each side; divides the cells."""
    reach: float = 0.4
    """In target widths and heights: how far it is looked for."""
    faint: float = 0.05
    """A piece with this share of the mean piece's variance has half of its correlation left."""


@njit(cache=True, fastmath=True, error_model="numpy")
def count_votes(window, learned, side, faint, votes):
    """Votes for every shift, into `votes` (shifts, shifts), as the sum of squared positive correlations of the pieces.

    `learned`: (cells, cells) as pieces of `side` cells; `window` larger by shifts - 1. `faint`: see `PieceSettings`, in
    grey levels squared.
    """
    pieces, shifts, n = learned.shape[0] // side, votes.shape[0], np.float32(side * side)
    piece = np.empty((side, side), np.float32)
    votes[:] = 0
    for top in range(0, pieces * side, side):
        for left in range(0, pieces * side, side):
            mean = np.float32(0)
            for y in range(side):
                for x in range(side):
                    mean += learned[top + y, left + x] / n
            variance = np.float32(0)
            for y in range(side):
                for x in range(side):
                    piece[y, x] = learned[top + y, left + x] - mean
                    variance += piece[y, x] * piece[y, x] / n
            weight = variance / (variance + 4 * faint)
            for down in range(shifts):
                for right in range(shifts):
                    total, square, product = np.float32(0), np.float32(0), np.float32(0)
                    for y in range(side):
                        for x in range(side):
                            value = window[top + down + y, left + right + x] - mean
                            total += value
                            square += value * value
                            product += value * piece[y, x]
                    seen = max(square - total * total / n, np.float32(0)) / n
                    if product > 0:
                        product /= n
                        votes[down, right] += weight * product * product / (variance * (seen + faint) + 1e-6)


class Pieces:
    """One target's. `learn` first."""

    def __init__(self, settings: PieceSettings, reader: SignatureReader) -> None:
        self._settings, self._reader = settings, reader
        self._away = round(settings.reach * settings.cells)
        self._votes = np.empty((2 * self._away + 1,) * 2, np.float32)

    def learn(self, pyramid: Pyramid, placement: np.ndarray, lens: np.ndarray) -> None:
        """Remember the target at this placement."""
        settings = self._settings
        self._learned = self._reader.means(pyramid, placement, lens, settings.cells)[0]
        side = settings.cells // settings.pieces
        cut = self._learned.reshape(settings.pieces, side, settings.pieces, side)
        self._faint = settings.faint * float(cut.var((1, 3)).mean()) + 1e-3

    def find(self, pyramid: Pyramid, expected: np.ndarray, lens: np.ndarray) -> np.ndarray:
        """The placement with the most votes about the expected one, of its size."""
        settings, placement = self._settings, expected.copy()
        around = expected.copy()
        wide = settings.cells + 2 * self._away
        around[[WIDTH, HEIGHT]] *= wide / settings.cells
        window = self._reader.means(pyramid, around, lens, wide)[0]
        count_votes(window, self._learned, settings.cells // settings.pieces, np.float32(self._faint), self._votes)
        down, right = divmod(int(self._votes.argmax()), len(self._votes))
        placement[X] += (right - self._away) / settings.cells * expected[WIDTH]
        placement[Y] += (down - self._away) / settings.cells * expected[HEIGHT]
        return placement
