"""How many points any two keyframes share: a table with a place for each keyframe alive.

Keyframes are numbered for good, their places in the table are not: that of a culled keyframe is given to the next one.
So the table is as large as the map is, however many keyframes it has had. Each Map gives places in its own way.
"""

from __future__ import annotations

import numpy as np
from numba import njit

NONE = -1
FIRST = 64


class Covisibility:
    """`table[place[one], place[two]]`: points that both see; `place`: -1 for a keyframe without one, it shares none."""

    def __init__(self) -> None:
        self.table = np.zeros((FIRST, FIRST), np.int32)
        self.place = np.full(FIRST, NONE, np.int64)
        self._free = list(range(FIRST))[::-1]

    def __getitem__(self, pair: tuple[int, int]) -> int:
        one, two = self.place[list(pair)]
        return int(self.table[one, two]) if one >= 0 and two >= 0 else 0

    def reserve(self, keyframes: int) -> None:
        """Numbers below this may be used."""
        if keyframes > len(self.place):
            more = np.full(max(keyframes, 2 * len(self.place)) - len(self.place), NONE, np.int64)
            self.place = np.concatenate([self.place, more])

    def add(self, keyframe: int) -> None:
        """Give it a place, if it has none; until it is set, it shares nothing."""
        if self.place[keyframe] != NONE:
            return
        if not self._free:
            size = len(self.table)
            self.table = np.pad(self.table, (0, size))
            self._free = list(range(size, 2 * size))[::-1]
        self.place[keyframe] = self._free.pop()

    def remove(self, keyframe: int) -> None:
        """It shares nothing any more; what has no place is not missed."""
        place = int(self.place[keyframe])
        if place == NONE:
            return
        self.table[place] = 0
        self.table[:, place] = 0
        self.place[keyframe] = NONE
        self._free.append(place)

    def of(self, one: np.ndarray, two: np.ndarray) -> np.ndarray:
        """(n, m) of keyframes (n,) and (m,) that have a place; 0 of those that have none."""
        shared = self.table[np.ix_(self.place[one], self.place[two])]
        shared[self.place[one] == NONE] = 0
        shared[:, self.place[two] == NONE] = 0
        return shared

    def set(self, one: np.ndarray, two: np.ndarray, shared: np.ndarray) -> None:
        """Keyframes (n,) share (n, m) points with keyframes (m,); all of them have a place."""
        there = np.ix_(self.place[one], self.place[two])
        self.table[there] = shared
        self.table.T[there] = shared


@njit(cache=True, nogil=True)
def count_shared(point_of, keyframes, others, point_count):
    """(n, m) points that keyframes (n,) and others (m,) both see; none with itself."""
    shared = np.zeros((len(keyframes), len(others)), np.int32)
    seen = np.zeros(point_count, np.bool_)
    for i in range(len(keyframes)):
        for point in point_of[keyframes[i]]:
            if point >= 0:
                seen[point] = True
        for j in range(len(others)):
            if others[j] != keyframes[i]:
                for point in point_of[others[j]]:
                    if point >= 0 and seen[point]:
                        shared[i, j] += 1
        for point in point_of[keyframes[i]]:
            if point >= 0:
                seen[point] = False
    return shared


def count_shared_reference(
    point_of: np.ndarray, keyframes: np.ndarray, others: np.ndarray, point_count: int
) -> np.ndarray:  # fmt: skip
    """The same in plain numpy, for tests."""
    seen = np.zeros((2, len(point_of), point_count + 1), np.int32)
    for table, rows in zip(seen, (keyframes, others), strict=True):
        for row in rows:
            np.add.at(table[row], point_of[row], 1)
    mine, theirs = seen[0, keyframes, :-1] > 0, seen[1, others, :-1]
    shared = mine.astype(np.int32) @ theirs.T
    shared[keyframes[:, None] == others[None, :]] = 0
    return np.asarray(shared, np.int32)
