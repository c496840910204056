"""Which views of the board to keep, and what the person who holds it should do next. Pure: pictures in, words out.

A view is kept when the board stands still, is sharp, and is held as in no view before. Enough are kept when they reach
nearly everywhere in the picture, and show the board tilted to all sides, near and far: each tells of the camera what
the others cannot (the rim of its distortion, tilt and depth of its focal length apart from the distance).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from base_station.calibration.detection import BoardView

GRID = (6, 4)
"""Columns and rows of the cells that the picture is divided into."""


@dataclass(frozen=True, kw_only=True)
class CollectorSettings:
    """When to keep a view, and when there are enough."""

    still_px: float | None = 0.8
    """Farthest that the corners may have moved (median) since the picture before, in a picture 640 px wide; None: the
    pictures do not follow each other."""
    sharp_px: float = 5.0
    """Widest edges that are sharp enough."""
    new: float = 0.10
    """How differently from every view before the board must be held, by `BoardView.held`."""
    least_views: int = 20
    most_views: int = 60
    least_coverage: float = 0.85
    """Share of the picture's cells in which a corner was seen."""
    tilt_rad: float = 0.26
    """A board tilted by as much shows depth: 15 degrees."""
    tilted_views: int = 2
    """So many to each side."""
    least_spread: float = 1.25
    """The nearest view is larger than the farthest one by this factor."""


@dataclass(frozen=True)
class Verdict:
    """What became of a picture: taken or not, and in words why, or what to do next."""

    taken: bool
    text: str


@dataclass
class Collector:
    """Call `consider` with what was found in every picture."""

    settings: CollectorSettings = field(default_factory=CollectorSettings)
    views: list[BoardView] = field(default_factory=list)
    coverage: np.ndarray = field(default_factory=lambda: np.zeros(GRID[::-1], np.int64))
    """(rows, columns) of GRID: how many corners were seen there."""
    _before: BoardView | None = None

    def consider(self, view: BoardView | None) -> Verdict:
        """Keep this view or not. `view`: None when no board was found."""
        before, self._before = self._before, view
        if view is None:
            return Verdict(False, "no board in view, or too blurred to be found")
        if self.settings.still_px is not None and not self._still(before, view):
            return Verdict(False, "hold still")
        if view.edge_px > self.settings.sharp_px:
            return Verdict(False, f"too blurred (edges of {view.edge_px:.1f} px): more light, or farther away")
        if self.views and min(float(np.abs(view.held - one.held).sum()) for one in self.views) < self.settings.new:
            return Verdict(False, self.advice())
        self.views.append(view)
        self._cover(view)
        return Verdict(True, f"taken: {self.advice()}")

    @property
    def covered(self) -> float:
        """Share of the cells where a corner was seen."""
        return float((self.coverage > 0).mean())

    @property
    def enough(self) -> bool:
        """Whether there is nothing left to ask for, or too many views already."""
        full = len(self.views) >= self.settings.most_views
        return full or (len(self.views) >= self.settings.least_views and not self.lacks())

    def lacks(self) -> list[str]:
        """What the views do not show yet, each as what to do about it, the most important first."""
        wanted = []
        if self.covered < self.settings.least_coverage:
            wanted.append(f"move it to {self._emptiest()}")
        wanted += self._untilted()
        sizes = [one.held[2] for one in self.views]
        if sizes and max(sizes) < min(sizes) * self.settings.least_spread:
            wanted.append("bring it nearer" if np.mean(sizes) < 0.5 else "take it farther away")
        return wanted

    def advice(self) -> str:
        """The next thing to do."""
        lacks = self.lacks()
        if lacks:
            return lacks[len(self.views) % min(len(lacks), 2)]
        return "hold it differently" if not self.enough else "that is enough"

    def _still(self, before: BoardView | None, view: BoardView) -> bool:
        if before is None:
            return False
        _, here, there = np.intersect1d(view.ids, before.ids, return_indices=True)
        if not len(here) or view.size_px != before.size_px:
            return False
        moved = np.linalg.norm(view.points_px[here] - before.points_px[there], axis=1)
        assert self.settings.still_px is not None
        return bool(np.median(moved) <= self.settings.still_px * max(1.0, view.size_px[0] / 640))

    def _cover(self, view: BoardView) -> None:
        cells = np.floor(view.points_px / view.size_px * GRID).astype(int)
        columns, rows = np.clip(cells, 0, (GRID[0] - 1, GRID[1] - 1)).T
        np.add.at(self.coverage, (rows, columns), 1)

    def _emptiest(self) -> str:
        """The part of the picture, of nine, with the largest share of cells without a corner."""
        empty = self.coverage == 0
        rows, columns = np.array_split(np.arange(GRID[1]), 3), np.array_split(np.arange(GRID[0]), 3)
        shares = np.array([[empty[np.ix_(r, c)].mean() for c in columns] for r in rows])
        shares += 0.01 * np.array([(1, 0, 1), (0, -1, 0), (1, 0, 1)])  # of two that are as empty, the outer one
        row, column = np.unravel_index(int(shares.argmax()), shares.shape)
        across, down = ("left", "", "right")[column], ("upper", "", "lower")[row]
        if not across and not down:
            return "the middle of the picture"
        if not across:
            return f"the {'top' if down == 'upper' else 'bottom'} of the picture"
        return f"the {down + ' ' if down else ''}{across} of the picture"

    def _untilted(self) -> list[str]:
        least, views = self.settings.tilt_rad, [one.tilt_rad for one in self.views]
        sides = {
            "tilt it: its right side away": sum(turned > least for turned, _ in views),
            "tilt it: its left side away": sum(turned < -least for turned, _ in views),
            "tilt it: its upper side away": sum(tipped > least for _, tipped in views),
            "tilt it: its lower side away": sum(tipped < -least for _, tipped in views),
        }
        return [text for text, count in sides.items() if count < self.settings.tilted_views]
