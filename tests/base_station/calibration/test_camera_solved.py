"""The camera is recovered from its views, bad views are left out, and what is doubtful is said."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from base_station.calibration.board import CalibrationBoard
from base_station.calibration.detection import BoardFinder
from base_station.calibration.solving import calibrate
from base_station.errors import StationError
from tests.base_station.calibration.boards import DISTORTION, MATRIX, SIZE, drawn_pose, drawn_view, picture

BOARD = CalibrationBoard()
TRUE = (MATRIX[0, 0], MATRIX[1, 1], MATRIX[0, 2], MATRIX[1, 2])


def views(count: int, noise_px: float, seed: int = 0):
    rng = np.random.default_rng(seed)
    return [drawn_view(rng, BOARD, noise_px=noise_px) for _ in range(count)]


def numbers(found) -> tuple[float, ...]:
    own = found.file.intrinsics
    return own.fx, own.fy, own.cx, own.cy


@pytest.mark.parametrize(("noise_px", "within"), [(0.0, 1e-4), (0.03, 0.005)])
def test_the_camera_is_recovered(noise_px, within):
    """Exactly without noise, within 0.5 % with a little; the standard deviations tell how well."""
    found = calibrate(views(25, noise_px))
    assert numbers(found) == pytest.approx(TRUE, rel=within)
    assert found.file.intrinsics.distortion == pytest.approx(tuple(DISTORTION), abs=max(20 * within * 0.05, 1e-3))
    assert found.rms_px == pytest.approx(noise_px * math.sqrt(2), rel=0.15, abs=2e-3)
    assert found.file.size == SIZE and found.left_out == () and found.warnings() == []
    if noise_px:
        for value, true, name in zip(numbers(found), TRUE, ("fx", "fy", "cx", "cy"), strict=True):
            assert abs(value - true) < 4 * found.deviations[name] < 4 * 0.01 * true


def test_the_third_radial_coefficient_is_an_option():
    assert len(calibrate(views(12, 0.0)).file.intrinsics.distortion) == 4
    found = calibrate(views(25, 0.0), k3=True)
    assert len(found.file.intrinsics.distortion) == 5 and "k3" in found.deviations
    assert found.file.intrinsics.distortion[4] == pytest.approx(0.0, abs=0.01)


def test_views_that_fit_badly_are_left_out():
    """Two of twenty were taken in motion: the corners of one side are 3 px off."""
    good = views(20, 0.03)
    for number in (4, 13):
        points = good[number].points_px.copy()
        points[: len(points) // 2, 0] += 3.0
        good[number] = dataclasses.replace(good[number], points_px=points)
    found = calibrate(good)
    assert found.left_out == (4, 13)
    assert numbers(found) == pytest.approx(TRUE, rel=0.005)
    assert len(found.errors_px) == 18 and max(found.errors_px) < 0.1


def test_the_field_of_view_is_that_of_the_lens():
    """With distortion, between the outer edges of the picture; an ideal lens's would be narrower (barrel)."""
    found = calibrate(views(25, 0.0))
    ideal = math.atan(322.5 / 530) + math.atan(317.5 / 530)
    assert found.fov_rad[0] > ideal + 0.03
    assert found.fov_rad[0] > found.fov_rad[1] > 0.8


def test_views_that_say_little_are_warned_of():
    """Never tilted: the focal length and the distance look alike."""
    rng = np.random.default_rng(0)
    flat = []
    while len(flat) < 8:
        view = drawn_view(rng, BOARD, noise_px=0.5)
        if max(map(abs, view.tilt_rad)) < 0.15:
            flat.append(view)
    found = calibrate(flat)
    assert any("tilt the board more" in text for text in found.warnings())


def test_too_few_views_and_two_sizes_are_errors():
    with pytest.raises(StationError, match="There are 4 views"):
        calibrate(views(4, 0.0))
    mixed = views(6, 0.0)
    mixed[0] = dataclasses.replace(mixed[0], size_px=(320, 240))
    with pytest.raises(StationError, match=r"320x240, 640x480"):
        calibrate(mixed)


def test_from_pictures_with_distortion():
    """Rendered through the lens, found, solved: within 0.5 %."""
    rng, finder, found = np.random.default_rng(3), BoardFinder(BOARD), []
    while len(found) < 16:
        view = finder.find(picture(BOARD, *drawn_pose(rng, BOARD)))
        if view is not None and len(view.ids) >= 12:
            found.append(view)
    camera = calibrate(found)
    assert numbers(camera) == pytest.approx(TRUE, rel=0.005)
    assert camera.file.intrinsics.distortion[0] == pytest.approx(DISTORTION[0], abs=0.02)
