"""Who is who: finding the features of a picture again, by where they should be and by how they look.

All of it is compiled. A *grid* sorts the keypoints of a picture into square cells, so that a search looks at the few
near a place. A keypoint has one owner: the better-looking claimant keeps it. A search's second best must be clearly
worse (Lowe's ratio), when it is of the same scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from base_station.trackers.slam.features import Features
from base_station.trackers.slam.popcount import hamming

NEAR = 50
"""Bits of 256: descriptors that differ by no more are very likely of the same point."""
FAR = 100
"""Bits: the same where the place has been predicted."""
CELL_PX = 16.0
TURN_BINS = 30


@dataclass(frozen=True)
class Grid:
    """Keypoints by cell: those of cell c are `order[start[c]:start[c + 1]]`."""

    start: np.ndarray
    order: np.ndarray
    left_px: float
    top_px: float
    columns: int
    rows: int

    @classmethod
    def of(cls, xy_px: np.ndarray, bounds_px: np.ndarray) -> Grid:
        """Of keypoints (n, 2) within (left, top, right, bottom); those outside count to the border's cells."""
        left, top, right, bottom = (float(side) for side in bounds_px)
        columns, rows = int((right - left) / CELL_PX) + 1, int((bottom - top) / CELL_PX) + 1
        start, order = _by_cell(xy_px, left, top, columns, rows)
        return cls(start, order, left, top, columns, rows)


@njit(cache=True, nogil=True)
def _by_cell(xy, left, top, columns, rows):
    cells = np.empty(len(xy), np.int64)
    start, order = np.zeros(columns * rows + 1, np.int64), np.empty(len(xy), np.int64)
    for i in range(len(xy)):
        column = min(max((xy[i, 0] - left) / CELL_PX, 0.0), columns - 1.0)
        row = min(max((xy[i, 1] - top) / CELL_PX, 0.0), rows - 1.0)
        cells[i] = int(column) + columns * int(row)
        start[cells[i] + 1] += 1
    for cell in range(columns * rows):
        start[cell + 1] += start[cell]
    place = start.copy()
    for i in range(len(xy)):
        order[place[cells[i]]] = i
        place[cells[i]] += 1
    return start, order


