"""FAST corners of one pyramid level, shared out over its cells.

A corner is a pixel with nine in a row of the sixteen on a ring about it that are all brighter, or all darker, than
itself (Rosten and Drummond, ECCV 2006). Its score is by how many grey levels they are. Every pixel is scored, without
a test that most would fail: sixteen loads and some minima over rows of bytes keep the processor busier, and are done
sooner, than one branch a pixel.

OpenCV's own ORB keeps the strongest corners, and they crowd on a few textured things; a pose held by one corner of the
picture is a poor pose. Here the picking goes round the cells: first the best corner of each, then the second best,
until the level's quota is full. Where strong corners are missing, a block of the level gives weak ones, too
(Mur-Artal et al., "ORB-SLAM", 2015, section IV-B names both ideas).
"""

from __future__ import annotations

import numpy as np
from numba import njit

BORDER_PX = 19
"""A descriptor reads its corner's surroundings so far."""
BLOCK_PX = 160
RICH_SHARE = 1.5
"""A block with so many strong corners for each that is wanted of it has no need of weak ones."""
RING = ((0, 3), (1, 3), (2, 2), (3, 1), (3, 0), (3, -1), (2, -2), (1, -3),
        (0, -3), (-1, -3), (-2, -2), (-3, -1), (-3, 0), (-3, 1), (-2, 2), (-1, 3))  # fmt: skip
ARC = 9
LANES = 32
"""So many px are worked on at a time; a row's last ones twice rather than one by one."""
_1, _2, _3, _4, _5, _6 = (np.uint64(n) for n in range(1, 7))
_LANES = np.uint64(LANES)
"""A place in a row is unsigned: a signed one could count from the row's end, and would not be read many at a time."""


