"""The viewing angle of a flat upright target: exact on exact outlines, fair on noisy ones, right in pictures."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from base_station.trackers.ztransform.tracker import ZTransformTracker
from base_station.trackers.ztransform.viewing import view_angle_rad
from base_station.types import Box, TrackingState

FOCAL_PX, CX, CY = 530.0, 319.5, 239.5
LENS = np.array([0.0, FOCAL_PX, CX, CY])
LEARNED_M, SIDE_M, HEIGHT_M = 0.5, 0.2, 0.02
"""A square target, learned squarely and straight ahead; its middle is so far above the camera."""


def plane_in_camera(range_m: float, angle_rad: float, bearing_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """The target's middle and its rightward axis, in camera coordinates (x right, z ahead)."""
    middle = range_m * np.array([-math.sin(bearing_rad), math.cos(bearing_rad)])
    turn = angle_rad - bearing_rad  # of the camera's heading, to the left, against the way one looks at it squarely
    return middle, np.array([math.cos(turn), -math.sin(-turn) * -1.0])


def placement(range_m: float, angle_rad: float, bearing_rad: float) -> np.ndarray:
    """What the tracker's placement is in this view: from the pinhole projection of three points."""
    middle, right = plane_in_camera(range_m, angle_rad, bearing_rad)

    def column(u: float) -> tuple[float, float]:
        x, z = middle + u * SIDE_M * right
        return CX + FOCAL_PX * x / z, z

    (x0, z0), (x1, z1), (x2, _) = column(0.0), column(0.5), column(-0.5)
    keystone = 2 * (z1 / z0 - 1)
    width = (x1 - x0) * (1 + keystone / 2) / 0.5
    assert x0 - 0.5 * width / (1 - keystone / 2) == pytest.approx(x2, abs=1e-6), "the model is exact"
    return np.array([x0, CY - FOCAL_PX * HEIGHT_M / z0, width, FOCAL_PX * SIDE_M / z0, keystone])


LEARNED = placement(LEARNED_M, 0.0, 0.0)


@pytest.mark.parametrize("range_m", [0.4, 0.5, 1.0])
@pytest.mark.parametrize("bearing_deg", [-20, 0, 15])
@pytest.mark.parametrize("angle_deg", [-50, -20, -3, 0, 1, 10, 35, 50])
def test_exact_outlines_give_the_exact_angle(range_m, bearing_deg, angle_deg):
    view = placement(range_m, math.radians(angle_deg), math.radians(bearing_deg))
    assert math.degrees(view_angle_rad(view, LEARNED, LENS)) == pytest.approx(angle_deg, abs=0.02)


@pytest.mark.parametrize("angle_deg", [-25, 0, 8, 25])
def test_noisy_outlines_give_it_to_a_degree(angle_deg):
    rng = np.random.default_rng(0)
    view = placement(0.7, math.radians(angle_deg), math.radians(5))
    errors = []
    for _ in range(200):
        noisy = view.copy()
        noisy[2:4] *= np.exp(rng.normal(0, 0.003, 2))
        noisy[4] += rng.normal(0, 0.005)
        errors.append(math.degrees(view_angle_rad(noisy, LEARNED, LENS)) - angle_deg)
    assert np.std(errors) < 1.3
    assert abs(np.mean(errors)) < 0.4


def test_outlines_that_no_plane_has_stay_within_bounds():
    for keystone, aspect in ((5.0, 1.0), (-5.0, 1.0), (0.0, 3.0), (0.0, 0.01), (0.4, 1.3)):
        view = LEARNED.copy()
        view[2] *= aspect
        view[4] = keystone
        assert abs(view_angle_rad(view, LEARNED, LENS)) <= math.radians(75.1)


def test_the_tracker_tells_the_angle_of_a_picture_it_sees_aslant(world):
    """Rendered by homography: the world's picture on an upright plane that is walked around."""
    camera, tracker = world.camera, ZTransformTracker()
    lens = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    square = world.view()
    tracker.learn(world.frame(square), Box.around(319.5, 239.5, 200, 200))
    for number in range(2, 28):
        angle_rad = math.radians(min(number - 2, 20))
        c, s = math.cos(angle_rad), math.sin(angle_rad)
        turned = np.array([[c, 0, 0], [0, 1, 0], [s, 0, 1]])  # plane coordinates (X, Y, 1 ahead) to camera coordinates
        homography = lens @ turned @ np.linalg.inv(lens)
        image = cv2.warpPerspective(square, homography, (640, 480), flags=cv2.INTER_CUBIC)
        result = tracker.update(world.frame(image, number))
        assert result.state is TrackingState.TRACKING
        assert result.view_angle_rad is not None
        assert abs(result.view_angle_rad) == pytest.approx(angle_rad, abs=math.radians(1.5))
        if number > 6:
            assert result.view_angle_rad < 0, "the right side is farther: the camera stands to the left"


def test_a_place_has_no_angle(world):
    tracker = ZTransformTracker()
    tracker.learn(world.frame(world.view()), None)
    assert tracker.update(world.frame(world.view(3), 2)).view_angle_rad is None
