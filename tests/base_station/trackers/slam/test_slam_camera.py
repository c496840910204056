"""The SLAM camera: distortion is undone exactly, and what is no camera is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from base_station.trackers.slam.camera import SlamCamera

EUROC = {"width_px": 752, "height_px": 480, "fx": 458.654, "fy": 457.296, "cx": 367.215, "cy": 248.375}


FREIBURG = {"width_px": 640, "height_px": 480, "fx": 517.3, "fy": 516.5, "cx": 318.6, "cy": 255.3}


@pytest.mark.parametrize(
    ("camera", "distortion"),
    [
        (EUROC, (-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05)),
        (FREIBURG, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
        (FREIBURG, ()),
    ],
)
def test_undistorting_undoes_distorting_to_the_border(camera, distortion):
    camera = SlamCamera(**camera, distortion=distortion)
    columns, rows = np.meshgrid(np.linspace(20, camera.width_px - 20, 12), np.linspace(20, 460, 9))
    ideal = np.column_stack([columns.ravel(), rows.ravel()])
    seen = camera.distort(ideal)
    assert np.abs(camera.undistort(seen) - ideal).max() < 0.001
    assert (np.abs(seen - ideal).max() > 5) == bool(distortion)


def test_bounds_hold_every_undistorted_pixel():
    camera = SlamCamera(**EUROC, distortion=(-0.28, 0.07, 0.0, 0.0))
    left, top, right, bottom = camera.bounds_px
    corners = camera.undistort(np.array([[0, 0], [751, 0], [0, 479], [751, 479]], np.float32))
    assert left <= corners[:, 0].min() < 0
    assert top <= corners[:, 1].min() < 0
    assert right >= corners[:, 0].max() > 751
    assert bottom >= corners[:, 1].max() > 479


def test_without_calibration_it_has_the_field_of_view_that_is_stated():
    camera = SlamCamera.with_fov(640, 480)
    assert math.degrees(2 * math.atan(320 / camera.fx)) == pytest.approx(62.2, abs=0.01)
    assert (camera.cx, camera.cy) == (319.5, 239.5)
    assert not camera.distorts


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"fx": 0.0}, "positive"),
        ({"fx": math.nan}, "finite"),
        ({"cx": 900.0}, "outside"),
        ({"width_px": 10}, "64 px"),
        ({"distortion": (0.1, 0.2)}, "2 numbers"),
        ({"distortion": (math.inf, 0.0, 0.0, 0.0)}, "finite"),
    ],
)
def test_what_is_no_camera_is_refused(change, said):
    with pytest.raises(ValueError, match=said):
        SlamCamera(**(EUROC | change))
