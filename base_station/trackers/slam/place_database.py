"""Which keyframes look like this picture: an inverted index from visual words to the keyframes that have them.

Each word keeps a chain of entries (keyframe, weight) in a few growing arrays; a query walks the chains of its own words
only. Two pictures are as similar as `Vocabulary.similarity` says. Neighbouring keyframes share much of their view: the
caller adds up the scores of covisible keyframes before it decides.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from base_station.trackers.slam.vocabulary import Vocabulary
from base_station.trackers.slam.vocabulary_kernels import walk_index

FIRST_ENTRIES = 4096


@dataclass(frozen=True)
class Place:
    """A keyframe that resembles the picture."""

    keyframe: int
    score: float
    """0..1, see `Vocabulary.similarity`."""
    shared_words: int


class PlaceDatabase:
    """Keyframes by their visual words. Keyframes are numbers of the caller's."""

    def __init__(self, vocabulary: Vocabulary) -> None:
        self._vocabulary = vocabulary
        self._slots: dict[int, int] = {}
        self._keyframes: list[int | None] = []
        self._vectors: list[tuple[np.ndarray, np.ndarray]] = []
        self._clear_index()

    def __len__(self) -> int:
        return len(self._slots)

    def __contains__(self, keyframe: object) -> bool:
        return keyframe in self._slots

    def add(self, keyframe: int, words: np.ndarray) -> None:
        """`words`: of all its descriptors, as `Vocabulary.bow` gives them. Replaces one of the same number."""
        self.remove(keyframe)
        self._slots[keyframe] = len(self._keyframes)
        self._keyframes.append(keyframe)
        self._vectors.append(self._vocabulary.vector(words))
        self._index(len(self._keyframes) - 1)

    def remove(self, keyframe: int) -> None:
        """What is not there is not missed. The index is made anew when half of it is of removed keyframes."""
        slot = self._slots.pop(keyframe, None)
        if slot is None:
            return
        self._keyframes[slot] = None
        if len(self._slots) * 2 < len(self._keyframes):
            kept = sorted(self._slots.values())
            self._keyframes = [self._keyframes[slot] for slot in kept]
            self._vectors = [self._vectors[slot] for slot in kept]
            self._slots = {keyframe: slot for slot, keyframe in enumerate(self._keyframes) if keyframe is not None}
            self._clear_index()
            for slot in range(len(kept)):
                self._index(slot)

    def query(
        self, words: np.ndarray, *, exclude: Collection[int] = (), least_shared: float = 0.0, most: int | None = None
    ) -> list[Place]:
        """The keyframes that share words with this picture, the most similar first.

        `exclude`: keyframes that are not asked for, such as those that the picture's own is covisible with.
        `least_shared`: leave out what shares less than this part of the words that the best one shares, 0..1.
        `most`: give this many at the most.
        """
        found, weights = self._vocabulary.vector(words)
        scores = np.zeros(len(self._keyframes), np.float32)
        shared = np.zeros(len(self._keyframes), np.int32)
        walk_index(found, weights, self._heads, self._following, self._holders, self._held_weights, scores, shared)
        asked = np.array([keyframe is not None and keyframe not in exclude for keyframe in self._keyframes], bool)
        asked &= shared > 0
        if not asked.any():
            return []
        asked &= shared >= least_shared * shared[asked].max()
        slots = np.flatnonzero(asked)
        slots = slots[np.argsort(-scores[slots], kind="stable")][:most]
        keyframes = self._keyframes
        return [
            Place(keyframe, float(scores[slot]), int(shared[slot]))
            for slot in slots
            if (keyframe := keyframes[slot]) is not None
        ]

    def _clear_index(self) -> None:
        self._heads = np.full(self._vocabulary.size, -1, np.int32)
        self._following = np.empty(FIRST_ENTRIES, np.int32)
        self._holders = np.empty(FIRST_ENTRIES, np.int32)
        self._held_weights = np.empty(FIRST_ENTRIES, np.float32)
        self._entries = 0

    def _index(self, slot: int) -> None:
        words, weights = self._vectors[slot]
        begin, end = self._entries, self._entries + len(words)
        if end > len(self._following):
            room = max(2 * len(self._following), end)
            self._following, self._holders, self._held_weights = (
                np.concatenate([array[:begin], np.empty(room - begin, array.dtype)])
                for array in (self._following, self._holders, self._held_weights)
            )
        self._following[begin:end] = self._heads[words]
        self._heads[words] = np.arange(begin, end, dtype=np.int32)
        self._holders[begin:end] = slot
        self._held_weights[begin:end] = weights
        self._entries = end
