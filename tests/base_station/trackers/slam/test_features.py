"""Features: spread over the picture, turned and described as OpenCV's ORB does, none where there is nothing."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import cv2
import numpy as np
import pytest

from base_station.trackers.slam.corners import (
    BORDER_PX,
    CornerFinder,
    corner_scores,
    corner_scores_reference,
    spread,
)
from base_station.trackers.slam.descriptors import describe, smoothed
from base_station.trackers.slam.features import FeatureExtractor, FeatureSettings
from tests.base_station.trackers.slam.room import Room, small_camera, standing

CAMERA = small_camera()
PICTURE = Room(CAMERA).picture(standing(0.2, -0.5, 0.4))
NOISE = np.random.default_rng(1).integers(0, 256, (240, 320)).astype(np.uint8)


def covered_cells(xy: np.ndarray) -> int:
    return len({(int(x) // 20, int(y) // 20) for x, y in xy})


def test_they_cover_more_of_the_picture_than_opencvs():
    ours = FeatureExtractor(CAMERA, FeatureSettings(count=400))(PICTURE)
    theirs = cv2.KeyPoint_convert(cv2.ORB_create(400).detect(PICTURE))
    assert 380 <= len(ours) <= 400
    assert covered_cells(ours.xy_px) > 1.25 * covered_cells(theirs)
    assert np.bincount(ours.octave, minlength=8).min() > 5


def test_every_pixel_is_scored_as_by_plain_numpy():
    assert np.array_equal(corner_scores(PICTURE), corner_scores_reference(PICTURE))
    assert np.array_equal(corner_scores(NOISE, 5, 30), corner_scores_reference(NOISE, 5, 30))
    assert 0.05 < np.mean(corner_scores(NOISE, 5, 30) > 0) < 0.9


@pytest.mark.parametrize("width", [240, 200, 77, 40])
def test_corners_are_opencvs(width):
    picture = np.ascontiguousarray(PICTURE[:150, :width])
    points = cv2.FastFeatureDetector_create(20).detect(picture)
    theirs = {(int(point.pt[0]), int(point.pt[1])) for point in points}
    inside = (BORDER_PX, width - BORDER_PX), (BORDER_PX, 150 - BORDER_PX)
    theirs = {corner for corner in theirs if all(a <= v < b for v, (a, b) in zip(corner, inside, strict=True))}
    ours = CornerFinder(320, 240)(picture, 10_000, strong=20, weak=20)
    assert {(x, y) for x, y in ours.tolist()} == theirs
    assert len(theirs) > 0


def test_weak_corners_are_taken_where_strong_ones_are_missing():
    faint = PICTURE.copy()
    faint[:, 160:] = 100 + faint[:, 160:] // 12
    find = CornerFinder(320, 240)
    with_weak, without = (find(faint, 300, strong=20, weak=weak) for weak in (7, 20))
    assert (without[:, 0] < 165).all()
    assert (with_weak[:, 0] > 165).sum() > 30


@pytest.mark.parametrize("picture", ["PICTURE", "NOISE"])
def test_looks_and_angles_are_opencvs_to_the_bit(picture):
    image = globals()[picture]
    corners = CornerFinder(320, 240)(image, 300, strong=20, weak=7)
    _, angles, looks = describe(image, smoothed(image), corners)
    detected = cv2.ORB_create(2000, nlevels=1, edgeThreshold=BORDER_PX).detect(image)
    theirs = {point.pt: point.angle for point in detected}
    both = [(angle, theirs[x, y]) for (x, y), angle in zip(corners.tolist(), angles, strict=True) if (x, y) in theirs]
    assert len(both) > 50
    assert max(abs((one - two + 180) % 360 - 180) for one, two in both) < 0.5
    points = [
        cv2.KeyPoint(float(x), float(y), 31.0, float(angle), 0.0, 0)
        for (x, y), angle in zip(corners, angles, strict=True)
    ]
    _, wanted = cv2.ORB_create(2000, nlevels=1, edgeThreshold=BORDER_PX).compute(image, points)
    different = np.unpackbits(looks.view(np.uint8).reshape(-1, 32) ^ wanted, axis=1).sum(axis=1)
    assert len(looks) == len(wanted) == 300
    assert different.max() <= 2  # a turned place may lie on the edge of two pixels
    assert different.mean() < 0.1


def place_reference(image: np.ndarray, x: int, y: int) -> np.ndarray:
    """Where the edges about a corner meet, in plain numpy."""
    v, u = np.mgrid[-4:5, -4:5]
    patch = image[y - 5 : y + 6, x - 5 : x + 6].astype(float)
    gradients = np.stack([patch[1:-1, 2:] - patch[1:-1, :-2], patch[2:, 1:-1] - patch[:-2, 1:-1]], axis=-1)
    weights = np.exp(-(u * u + v * v) / 16)
    tensors = weights[..., None, None] * gradients[..., :, None] * gradients[..., None, :]
    matrix = tensors.sum(axis=(0, 1))
    right = np.einsum("vuab,vub->a", tensors, np.stack([u, v], axis=-1).astype(float))
    if np.linalg.det(matrix) <= 1e-3 * matrix[0, 0] * matrix[1, 1]:
        return np.array([x, y], float)
    step = np.linalg.solve(matrix, right)
    return np.array([x, y]) + (step if np.abs(step).max() <= 1 else 0.0)


def test_places_are_where_the_edges_meet():
    corners = CornerFinder(320, 240)(PICTURE, 300, strong=20, weak=7)
    places, _, _ = describe(PICTURE, smoothed(PICTURE), corners)
    plain = np.array([place_reference(PICTURE, x, y) for x, y in corners])
    off = np.abs(places - plain).max(axis=1)
    assert (off > 1e-3).mean() < 0.01  # a step of just one px is taken, or not
    assert 0.2 < np.abs(places - corners).max() <= 1


def test_a_corner_at_the_border_is_refused():
    with pytest.raises(ValueError, match="nearer than 19 px"):
        describe(PICTURE, PICTURE, np.array([[18, 100]], np.int32))


def test_a_picture_that_is_a_part_of_another_gives_the_same_features():
    wide = np.zeros((240, 400), np.uint8)
    wide[:, 40:360] = PICTURE
    one, two = (FeatureExtractor(CAMERA)(picture) for picture in (PICTURE, wide[:, 40:360]))
    assert np.array_equal(one.descriptors, two.descriptors)


def test_the_same_picture_gives_the_same_features():
    one, two = (FeatureExtractor(CAMERA)(PICTURE) for _ in range(2))
    assert np.array_equal(one.xy_px, two.xy_px)
    assert np.array_equal(one.descriptors, two.descriptors)


def test_which_thread_works_decides_nothing():
    extract = FeatureExtractor(CAMERA)
    shared, gate = extract(PICTURE), threading.Event()
    extract._other_thread.submit(gate.wait)  # a core that others have
    try:
        alone = extract(PICTURE)
    finally:
        gate.set()
    assert np.array_equal(shared.xy_px, alone.xy_px)
    assert np.array_equal(shared.descriptors, alone.descriptors)


def test_nothing_to_see_gives_no_features():
    extract = FeatureExtractor(CAMERA)
    for grey in (0, 128, 255):
        features = extract(np.full((240, 320), grey, np.uint8))
        assert len(features) == 0
        assert features.descriptor_bytes.shape == (0, 32)


def test_spreading_takes_the_best_of_each_cell_before_any_second():
    rng = np.random.default_rng(0)
    crowd = np.column_stack([rng.integers(20, 40, (100, 2)), np.full(100, 200)])
    lonely = np.array([[100, 30, 8], [200, 100, 9], [300, 200, 7]])
    picked = spread(np.vstack([crowd, lonely]).astype(np.int32), 40.0, 340, 240, 6)
    assert {100, 101, 102} < set(picked.tolist())
    assert len(set(picked.tolist())) == 6


def test_memory_that_nobody_wrote_decides_nothing():
    """The same bits whatever glibc fills new memory with: a place read beyond an array's end would show."""
    program = (
        "import hashlib, numpy as np\n"
        "from base_station.trackers.slam.camera import SlamCamera\n"
        "from base_station.trackers.slam.features import FeatureExtractor\n"
        "picture = np.random.default_rng(0).integers(0, 255, (24, 32), np.uint8).repeat(10, 0).repeat(10, 1)\n"
        "camera = SlamCamera(width_px=320, height_px=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5)\n"
        "found = FeatureExtractor(camera)(picture)\n"
        "arrays = (found.xy_px, found.octave, found.angle_deg, found.descriptors)\n"
        "print(len(found.xy_px), hashlib.sha256(b''.join(array.tobytes() for array in arrays)).hexdigest())\n"
    )
    told = {
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "MALLOC_PERTURB_": fill},
            capture_output=True,
            check=True,
        ).stdout
        for fill in ("1", "165")
    }
    assert len(told) == 1 and int(told.pop().split()[0]) > 100
