"""The motion between two pictures from epipolar lines: with noise, with strays, and from a wrong start."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from base_station.trackers.slam.epipolar_fit import epipolar_residuals, fitted_motions
from base_station.trackers.slam.se3 import pose_of

CAMERA = np.array([[360.0, 0.0, 310.0], [0.0, 360.0, 94.0], [0.0, 0.0, 1.0]])


def a_drive(rng: np.random.Generator, noise_px: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ahead past near and far things; the last tenth of the matches are strays. True motion, and both pictures' px."""
    ahead = np.array([0.05, -0.02, -1.0])
    truth = pose_of(cv2.Rodrigues(np.array([0.002, 0.01, -0.003]))[0], ahead)
    depth = rng.uniform(6.0, 60.0, 300)
    one_px = rng.uniform((10, 10), (610, 178), (300, 2))
    rays = np.column_stack([one_px, np.ones(300)]) @ np.linalg.inv(CAMERA).T
    seen = (rays * depth[:, None]) @ truth[:3, :3].T + truth[:3, 3]
    two_px = (seen / seen[:, 2:]) @ CAMERA.T
    two_px = two_px[:, :2] + rng.normal(0.0, noise_px, (300, 2))
    two_px[270:] += rng.uniform(-30, 30, (30, 2))
    return truth, one_px, two_px


def off_deg(motion: np.ndarray, truth: np.ndarray) -> float:
    """Between the directions, of either sign."""
    along = truth[:3, 3] / np.linalg.norm(truth[:3, 3])
    return math.degrees(math.acos(min(1.0, abs(float(motion[:3, 3] @ along)))))


@pytest.mark.parametrize(("noise_px", "most_deg"), [(0.0, 0.2), (0.3, 1.5)])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_ahead_is_found_from_a_step_aside(seed, noise_px, most_deg):
    truth, one_px, two_px = a_drive(np.random.default_rng(seed), noise_px)
    wrong = pose_of(cv2.Rodrigues(np.array([0.0, 0.03, 0.0]))[0] @ truth[:3, :3], np.array([1.0, 0.0, 0.2]))
    found = fitted_motions(wrong, truth[:3, :3], one_px, two_px, CAMERA, np.ones(300))
    rays = [np.column_stack([px, np.ones(300)]) @ np.linalg.inv(CAMERA).T for px in (one_px, two_px)]
    exactness = [float(np.median(np.abs(epipolar_residuals(motion, *rays)))) for motion in found]
    best = found[int(np.argmin(exactness))]
    assert np.linalg.norm(best[:3, 3]) == pytest.approx(1.0)
    assert off_deg(best, truth) < most_deg