def match_projections(
    uv_px: np.ndarray,
    radius_px: np.ndarray,
    octaves: np.ndarray,
    descriptors: np.ndarray,
    features: Features,
    grid: Grid,
    *,
    most: int = FAR,
    ratio: float = 0.9,
    taken: np.ndarray | None = None,
) -> np.ndarray:
    """For each of m projected points the keypoint that shows it, or -1: (m,) int32.

    `uv_px` (m, 2) where they should be, `radius_px` (m,) how far around to look, `octaves` (m, 2) the lowest and
    highest level allowed, `descriptors` (m, 4). Keypoints where `taken` (n,) is set have an owner already.
    """
    if taken is None:
        taken = np.zeros(len(features), np.bool_)
    return _match_projections(
        uv_px, radius_px, octaves, descriptors,
        features.xy_px, features.octave, features.descriptors, taken,
        grid.start, grid.order, grid.left_px, grid.top_px, grid.columns, grid.rows, most, ratio,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _claim(i, k, distance, matches, owner, owner_distance):
    """Keypoint k becomes i's, unless its owner resembles it as much; an owner that loses it goes without."""
    if distance < owner_distance[k]:
        if owner[k] >= 0:
            matches[owner[k]] = -1
        owner[k], owner_distance[k] = i, distance
        matches[i] = k


@njit(cache=True, nogil=True)
def _match_projections(
    uv, radius, octaves, descriptors, xy, octave, looks, taken, start, order, left, top, columns, rows, most, ratio
):
    matches = np.full(len(uv), -1, np.int32)
    owner = np.full(len(xy), -1, np.int32)
    owner_distance = np.full(len(xy), 257, np.int32)
    for i in range(len(uv)):
        x, y, r = uv[i, 0], uv[i, 1], radius[i]
        if not (np.isfinite(x) and np.isfinite(y)):
            continue
        first_column = max(int(np.floor((x - r - left) / CELL_PX)), 0)
        last_column = min(int(np.floor((x + r - left) / CELL_PX)), columns - 1)
        first_row = max(int(np.floor((y - r - top) / CELL_PX)), 0)
        last_row = min(int(np.floor((y + r - top) / CELL_PX)), rows - 1)
        best, second, best_k, best_level, second_level = 257, 257, -1, -1, -2
        for row in range(first_row, last_row + 1):
            for s in (
                range(start[row * columns + first_column], start[row * columns + last_column + 1])
                if (first_column <= last_column)
                else range(0)
            ):
                k = order[s]
                level = octave[k]
                if taken[k] or level < octaves[i, 0] or level > octaves[i, 1]:
                    continue
                dx, dy = xy[k, 0] - x, xy[k, 1] - y
                if dx * dx + dy * dy > r * r:
                    continue
                distance = hamming(descriptors[i], looks[k])
                if distance < best:
                    second, second_level = best, best_level
                    best, best_level, best_k = distance, level, k
                elif distance < second:
                    second, second_level = distance, level
        if best > most or (best_level == second_level and best > ratio * second):
            continue
        _claim(i, best_k, best, matches, owner, owner_distance)
    return matches


def match_everywhere(
    descriptors: np.ndarray,
    angles_deg: np.ndarray,
    features: Features,
    *,
    most: int = NEAR,
    ratio: float = 0.75,
) -> np.ndarray:
    """For each of m described features its like anywhere in the picture, or -1: (m,) int32. Slow, knows no place.

    Matches that turn otherwise than most (in the picture's plane) are dropped.
    """
    matches = _match_everywhere(descriptors, features.descriptors, most, ratio)
    return agreeing_in_turn(matches, angles_deg, features.angle_deg)


@njit(cache=True, nogil=True)
def _match_everywhere(descriptors, looks, most, ratio):
    matches = np.full(len(descriptors), -1, np.int32)
    owner = np.full(len(looks), -1, np.int32)
    owner_distance = np.full(len(looks), 257, np.int32)
    for i in range(len(descriptors)):
        best, second, best_k = 257, 257, -1
        for k in range(len(looks)):
            distance = hamming(descriptors[i], looks[k])
            if distance < best:
                second, best, best_k = best, distance, k
            elif distance < second:
                second = distance
        if best > most or best > ratio * second:
            continue
        _claim(i, best_k, best, matches, owner, owner_distance)
    return matches


def agreeing_in_turn(matches: np.ndarray, angles_deg: np.ndarray, other_angles_deg: np.ndarray) -> np.ndarray:
    """The matches without those whose turn is not in the fullest direction of turn or its neighbours."""
    rows = np.flatnonzero(matches >= 0)
    if len(rows) == 0:
        return matches
    turn = (other_angles_deg[matches[rows]] - angles_deg[rows]) % 360.0
    bins = np.floor(turn * (TURN_BINS / 360.0)).astype(np.int64) % TURN_BINS
    counts = np.bincount(bins, minlength=TURN_BINS)
    three = counts + np.roll(counts, 1) + np.roll(counts, -1)
    distance = np.abs((bins - int(np.argmax(three)) + TURN_BINS // 2) % TURN_BINS - TURN_BINS // 2)
    kept = matches.copy()
    kept[rows[distance > 1]] = -1
    return kept


def match_epipolar(
    one: Features,
    two: Features,
    free_one: np.ndarray,
    free_two: np.ndarray,
    fundamental: np.ndarray,
    epipole_px: np.ndarray,
    sigma_px: np.ndarray,
    *,
    most: int = NEAR,
    ratio: float = 0.9,
) -> np.ndarray:
    """For each free feature of picture one its like in picture two near its epipolar line, or -1: (n,) int32.

    `fundamental` takes a point of one to its line in two; `epipole_px`: where camera one stands in picture two, near
    which depth is unknown (not finite: nowhere); `sigma_px` (levels,): the standard deviation of a keypoint.
    """
    return _match_epipolar(
        one.xy_px, one.descriptors, one.octave, free_one,
        two.xy_px, two.descriptors, two.octave, free_two,
        fundamental, epipole_px, sigma_px, most, ratio,
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _match_epipolar(
    xy_one, looks_one, octave_one, free_one, xy_two, looks_two, octave_two, free_two,
    f, epipole, sigma, most, ratio,
):  # fmt: skip
    matches = np.full(len(xy_one), -1, np.int32)
    owner = np.full(len(xy_two), -1, np.int32)
    owner_distance = np.full(len(xy_two), 257, np.int32)
    rows = np.flatnonzero(free_two)
    x_two, y_two, bound = np.empty(len(rows), np.float32), np.empty(len(rows), np.float32), np.empty(len(rows))
    near_line = np.zeros((len(rows) + 7) // 8 * 8, np.bool_)
    for j in range(len(rows)):
        x_two[j], y_two[j] = xy_two[rows[j], 0], xy_two[rows[j], 1]
        dx, dy = x_two[j] - epipole[0], y_two[j] - epipole[1]
        near = 10.0 * sigma[octave_two[rows[j]]]
        bound[j] = -1.0 if dx * dx + dy * dy < near * near else 1.96 * sigma[octave_two[rows[j]]]
    words = near_line.view(np.uint64)
    for i in range(len(xy_one)):
        if not free_one[i]:
            continue
        x, y = xy_one[i, 0], xy_one[i, 1]
        a = f[0, 0] * x + f[0, 1] * y + f[0, 2]
        b = f[1, 0] * x + f[1, 1] * y + f[1, 2]
        c = f[2, 0] * x + f[2, 1] * y + f[2, 2]
        length = np.sqrt(a * a + b * b)
        if length < 1e-12:
            continue
        _near_line(a / length, b / length, c / length, x_two, y_two, bound, near_line)
        best, second, best_k = 257, 257, -1
        for word in range(len(words)):
            if words[word] == 0:
                continue
            for j in range(8 * word, 8 * word + 8):
                if not near_line[j] or abs(np.int64(octave_two[rows[j]]) - np.int64(octave_one[i])) > 2:
                    continue
                distance = hamming(looks_one[i], looks_two[rows[j]])
                if distance < best:
                    second, best, best_k = best, distance, rows[j]
                elif distance < second:
                    second = distance
        if best > most or best > ratio * second:
            continue
        _claim(i, best_k, best, matches, owner, owner_distance)
    return matches


@njit(cache=True, nogil=True)
def _near_line(a, b, c, x, y, bound, near):
    """Which points lie within their bound of a line; many at a time: few do."""
    for j in range(np.uint64(len(x))):
        near[j] = abs(a * x[j] + b * y[j] + c) <= bound[j]
