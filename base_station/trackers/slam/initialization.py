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
    widest_radius_px: float = 250.0
    """The same when too little is found there: a quick turn."""
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
        matched = self.watch(time_s, features, grid)
        return "waiting for a second picture" if matched is None else self._pair(*matched, time_s, features)

    def watch(self, time_s: float, features: Features, grid: Grid) -> tuple[_Picture, np.ndarray, np.ndarray] | None:
        """Remember a picture while no pair is wanted yet; the older picture that it would be paired with, and which
        features of both (m,) show the same."""
        matched = None
        if len(features) < self.settings.least_features:
            return None
        while self._pictures and matched is None:
            first = self._pictures[0]
            rows_one, rows_two = self._matches(first, features, grid)
            if len(rows_one) >= self.settings.least_matches:
                matched = first, rows_one, rows_two
            else:
                del self._pictures[: max(1, len(self._pictures) // 2)]
        self._pictures.append(_Picture(time_s, features, features.xy_px.copy()))
        if len(self._pictures) > self.settings.remembered:
            del self._pictures[1]
        return matched

    def _matches(self, first: _Picture, features: Features, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
        octave = first.features.octave.astype(np.int64)
        rows = np.empty(0, np.int64)
        for radius_px in (self.settings.search_radius_px, self.settings.widest_radius_px):
            matches = match_projections(
                first.expected_px.astype(np.float64), np.full(len(octave), radius_px),
                np.stack([octave - 1, octave + 1], axis=1), first.features.descriptors, features, grid,
                most=NEAR, ratio=0.9,
            )  # fmt: skip
            matches = agreeing_in_turn(matches, first.features.angle_deg, features.angle_deg)
            rows = np.flatnonzero(matches >= 0)
            if len(rows) >= self.settings.least_matches:
                break
        found = features.xy_px[matches[rows]]
        first.expected_px[rows] = found
        return rows, matches[rows]

    def _pair(
        self, first: _Picture, rows_one: np.ndarray, rows_two: np.ndarray, time_s: float, features: Features
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
