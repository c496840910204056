"""Where is this? The keyframes that look most like a picture, by visual words; the caller tries whether they fit.

Neighbouring keyframes see the same things, so each candidate's score is added up over its neighbours before the best
are chosen (Galvez-Lopez and Tardos, T-RO 2012; Mur-Artal et al. 2015, section V-C).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from base_station.trackers.slam.features import Features
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.place_database import Place, PlaceDatabase
from base_station.trackers.slam.vocabulary import Vocabulary

GROUP = 10
"""Neighbours that a keyframe's score is added up over."""


@dataclass(frozen=True, kw_only=True)
class PlaceSettings:
    """How many places are tried."""

    candidates: int = 3
    """For one picture."""
    least_shared: float = 0.7
    """Of the words that the most similar keyframe shares with the picture."""
    group_share: float = 0.7
    """Of the best group's score, below which a group is not tried."""


class Places:
    """Remembers keyframes by their visual words, and finds those like a picture."""

    def __init__(self, world: Map, settings: PlaceSettings | None = None, vocabulary: Vocabulary | None = None) -> None:
        self._map = world
        self.settings = settings or PlaceSettings()
        self.vocabulary = vocabulary or Vocabulary.load()
        self.database = PlaceDatabase(self.vocabulary)
        self._words: dict[int, np.ndarray] = {}

    def words(self, features: Features) -> np.ndarray:
        """The visual word of each feature, (n,)."""
        return self.vocabulary.bow(features.descriptor_bytes)[0]

    def add(self, keyframe: int, words: np.ndarray) -> None:
        self._words[keyframe] = words
        self.database.add(keyframe, words)

    def tidy(self) -> None:
        """Forget the keyframes that the map has dropped."""
        for keyframe in [row for row in self._words if row < self._map.keyframe_count and not self._map.alive[row]]:
            self.database.remove(keyframe)
            del self._words[keyframe]

    def similarity(self, one: int, two: int) -> float:
        """Between two keyframes, 0..1; 0 where one is not remembered."""
        if one not in self._words or two not in self._words:
            return 0.0
        return self.vocabulary.similarity(self._words[one], self._words[two])

    def candidates(self, words: np.ndarray, *, exclude: Collection[int] = (), least_score: float = 0.0) -> list[int]:
        """The keyframes worth trying for a picture with these words, best group first."""
        found = self.database.query(words, exclude=exclude, least_shared=self.settings.least_shared, most=60)
        found = [place for place in found if place.score >= least_score and self._map.alive[place.keyframe]]
        score_of = {place.keyframe: place.score for place in found}
        groups = [self._group(place, score_of) for place in found]
        best = max((total for total, _ in groups), default=0.0)
        groups = sorted((group for group in groups if group[0] >= self.settings.group_share * best), reverse=True)
        return list(dict.fromkeys(keyframe for _, keyframe in groups))[: self.settings.candidates]

    def _group(self, place: Place, score_of: dict[int, float]) -> tuple[float, int]:
        """The score of a place and its neighbours together, and the best of them."""
        group = [place.keyframe, *(int(row) for row in self._map.neighbours(place.keyframe, GROUP))]
        group = [row for row in group if row in score_of]
        return sum(score_of[row] for row in group), max(group, key=lambda row: score_of[row])
