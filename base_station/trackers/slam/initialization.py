"""How a map begins: two pictures with enough motion between them.

The pictures of the last second or so are kept. Each new one is matched against the oldest; when too little of that one
is still in view, a later one takes its place. The first pair that `two_view` believes becomes the first two keyframes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.matching import NEAR, Grid, agreeing_in_turn, match_projections
from base_station.trackers.slam.two_view import TwoViewSettings, solve_two_view


@dataclass(frozen=True, kw_only=True)
class InitializerSettings:
    """What a first pair needs."""

    search_radius_px: float = 100.0
    """Around where a keypoint was last matched."""
    least_features: int = 150
    """A picture with fewer cannot begin a map."""
    least_matches: int = 90
    """With the older picture; with fewer, a later one is taken."""
    remembered: int = 30
    """Pictures that are kept."""
    two_view: TwoViewSettings = field(default_factory=TwoViewSettings)


@dataclass(frozen=True)
class InitialPair:
    """Two pictures and the points that both show, in the first one's coordinates; the motion has length 1.

    `rows_one`, `rows_two` (m,): which feature of each picture shows point i.
    """

    times_s: tuple[float, float]
    features: tuple[Features, Features]
    two_from_one: np.ndarray
    points: np.ndarray
    rows_one: np.ndarray
    rows_two: np.ndarray


@dataclass
class _Picture:
    time_s: float
    features: Features
    expected_px: np.ndarray
    """Where each of its features was last matched."""


class Initializer:
    """Fed with every picture as long as there is no map."""

    def __init__(self, camera: SlamCamera, scales: np.ndarray, settings: InitializerSettings | None = None) -> None:
        self._camera, self._scales = camera, scales
        self.settings = settings or InitializerSettings()
        self._pictures: list[_Picture] = []

    def reset(self) -> None:
        """Forget all pictures."""
        self._pictures.clear()

    def __call__(self, time_s: float, features: Features, grid: Grid) -> InitialPair | str:
        """The first pair, or in words why not yet."""
        if len(features) < self.settings.least_features:
            return "too few features to begin a map"
        answer: InitialPair | str = "waiting for a second picture"
        while self._pictures:
            first = self._pictures[0]
            rows_one, rows_two = self._matches(first, features, grid)
            if len(rows_one) >= self.settings.least_matches:
                answer = self._pair(first, time_s, features, rows_one, rows_two)
                break
            del self._pictures[: max(1, len(self._pictures) // 2)]
        self._pictures.append(_Picture(time_s, features, features.xy_px.copy()))
        if len(self._pictures) > self.settings.remembered:
            del self._pictures[1]
        return answer

    def _matches(self, first: _Picture, features: Features, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        octave = first.features.octave.astype(np.int64)
        matches = match_projections(
            first.expected_px.astype(np.float64), np.full(len(octave), self.settings.search_radius_px),
            np.stack([octave - 1, octave + 1], axis=1), first.features.descriptors, features, grid,
            most=NEAR, ratio=0.9,
        )  # fmt: skip
        matches = agreeing_in_turn(matches, first.features.angle_deg, features.angle_deg)
        rows = np.flatnonzero(matches >= 0)
        first.expected_px[rows] = features.xy_px[matches[rows]]
        return rows, matches[rows]

    def _pair(
        self, first: _Picture, time_s: float, features: Features, rows_one: np.ndarray, rows_two: np.ndarray
    ) -> InitialPair | str:
        scales = (self._scales[first.features.octave[rows_one]], self._scales[features.octave[rows_two]])
        found = solve_two_view(
            first.features.xy_px[rows_one], features.xy_px[rows_two], self._camera.matrix, scales,
            self.settings.two_view,
        )  # fmt: skip
        if isinstance(found, str):
            return found
        return InitialPair(
            (first.time_s, time_s), (first.features, features), found.two_from_one, found.points,
            rows_one[found.rows], rows_two[found.rows],
        )  # fmt: skip
