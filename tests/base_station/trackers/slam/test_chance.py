"""Chance poses: matches that any picture would give are told from points found again, however few these are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.chance import ChanceSettings, bits, log10_false_alarms, log10_poisson_tail
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.local_map import LocalMap
from base_station.trackers.slam.map import Map, refresh_points
from base_station.trackers.slam.matching import Grid, match_projections
from base_station.trackers.slam.popcount import hamming_reference
from base_station.trackers.slam.tracking import FrameTracker, Located, Picture, TrackingSettings
from base_station.trackers.slam.visibility import Expected
from tests.base_station.trackers.slam.scene import SCALES, box_of_points, features_of, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
ALLOWED = ChanceSettings().most_log10
TRIED = 70


def changed(rng: np.random.Generator, descriptors: np.ndarray, share: float) -> np.ndarray:
    """With so many of the bits turned over."""
    flips = np.packbits(rng.random((len(descriptors), 256)) < share, axis=1).view(np.uint64)
    return descriptors ^ flips


def looks(rng: np.random.Generator, count: int) -> np.ndarray:
    """Of things that are all somewhat alike, as those in a picture are: 100 bits apart, as is asked for at least."""
    return changed(rng, np.zeros((count, 4), np.uint64), 0.27)


def log10_alarms(found_again: int, *, bits_changed: float = 0.15, seed: int = 0) -> float:
    """Of a picture that shows nothing of a map of 800 points but so many of them, with so many of their bits changed.
    With none found again, the pose is as good as chance may make it: 40 px beside, with the best matches there."""
    rng = np.random.default_rng(seed)
    world = Map(1000, 1.2 ** np.arange(8))
    points = rng.uniform([-2.0, -1.5, 4.0], [2.0, 1.5, 6.0], (800, 3))
    rows = world.add_points(points, looks(rng, 800), 0)
    uv, octave = rng.uniform([0.0, 0.0], [640.0, 480.0], (800, 2)), rng.integers(0, 8, 800)
    expected = Expected(rows, uv, octave, np.full(800, 10.0))
    xy = rng.uniform([0.0, 0.0], [640.0, 480.0], (1000, 2)).astype(np.float32)
    levels, descriptors = rng.integers(0, 8, 1000).astype(np.uint8), looks(rng, 1000)
    xy[:found_again], levels[:found_again] = uv[:found_again], octave[:found_again]
    descriptors[:found_again] = changed(rng, world.descriptors[rows[:found_again]], bits_changed)
    features = Features(xy, levels, np.zeros(1000, np.float32), descriptors)
    grid = Grid.of(xy, CAMERA.bounds_px)
    point_of = np.full(1000, -1, np.int32)
    point_of[:found_again] = rows[:found_again]
    if not found_again:
        matches = match_projections(
            uv, 2.45 * world.scales[octave], expected.octave_range, world.descriptors[rows], features, grid
        )
        point_of[matches[matches >= 0]] = rows[matches >= 0]
    return log10_false_alarms(world, expected, features, grid, point_of, TRIED)


@pytest.mark.parametrize("seed", range(3))
def test_points_found_by_chance_are_no_evidence_and_points_found_again_are(seed):
    assert log10_alarms(0, seed=seed) > 0.0
    assert log10_alarms(16, seed=seed) < 2 * ALLOWED


def test_few_that_look_the_same_say_more_than_many_that_hardly_do():
    assert log10_alarms(16, bits_changed=0.1) < ALLOWED < log10_alarms(16, bits_changed=0.37)


def test_three_points_can_always_be_made_to_fit():
    assert log10_alarms(3, bits_changed=0.0) > 0.0


@pytest.mark.parametrize(("allowed", "believed"), [(ALLOWED, True), (-math.inf, False)])
def test_the_tracker_asks_before_it_believes_a_pose(allowed, believed):
    rng = np.random.default_rng(0)
    points, alike = box_of_points(rng, 80), random_looks(rng, 80)
    features = features_of(project(np.eye(4), points), alike)
    world = Map(80, SCALES)
    world.add_keyframe(0, 0.0, np.eye(4), features, np.empty(0, np.int32), 0)
    rows = world.add_points(points, alike, 0)
    world.point_of[0, rows] = rows
    refresh_points(world, rows, np.array([0]))
    tracker = FrameTracker(CAMERA, world, TrackingSettings(chance=ChanceSettings(most_log10=allowed)))
    picture = Picture(0.0, features, Grid.of(features.xy_px, CAMERA.bounds_px))
    found = tracker.locate_by(picture, 0)
    assert isinstance(found, Located) if believed else found == "80 points are seen, as many as by chance"
    first = Located(np.eye(4), rows.copy(), 0, 80, LocalMap(0, np.array([0]), np.empty(0, np.int64)), 80)
    tracker.remember(picture, first, moving=False)
    again = Picture(0.1, features, picture.grid)
    assert isinstance(tracker.follow(again), Located) is believed


def test_the_tail_of_poissons_distribution():
    exact = 1.0 - math.exp(-2.5) * (1 + 2.5 + 2.5**2 / 2 + 2.5**3 / 6)
    assert log10_poisson_tail(2.5, 4) == pytest.approx(math.log10(exact), abs=1e-6)
    assert log10_poisson_tail(2.5, 2) == 0.0
    assert log10_poisson_tail(0.1, 30) < -60


def test_bits_are_those_of_the_table():
    rng = np.random.default_rng(5)
    one, two = looks(rng, 20), looks(rng, 20)
    assert np.array_equal(bits(one, two), np.diag(hamming_reference(one, two)))
