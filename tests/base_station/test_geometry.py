"""Pixels and directions: which way is positive, and that both ways agree."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest

from base_station.geometry import DEFAULT_FOV_RAD, PinholeCamera

CAMERA = PinholeCamera(width=640, height=480, fx=500.0, fy=400.0, cx=319.5, cy=239.5)


def test_the_middle_of_the_picture_is_straight_ahead():
    assert CAMERA.bearing_rad(319.5) == 0.0
    assert CAMERA.elevation_rad(239.5) == 0.0


def test_left_and_up_are_positive():
    assert CAMERA.bearing_rad(0) > 0 > CAMERA.bearing_rad(639)
    assert CAMERA.elevation_rad(0) > 0 > CAMERA.elevation_rad(479)


@pytest.mark.parametrize("angle_rad", [-0.5, -0.01, 0.2, 0.7])
def test_a_pixel_at_focal_length_times_tangent_lies_at_that_angle(angle_rad):
    assert CAMERA.bearing_rad(319.5 - 500 * math.tan(angle_rad)) == pytest.approx(angle_rad, abs=1e-12)
    assert CAMERA.elevation_rad(239.5 - 400 * math.tan(angle_rad)) == pytest.approx(angle_rad, abs=1e-12)


def test_a_camera_known_by_its_field_of_view_sees_exactly_that_between_its_outer_edges():
    camera = PinholeCamera.with_fov(640, 480)
    edges = camera.bearing_rad(-0.5) - camera.bearing_rad(639.5)
    assert edges == pytest.approx(DEFAULT_FOV_RAD, abs=1e-12)
    assert math.degrees(edges) == pytest.approx(62.2)
    assert math.degrees(camera.elevation_rad(-0.5) - camera.elevation_rad(479.5)) == pytest.approx(48.7, abs=0.1)


def test_pixels_are_square_and_the_axis_goes_through_the_middle():
    camera = PinholeCamera.with_fov(320, 240, math.radians(90))
    assert camera.fx == camera.fy == pytest.approx(160.0)
    assert (camera.cx, camera.cy) == (159.5, 119.5)


def test_a_row_has_the_same_elevation_in_a_band_as_in_the_whole_picture():
    whole = PinholeCamera.with_fov(640, 480)
    band = PinholeCamera.with_fov(640, 64, first_row=200, full_height=480)
    for row in (0, 10.5, 63):
        assert band.elevation_rad(row) == whole.elevation_rad(200 + row)
        assert band.bearing_rad(row) == whole.bearing_rad(row)


@pytest.mark.parametrize("distortion", [(-0.28, 0.09, 0.001, -0.0008), (0.12, -0.05, 0.0, 0.002, 0.01)])
def test_a_calibrated_lens_bends_directions(distortion):
    """As OpenCV has it: what an ideal pinhole sees in a direction, the lens shows elsewhere."""
    camera = dataclasses.replace(CAMERA, distortion=distortion)
    for angle_rad in (-0.5, -0.2, 0.0, 0.1, 0.5):
        for ray, pixel in (((-math.tan(angle_rad), 0, 1), 0), ((0, -math.tan(angle_rad), 1), 1)):
            matrix = np.array([[500.0, 0, 319.5], [0, 400.0, 239.5], [0, 0, 1]])
            seen, _ = cv2.projectPoints(np.array([ray]), np.zeros(3), np.zeros(3), matrix, np.array(distortion))
            found = (camera.bearing_rad, camera.elevation_rad)[pixel](float(seen[0, 0, pixel]))
            assert found == pytest.approx(angle_rad, abs=1e-6)
