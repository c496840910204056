"""What the camera may see now: compiled as in plain numpy; bounded; and how much of a keyframe a picture shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from base_station.trackers.slam.culling import redundant_share, redundant_share_reference
from base_station.trackers.slam.keyframe_decision import share_seen
from base_station.trackers.slam.local_map import ASKED, KEPT, MOST_POINTS, local_map, local_map_reference
from base_station.trackers.slam.map import NONE, Map
from tests.base_station.trackers.slam.scene import SCALES, features_of, random_looks


def a_long_map(rng: np.random.Generator, keyframes: int, features: int) -> Map:
    """Keyframes in a row, each of which sees points near its own number; some keyframes and points are gone."""
    world = Map(features, SCALES)
    nothing = features_of(np.zeros((0, 2)), random_looks(rng, 0))
    for row in range(keyframes):
        world.add_keyframe(row, float(row), np.eye(4), nothing, np.empty(0, np.int32), int(row % 11 == 10))
    count = 30 * keyframes
    points = world.add_points(rng.normal(size=(count, 3)), random_looks(rng, count), 0)
    for row in range(keyframes):
        near = points[max(0, 30 * row - 2 * features) : 30 * row + 2 * features]
        seen = rng.choice(near, min(features, len(near)), replace=False)
        world.point_of[row, : len(seen)] = np.where(rng.random(len(seen)) < 0.7, seen, NONE)
    world.point_alive[rng.choice(count, count // 5)] = False
    world.alive[rng.choice(keyframes - 1, keyframes // 6)] = False
    world.recount(np.arange(keyframes))
    return world


@pytest.mark.parametrize(("keyframes", "features"), [(3, 40), (60, 100), (120, 300)])
def test_compiled_is_what_plain_numpy_finds(keyframes, features):
    rng = np.random.default_rng(keyframes)
    world = a_long_map(rng, keyframes, features)
    for reference in np.flatnonzero(world.alive)[::7]:
        of_reference = world.point_of[reference]
        seen = of_reference[of_reference >= 0][: features // 2]
        one, two = local_map(world, seen, int(reference)), local_map_reference(world, seen, int(reference))
        assert one.reference == two.reference
        assert np.array_equal(one.keyframes, two.keyframes)
        assert np.array_equal(one.open_points, two.open_points)
        assert not set(seen.tolist()) & set(one.open_points.tolist())
        assert len(one.keyframes) <= KEPT < ASKED
        assert len(one.open_points) <= MOST_POINTS


def test_a_picture_that_sees_nothing_keeps_its_reference():
    world = a_long_map(np.random.default_rng(0), 20, 50)
    reference = int(np.flatnonzero(world.alive)[3])
    assert local_map(world, np.empty(0, np.int32), reference).reference == reference


def test_the_share_of_a_keyframes_points_that_a_picture_sees():
    alive, observed = np.ones(10, np.bool_), np.array([3, 3, 3, 3, 1, 1, 1, 1, 1, 1], np.int32)
    reference = np.array([0, 1, 2, 3, 4, 5, NONE], np.int32)
    picture = np.array([NONE, 3, 2, 4, 9], np.int32)
    assert share_seen(reference, picture, alive, observed, 2) == pytest.approx(2 / 4)
    assert share_seen(reference, picture, alive, observed, 5) == pytest.approx(3 / 6)  # too few sure ones: all
    alive[3] = False
    assert share_seen(reference, picture, alive, observed, 2) == pytest.approx(1 / 3)
    assert share_seen(np.full(7, NONE, np.int32), picture, alive, observed, 2) == 0.0


def test_a_keyframes_redundancy_is_plain_numpys():
    rng = np.random.default_rng(3)
    world = a_long_map(rng, 40, 80)
    for row in np.flatnonzero(world.alive):
        octave = rng.integers(0, 8, 80).astype(np.uint8)
        world.features[int(row)] = replace(features_of(np.zeros((80, 2)), random_looks(rng, 80)), octave=octave)
        world.octave_of[row] = octave
    shares = []
    for row in np.flatnonzero(world.alive)[::3]:
        others = world.neighbours(int(row), 60)
        share = redundant_share(world.point_of, world.octave_of, world.point_count, row, others, 2)
        assert share == pytest.approx(redundant_share_reference(world, int(row), others, 2))
        shares.append(share)
    assert 0.0 < min(shares) < max(shares) < 1.0
