"""Which keyframes look like this picture: a scan over the visual words of all keyframes.

Two pictures are as similar as `Vocabulary.similarity` says. With ten thousand words every word is in a fifth of the
keyframes, so an inverted index would be read all over the memory: it took 2 to 6 times as long as reading everything
in order (600 and 2000 keyframes; 0.7 and 2.6 ms here). Neighbouring keyframes share much of their view: the caller adds
up the scores of covisible keyframes before it decides.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from base_station.trackers.slam.vocabulary import Vocabulary
from base_station.trackers.slam.vocabulary_kernels import scan

REMOVED = -1


@dataclass(frozen=True)
class Place:
    """A keyframe that resembles the picture."""

    keyframe: int
    score: float
    """0..1, see `Vocabulary.similarity`."""
    shared_words: int


class PlaceDatabase:
    """Keyframes by their visual words. Keyframes are numbers of the caller's, from 0 on."""

    def __init__(self, vocabulary: Vocabulary) -> None:
        self._vocabulary = vocabulary
        self._slots: dict[int, int] = {}
        self._keyframes = np.empty(0, np.int64)
        """Of each slot; REMOVED where there is none any more."""
        self._starts = np.zeros(1, np.int64)
        self._words, self._weights = np.empty(0, np.int32), np.empty(0, np.float32)
        """With room behind the last start."""

    def __len__(self) -> int:
        return len(self._slots)

    def __contains__(self, keyframe: object) -> bool:
        return keyframe in self._slots

    def add(self, keyframe: int, words: np.ndarray) -> None:
        """`words`: of all its descriptors, as `Vocabulary.bow` gives them. Replaces one of the same number.

        Raises ValueError for a negative number.
        """
        if keyframe < 0:
            raise ValueError(f"keyframes are numbered from 0 on, not {keyframe}")
        self.remove(keyframe)
        found, weights = self._vocabulary.vector(words)
        begin, end = int(self._starts[-1]), int(self._starts[-1]) + len(found)
        if end > len(self._words):
            room = max(2 * begin, end) - begin
            self._words = np.concatenate([self._words[:begin], np.zeros(room, np.int32)])
            self._weights = np.concatenate([self._weights[:begin], np.zeros(room, np.float32)])
        self._words[begin:end], self._weights[begin:end] = found, weights
        self._slots[keyframe] = len(self._keyframes)
        self._keyframes = np.append(self._keyframes, keyframe)
        self._starts = np.append(self._starts, end)

    def remove(self, keyframe: int) -> None:
        """What is not there is not missed. Its room is given back when half of the slots are removed ones."""
        slot = self._slots.pop(keyframe, None)
        if slot is None:
            return
        self._keyframes[slot] = REMOVED
        if 2 * len(self._slots) < len(self._keyframes):
            kept = self._keyframes != REMOVED
            lengths = np.diff(self._starts)
            held = np.repeat(kept, lengths)
            self._words = self._words[: self._starts[-1]][held]
            self._weights = self._weights[: self._starts[-1]][held]
            self._starts = np.concatenate([[0], np.cumsum(lengths[kept])])
            self._keyframes = self._keyframes[kept]
            self._slots = {int(number): slot for slot, number in enumerate(self._keyframes)}

    def query(
        self, words: np.ndarray, *, exclude: Collection[int] = (), least_shared: float = 0.0, most: int | None = None
    ) -> list[Place]:
        """The keyframes that share words with this picture, the most similar first.

        `exclude`: keyframes that are not asked for, such as those that the picture's own is covisible with.
        `least_shared`: leave out what shares less than this part of the words that the best one shares, 0..1.
        `most`: give this many at the most.
        """
        found, weights = self._vocabulary.vector(words)
        weight_of = np.zeros(self._vocabulary.size, np.float32)
        weight_of[found] = weights
        scores, shared = np.empty(len(self._keyframes), np.float32), np.empty(len(self._keyframes), np.int32)
        scan(weight_of, self._words, self._weights, self._starts, scores, shared)
        asked = (shared > 0) & (self._keyframes != REMOVED)
        asked[[self._slots[keyframe] for keyframe in exclude if keyframe in self._slots]] = False
        if not asked.any():
            return []
        asked &= shared >= least_shared * shared[asked].max()
        slots = np.flatnonzero(asked)
        slots = slots[np.argsort(-scores[slots], kind="stable")][:most]
        return [Place(int(self._keyframes[slot]), float(scores[slot]), int(shared[slot])) for slot in slots]
