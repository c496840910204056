"""The learned target found again in a picture itself."""

import math

import numpy as np
import pytest

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.sighting import sight

CAMERA = SlamCamera(width_px=640, height_px=480, fx=555.0, fy=555.0, cx=319.5, cy=239.5)
MIDDLE_PX = np.array([319.0, 218.0])


def turned(about_vertical_rad: float) -> np.ndarray:
    c, s = math.cos(about_vertical_rad), math.sin(about_vertical_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def pairs_of_a_poster(
    rng: np.random.Generator, aside_rad: float, nearer: float, *, wrong: int = 0, noise_px: float = 0.7
) -> tuple[np.ndarray, np.ndarray]:
    """A wall's patch 0.7 m ahead, learned head-on; then the camera stands aside, and looks at the patch's middle."""
    n = 150
    learned = MIDDLE_PX + rng.uniform(-110, 110, (n, 2))
    rays = np.column_stack([(learned - CAMERA.intrinsics[2:]) / CAMERA.intrinsics[:2], np.ones(n)])
    points = 0.7 * rays
    middle = 0.7 * np.append((MIDDLE_PX - CAMERA.intrinsics[2:]) / CAMERA.intrinsics[:2], 1.0)
    in_cam = (points - middle) @ turned(aside_rad).T + middle / nearer
    seen = in_cam[:, :2] / in_cam[:, 2:] * CAMERA.intrinsics[:2] + CAMERA.intrinsics[2:]
    seen += rng.normal(0, noise_px, seen.shape)
    seen[:wrong] = rng.uniform((0, 0), (640, 480), (wrong, 2))
    return learned.astype(np.float32), seen.astype(np.float32)


@pytest.mark.parametrize(("aside_deg", "nearer"), [(0.0, 1.0), (20.0, 1.0), (-20.0, 0.7), (35.0, 1.2)])
def test_a_poster_from_aside_is_as_far_as_it_is_picture_after_picture(aside_deg, nearer):
    """A similarity tells a zoom that is 2 % off and jumps by as much: a robot steered by it trembled."""
    rng = np.random.default_rng(0)
    told = []
    for _ in range(20):
        learned, seen = pairs_of_a_poster(rng, math.radians(aside_deg), nearer, wrong=20)
        found = sight(learned, seen, MIDDLE_PX, CAMERA, flat=True)
        assert found is not None
        assert found.middle_px == pytest.approx(MIDDLE_PX, abs=0.8)
        told.append(found.zoom)
    assert np.mean(told) == pytest.approx(nearer, rel=0.003)
    assert np.std(told) < 0.004 * nearer


def test_without_noise_it_is_exact():
    learned, seen = pairs_of_a_poster(np.random.default_rng(1), 0.3, 0.8, noise_px=0.0)
    found = sight(learned, seen, MIDDLE_PX, CAMERA, flat=True)
    assert found.zoom == pytest.approx(0.8, rel=1e-4)
    assert found.middle_px == pytest.approx(MIDDLE_PX, abs=0.02)
    assert found.inliers >= 145


def test_a_whole_view_is_no_plane():
    learned, seen = pairs_of_a_poster(np.random.default_rng(2), 0.0, 0.9)
    found = sight(learned, seen, MIDDLE_PX, CAMERA, flat=False)
    assert found.zoom == pytest.approx(0.9, rel=0.005)
    assert found.middle_px == pytest.approx(MIDDLE_PX, abs=0.5)


def test_few_corners_are_told_by_a_similarity():
    learned, seen = pairs_of_a_poster(np.random.default_rng(3), 0.0, 0.9)
    found = sight(learned[:12], seen[:12], MIDDLE_PX, CAMERA, flat=True)
    assert found.zoom == pytest.approx(0.9, rel=0.02)


@pytest.mark.parametrize("flat", [True, False])
def test_pairs_that_agree_on_nothing_are_no_sighting(flat):
    rng = np.random.default_rng(4)
    learned, seen = (rng.uniform((0, 0), (640, 480), (150, 2)).astype(np.float32) for _ in range(2))
    assert sight(learned, seen, MIDDLE_PX, CAMERA, flat=flat) is None
    assert sight(learned[:3], seen[:3], MIDDLE_PX, CAMERA, flat=flat) is None
    assert sight(learned[:0], seen[:0], MIDDLE_PX, CAMERA, flat=flat) is None
