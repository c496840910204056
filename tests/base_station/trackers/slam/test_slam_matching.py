"""Matching: what the compiled searches find is what a plain search over everything finds."""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam.features import Features
from base_station.trackers.slam.matching import (
    Grid,
    agreeing_in_turn,
    match_epipolar,
    match_everywhere,
    match_projections,
)
from base_station.trackers.slam.popcount import hamming_reference
from base_station.trackers.slam.triangulation import fundamental_matrix
from tests.base_station.trackers.slam.scene import (
    MATRIX,
    SCALES,
    box_of_points,
    features_of,
    motion,
    project,
    random_looks,
)

BOUNDS = np.array([0.0, 0.0, 639.0, 479.0])


def flipped(rng: np.random.Generator, looks: np.ndarray, bits: int) -> np.ndarray:
    """The same descriptors with so many bits of each turned over."""
    changed = looks.view(np.uint8).reshape(len(looks), 32).copy()
    for row in changed:
        for bit in rng.choice(256, bits, replace=False):
            row[bit // 8] ^= 1 << (bit % 8)
    return changed.view(np.uint64).reshape(-1, 4)


def test_projections_match_as_a_plain_search_does():
    rng = np.random.default_rng(1)
    n, m, radius = 400, 300, 30.0
    xy = rng.uniform([0, 0], [639, 479], (n, 2))
    looks = rng.integers(0, 4, (n, 4)).astype(np.uint64) * np.uint64(0x0F0F0F0F0F0F0F0F)  # many look alike
    octave = rng.integers(0, 8, n).astype(np.uint8)
    features = Features(xy.astype(np.float32), octave, np.zeros(n, np.float32), looks)
    uv = rng.uniform([-20, -20], [660, 500], (m, 2))
    wanted = rng.integers(0, 4, (m, 4)).astype(np.uint64) * np.uint64(0x0F0F0F0F0F0F0F0F)
    level = rng.integers(0, 8, m)
    ranges = np.column_stack([level - 1, level + 1])
    matches = match_projections(
        uv, np.full(m, radius), ranges, wanted, features, Grid.of(features.xy_px, BOUNDS), most=64, ratio=1.0
    )
    distances = hamming_reference(wanted, looks)
    near = np.linalg.norm(uv[:, None] - features.xy_px[None], axis=2) <= radius
    near &= np.abs(octave[None].astype(int) - level[:, None]) <= 1
    distances = np.where(near, distances, 999)
    best = distances.min(axis=1)
    owners: dict[int, int] = {}
    for i in np.flatnonzero(matches >= 0):
        assert distances[i, matches[i]] == best[i] <= 64
        assert matches[i] not in owners
        owners[int(matches[i])] = i
    for i in np.flatnonzero((matches < 0) & (best <= 64)):  # only because a better or an earlier claimant has it
        k = int(np.flatnonzero(distances[i] == best[i])[0])
        taken = [j for j in np.flatnonzero(distances[i] == best[i]) if int(j) in owners]
        assert taken, (i, k)
    assert 50 < len(owners) < m


def test_a_grids_cells_hold_what_lies_in_them():
    rng = np.random.default_rng(9)
    xy = rng.uniform([-30, -30], [680, 520], (500, 2)).astype(np.float32)
    grid = Grid.of(xy, BOUNDS)
    assert (grid.columns, grid.rows) == (40, 30)
    column = np.clip(xy[:, 0] // 16, 0, 39).astype(int)
    row = np.clip(xy[:, 1] // 16, 0, 29).astype(int)
    cell = column + 40 * row
    assert np.array_equal(grid.order, np.argsort(cell, kind="stable"))
    assert np.array_equal(np.diff(grid.start), np.bincount(cell, minlength=1200))


def test_everywhere_finds_all_despite_noise_and_refuses_the_unknown():
    rng = np.random.default_rng(2)
    looks = random_looks(rng, 300)
    seen = features_of(rng.uniform(20, 400, (300, 2)), flipped(rng, looks, 20)[::-1].copy())
    matches = match_everywhere(looks, np.zeros(300, np.float32), seen)
    assert np.array_equal(matches, np.arange(299, -1, -1))
    assert (match_everywhere(random_looks(rng, 300), np.zeros(300, np.float32), seen) == -1).all()


def test_two_that_look_alike_are_no_match():
    rng = np.random.default_rng(3)
    looks = random_looks(rng, 50)
    doubled = np.vstack([looks, flipped(rng, looks, 2)])
    seen = features_of(rng.uniform(20, 400, (100, 2)), doubled)
    assert (match_everywhere(flipped(rng, looks, 20), np.zeros(50, np.float32), seen) == -1).all()


def test_a_match_that_turns_otherwise_is_dropped():
    matches = np.arange(20, dtype=np.int32)
    angles = np.zeros(20, np.float32)
    turned = np.full(20, 40.0, np.float32)
    turned[[3, 7]] = 200.0
    kept = agreeing_in_turn(matches, angles, turned)
    assert np.flatnonzero(kept < 0).tolist() == [3, 7]


def test_epipolar_search_finds_the_pairs_and_nothing_off_the_line():
    rng = np.random.default_rng(4)
    points = box_of_points(rng, 200)
    two_from_one = motion(rng, 0.5, 0.1)
    looks = random_looks(rng, 200)
    off = np.arange(200) % 4 == 0
    uv_two = project(two_from_one, points)
    fundamental = fundamental_matrix(two_from_one, MATRIX)
    uv_one = project(np.eye(4), points)
    lines = np.column_stack([uv_one, np.ones(200)]) @ fundamental.T
    uv_two[off] += 8.0 * (lines[:, :2] / np.linalg.norm(lines[:, :2], axis=1, keepdims=True))[off]
    free = np.ones(200, np.bool_)
    free[1] = False
    matches = match_epipolar(
        features_of(uv_one, looks), features_of(uv_two, looks), free, np.ones(200, np.bool_), fundamental,
        np.full(2, np.nan), SCALES,
    )  # fmt: skip
    expected = np.where(off | ~free, -1, np.arange(200))
    assert np.array_equal(matches, expected)
