"""Boxes and results: what they mean, and what cannot be said with them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from base_station.types import Box, TrackerResult, TrackingState

MEASUREMENTS = {
    "shift_px": 1.0,
    "shift_y_px": 1.0,
    "bearing_rad": 0.1,
    "elevation_rad": 0.1,
    "zoom": 1.0,
    "box": Box(0, 0, 5, 5),
    "cam_from_world": np.eye(4),
}


def test_the_middle_of_a_box_is_that_of_its_pixels():
    assert Box(10, 20, 1, 1).center_px == (10, 20)
    assert Box(10, 20, 4, 3).center_px == (11.5, 21)


@pytest.mark.parametrize("size", [(1, 1), (4, 3), (10.5, 7.25)])
def test_around_is_the_inverse_of_center(size):
    assert Box.around(31.5, -7.0, *size).center_px == pytest.approx((31.5, -7.0))
    assert (Box.around(31.5, -7.0, *size).width, Box.around(31.5, -7.0, *size).height) == size


@pytest.mark.parametrize(
    ("box", "inside"),
    [
        (Box(10, 20, 30, 40), Box(10, 20, 30, 40)),
        (Box(-10, -5, 30, 40), Box(0, 0, 20, 35)),
        (Box(90, 70, 30, 40), Box(90, 70, 10, 10)),
        (Box(-10, -10, 500, 500), Box(0, 0, 100, 80)),
        (Box(100, 0, 5, 5), None),
        (Box(0, -5, 5, 5), None),
        (Box(-50, 10, 20, 20), None),
    ],
)
def test_clipping_leaves_what_is_inside_of_the_frame(box, inside):
    assert box.clipped(100, 80) == inside


@pytest.mark.parametrize(
    "sides", [(0, 0, 0, 5), (0, 0, 5, 0), (0, 0, -1, 5), (math.nan, 0, 5, 5), (0, math.inf, 5, 5), (0, 0, math.inf, 5)]
)
def test_what_has_no_area_or_no_place_is_no_box(sides):
    with pytest.raises(ValueError, match="not a box"):
        Box(*sides)


@pytest.mark.parametrize("state", [TrackingState.LOST, TrackingState.INITIALIZING])
@pytest.mark.parametrize("name", MEASUREMENTS)
def test_only_while_tracking_may_a_result_carry_a_measurement(state, name):
    with pytest.raises(ValueError, match=f"in state {state.value} carries a measurement"):
        TrackerResult(state=state, reason="gone", **{name: MEASUREMENTS[name]})


@pytest.mark.parametrize("name", MEASUREMENTS)
def test_while_tracking_each_measurement_may_be_there_alone(name):
    result = TrackerResult(state=TrackingState.TRACKING, **{name: MEASUREMENTS[name]})
    assert getattr(result, name) is MEASUREMENTS[name]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["shift_px", "shift_y_px", "bearing_rad", "elevation_rad", "zoom"])
def test_a_measurement_that_is_no_number_is_refused_because_a_robot_would_drive_by_it(name, bad):
    with pytest.raises(ValueError, match=f"{name} is"):
        TrackerResult(state=TrackingState.TRACKING, **{name: bad})


@pytest.mark.parametrize("zoom", [0.0, -1.0])
def test_zoom_is_positive(zoom):
    with pytest.raises(ValueError, match="must be positive"):
        TrackerResult(state=TrackingState.TRACKING, zoom=zoom)


@pytest.mark.parametrize("state", [TrackingState.LOST, TrackingState.INITIALIZING])
def test_not_tracking_needs_a_reason(state):
    with pytest.raises(ValueError, match="must give its reason"):
        TrackerResult(state=state)
    assert TrackerResult(state=state, reason="the lamp is off").reason == "the lamp is off"