class CornerFinder:
    """Finds corners in pictures up to a size. Its memory is used again: not for two threads at once."""

    def __init__(self, width_px: int, height_px: int) -> None:
        most = (width_px // 2 + 1) * (height_px // 2 + 1)  # two neighbours are never both the higher one
        self._scores = np.zeros((3, width_px + 2 * LANES), np.uint8)
        self._peaks = np.zeros(width_px // 8 * 8 + 2 * LANES, np.uint8)
        self._found = np.empty((most, 3), np.int32)

    def __call__(self, level: np.ndarray, quota: int, *, strong: int, weak: int) -> np.ndarray:
        """`quota` corners at the most of this picture (h, w) uint8, (n, 2) int32 px; none within BORDER_PX.

        `strong`, `weak`: the score above which a corner is one, and the same where there are too few.
        """
        height, width = level.shape
        inner_px = (width - 2 * BORDER_PX) * (height - 2 * BORDER_PX)
        if min(width, height) <= 2 * BORDER_PX or quota < 1:
            return np.empty((0, 2), np.int32)
        columns, rows = max(1, round(width / BLOCK_PX)), max(1, round(height / BLOCK_PX))
        n = _candidates(
            level, self._scores, self._peaks, self._found, np.uint8(strong), np.uint8(weak), columns, rows, quota
        )  # fmt: skip
        found = self._found[:n]
        return found[_spread(found, max(8.0, (inner_px / quota) ** 0.5), width, height, quota), :2]


def corner_scores(level: np.ndarray, border: int = 3, least: int = 0) -> np.ndarray:
    """The score of every pixel of a picture (h, w) uint8, the same shape: the largest threshold at which it is a
    corner, plus one. 0 where it is none at threshold `least`, and within `border` px, three at the least. Raises
    ValueError for a picture that is too narrow."""
    if level.shape[1] < 2 * border + LANES:
        raise ValueError(f"{LANES} px are scored at a time: the picture must be wider than {2 * border + LANES - 1} px")
    scores = np.zeros_like(level)
    _score(np.ascontiguousarray(level), scores, border, np.uint8(least))
    return scores


def corner_scores_reference(level: np.ndarray, border: int = 3, least: int = 0) -> np.ndarray:
    """The same in plain numpy, for tests."""
    grey = level.astype(np.int64)
    ring = np.stack([np.roll(grey, (-y, -x), (0, 1)) for x, y in RING]) - grey
    arcs = [ring[np.arange(first, first + ARC) % len(RING)] for first in range(len(RING))]
    scores = np.max([np.maximum(arc.min(axis=0), -arc.max(axis=0)) for arc in arcs], axis=0)
    inside = np.zeros(level.shape, np.bool_)
    inside[border : level.shape[0] - border, border : level.shape[1] - border] = True
    return np.where(inside & (scores > least), scores, 0).astype(np.uint8)


@njit(inline="always")
def _brightest_arc(p0, p1, p2, p3, p4, p5, p6, p7, p8, p9, p10, p11, p12, p13, p14, p15):
    """Of all nine in a row, the largest least: of eight in a row, with the better one of their two neighbours. Two
    such eights share four."""
    a, b, c, d = min(p1, p2), min(p3, p4), min(p5, p6), min(p7, p8)
    e, f, g, h = min(p9, p10), min(p11, p12), min(p13, p14), min(p15, p0)
    ab, bc, cd, de, ef, fg, gh, ha = (
        min(a, b), min(b, c), min(c, d), min(d, e), min(e, f), min(f, g), min(g, h), min(h, a)
    )  # fmt: skip
    one = min(cd, max(min(ab, max(p0, p9)), min(ef, max(p4, p13))))
    two = min(gh, max(min(ef, max(p8, p1)), min(ab, max(p12, p5))))
    three = min(de, max(min(bc, max(p2, p11)), min(fg, max(p6, p15))))
    four = min(ha, max(min(fg, max(p10, p3)), min(bc, max(p14, p7))))
    return max(max(one, two), max(three, four))


@njit(inline="always")
def _score_some(a, b, c, d, e, f, g, scores, x, least):
    """`LANES` px of the row `d`, of which `x` is three before the first, and the three rows before and after it.

    Nine of sixteen in a row hold both ends of one line across the ring, and one end of each other. So where both ends
    of any are brighter than the middle, no nine are darker; else none are brighter, and all is seen as its negative."""
    for lane in range(_LANES):
        k = x + lane
        p0, p1, p2, p3 = g[k + _3], g[k + _4], f[k + _5], e[k + _6]
        p4, p5, p6, p7 = d[k + _6], c[k + _6], b[k + _5], a[k + _4]
        p8, p9, p10, p11 = a[k + _3], a[k + _2], b[k + _1], c[k]
        p12, p13, p14, p15 = d[k], e[k], f[k + _1], g[k + _2]
        across = max(
            max(max(min(p0, p8), min(p1, p9)), max(min(p2, p10), min(p3, p11))),
            max(max(min(p4, p12), min(p5, p13)), max(min(p6, p14), min(p7, p15))),
        )
        negative = np.uint8(0) if across > d[k + _3] else np.uint8(255)
        middle = np.uint8(d[k + _3] ^ negative)
        best = _brightest_arc(
            np.uint8(p0 ^ negative), np.uint8(p1 ^ negative), np.uint8(p2 ^ negative), np.uint8(p3 ^ negative),
            np.uint8(p4 ^ negative), np.uint8(p5 ^ negative), np.uint8(p6 ^ negative), np.uint8(p7 ^ negative),
            np.uint8(p8 ^ negative), np.uint8(p9 ^ negative), np.uint8(p10 ^ negative), np.uint8(p11 ^ negative),
            np.uint8(p12 ^ negative), np.uint8(p13 ^ negative), np.uint8(p14 ^ negative), np.uint8(p15 ^ negative),
        )  # fmt: skip
        score = np.uint8(max(best, middle) - middle)
        scores[k + _3] = score if score > least else np.uint8(0)


@njit(cache=True, nogil=True)
def _score_row(a, b, c, d, e, f, g, scores, first, end, least):
    """One row `d` from `first` to `end`, and up to `LANES` px on where that is narrower."""
    x, last = np.uint64(first - 3), np.uint64(max(first, end - LANES) - 3)
    while x < last:
        _score_some(a, b, c, d, e, f, g, scores, x, least)
        x += _LANES
    _score_some(a, b, c, d, e, f, g, scores, last, least)


@njit(cache=True, nogil=True)
def _score(level, scores, border, least):
    for y in range(border, level.shape[0] - border):
        _score_row(
            level[y - 3], level[y - 2], level[y - 1], level[y], level[y + 1], level[y + 2], level[y + 3],
            scores[y], border, level.shape[1] - border, least,
        )  # fmt: skip


@njit(inline="always")
def _peak_some(before, row, after, peaks, x):
    for lane in range(_LANES):
        k = x + lane
        others = max(max(before[k], before[k + _1]), max(before[k + _2], row[k]))
        others = max(max(others, row[k + _2]), max(after[k], max(after[k + _1], after[k + _2])))
        peaks[k + _1] = row[k + _1] if row[k + _1] > others else np.uint8(0)


@njit(cache=True, nogil=True)
def _peak_row(before, row, after, peaks, first, end):
    """What is higher than its eight neighbours, from `first` to `end`; 0 after it."""
    for x in range(np.uint64(first - 1), np.uint64(end - 1), _LANES):
        _peak_some(before, row, after, peaks, x)
    for lane in range(_LANES):
        peaks[np.uint64(end) + lane] = 0


@njit(cache=True, nogil=True)
def _candidates(level, scores, peaks, found, strong, weak, columns, rows, quota):
    """Fill `found` with the corners to choose from, n of them, rows of x, y, score; n comes back.

    `scores` (3, width + 2 * LANES): room for the scores of a row and its neighbours, `peaks` for what is higher."""
    height, width = level.shape
    n, border = 0, BORDER_PX - 1
    words = peaks.view(np.uint64)
    for y in range(border, height - border):
        _score_row(
            level[y - 3], level[y - 2], level[y - 1], level[y], level[y + 1], level[y + 2], level[y + 3],
            scores[y % 3], border, width - border, weak,
        )  # fmt: skip
        if y < BORDER_PX + 1:
            continue
        _peak_row(scores[(y - 2) % 3], scores[(y - 1) % 3], scores[y % 3], peaks, BORDER_PX, width - BORDER_PX)
        for word in range(BORDER_PX // 8, (width - BORDER_PX + 7) // 8):
            if words[word] == 0:
                continue
            for x in range(8 * word, 8 * word + 8):
                if peaks[x]:
                    found[n, 0], found[n, 1], found[n, 2] = x, y - 1, peaks[x]
                    n += 1
    return _without_weak(found[:n], strong, width, height, columns, rows, RICH_SHARE * quota / (columns * rows))


@njit(cache=True, nogil=True)
def _without_weak(found, strong, width, height, columns, rows, enough):
    """Move what stays to the front: strong corners, and weak ones in blocks that have too few; how many comes back."""
    counts = np.zeros((rows, columns), np.int64)
    column, row = np.arange(width) * columns // width, np.arange(height) * rows // height
    for i in range(len(found)):
        counts[row[found[i, 1]], column[found[i, 0]]] += found[i, 2] > strong
    n = 0
    for i in range(len(found)):
        if found[i, 2] > strong or counts[row[found[i, 1]], column[found[i, 0]]] < enough:
            found[n, 0], found[n, 1], found[n, 2] = found[i, 0], found[i, 1], found[i, 2]
            n += 1
    return n


def spread(found: np.ndarray, cell_px: float, width: int, height: int, count: int) -> np.ndarray:
    """Indices of `count` corners at the most, taken in turns from square cells, the best of each cell first.

    `found` (n, 3) int32: x and y in px, score 0..255.
    """
    return _spread(found, cell_px, width, height, count)


@njit(cache=True, nogil=True)
def _spread(found, cell_px, width, height, count):
    columns = int(width / cell_px) + 1
    seen = np.zeros(columns * (int(height / cell_px) + 1), np.int32)
    order = _sorted_by(255 - found[:, 2], 256)
    turns = np.empty(len(found), np.int32)
    most = 0
    for n in range(len(order)):
        i = order[n]
        cell = int(found[i, 0] / cell_px) + columns * int(found[i, 1] / cell_px)
        turns[n] = seen[cell]
        seen[cell] += 1
        most = max(most, seen[cell])
    return order[_sorted_by(turns, most)[:count]]


@njit(cache=True, nogil=True)
def _sorted_by(keys, most):
    """Indices of whole numbers 0..most - 1, ascending, equal ones as they came."""
    place = np.zeros(most + 1, np.int64)
    for key in keys:
        place[key + 1] += 1
    for key in range(most):
        place[key + 1] += place[key]
    order = np.empty(len(keys), np.int64)
    for i in range(len(keys)):
        order[place[keys[i]]] = i
        place[keys[i]] += 1
    return order
