"""Features: spread over the picture, turned and described as OpenCV's ORB does, none where there is nothing."""

from __future__ import annotations

import cv2
import numpy as np

from base_station.trackers.slam.features import FeatureExtractor, FeatureSettings, orientations, spread
from tests.base_station.trackers.slam.room import Room, small_camera, standing

CAMERA = small_camera()
PICTURE = Room(CAMERA).picture(standing(0.2, -0.5, 0.4))


def covered_cells(xy: np.ndarray) -> int:
    return len({(int(x) // 20, int(y) // 20) for x, y in xy})


def test_they_cover_more_of_the_picture_than_opencvs():
    ours = FeatureExtractor(CAMERA, FeatureSettings(count=400))(PICTURE)
    theirs = cv2.KeyPoint_convert(cv2.ORB_create(400).detect(PICTURE))
    assert 380 <= len(ours) <= 400
    assert covered_cells(ours.xy_px) > 1.25 * covered_cells(theirs)
    assert np.bincount(ours.octave, minlength=8).min() > 5


def test_orientations_are_opencvs():
    points = cv2.ORB_create(200, nlevels=1).detect(PICTURE)
    xy = cv2.KeyPoint_convert(points)
    theirs = np.array([point.angle for point in points])
    difference = (orientations(PICTURE, xy) - theirs + 180) % 360 - 180
    assert np.abs(difference).max() < 0.5


def test_the_same_picture_gives_the_same_features():
    one, two = (FeatureExtractor(CAMERA)(PICTURE) for _ in range(2))
    assert np.array_equal(one.xy_px, two.xy_px)
    assert np.array_equal(one.descriptors, two.descriptors)


def test_nothing_to_see_gives_no_features():
    extract = FeatureExtractor(CAMERA)
    for grey in (0, 128, 255):
        features = extract(np.full((240, 320), grey, np.uint8))
        assert len(features) == 0
        assert features.descriptor_bytes.shape == (0, 32)


def test_spreading_takes_the_best_of_each_cell_before_any_second():
    rng = np.random.default_rng(0)
    crowd = np.column_stack([rng.uniform(20, 40, 100), rng.uniform(20, 40, 100)])
    lonely = np.array([[100.0, 30.0], [200.0, 100.0], [300.0, 200.0]])
    scores = np.concatenate([np.full(100, 200.0), [8.0, 9.0, 7.0]]).astype(np.float32)
    picked = spread(np.vstack([crowd, lonely]).astype(np.float32), scores, 40.0, 340, 240, 6)
    assert {100, 101, 102} < set(picked.tolist())
    assert len(set(picked.tolist())) == 6
