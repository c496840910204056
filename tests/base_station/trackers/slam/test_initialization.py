"""A first pair is found in pictures that were only watched before, also when the camera turns quickly meanwhile."""

from __future__ import annotations

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features
from base_station.trackers.slam.initialization import Initializer, InitialPair
from base_station.trackers.slam.matching import Grid
from base_station.trackers.slam.se3 import exponential
from tests.base_station.trackers.slam.scene import SCALES, box_of_points, features_of, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)


def pictures(turn_rad: float, count: int) -> list[tuple[float, Features, Grid]]:
    """A camera that goes aside and turns by so much a picture."""
    rng = np.random.default_rng(4)
    points, looks = box_of_points(rng, 300), random_looks(rng, 300)
    made = []
    for k in range(count):
        pose = exponential(np.array([0.06 * k, 0.0, 0.0, 0.0, turn_rad * k, 0.0]))
        features = features_of(project(pose, points) + rng.normal(0, 0.3, (300, 2)), looks)
        made.append((k / 20, features, Grid.of(features.xy_px, CAMERA.bounds_px)))
    return made


def test_watched_pictures_give_a_pair_at_once():
    *watched, last = pictures(0.01, 6)
    initializer = Initializer(CAMERA, SCALES)
    for picture in watched:
        initializer.watch(*picture)
    pair = initializer(*last)
    assert isinstance(pair, InitialPair), pair
    assert pair.times_s == (0.0, 0.25)
    assert len(pair.points) > 200
    assert np.array_equal(pair.rows_one, pair.rows_two)


def test_a_turn_of_more_than_the_search_radius_is_followed():
    initializer = Initializer(CAMERA, SCALES)
    one, two = (pictures(0.3, 2)[k] for k in range(2))  # 150 px
    initializer.watch(*one)
    matched = initializer.watch(*two)
    assert matched is not None
    _, rows_one, rows_two = matched
    assert len(rows_one) > 150
    assert np.array_equal(rows_one, rows_two)
