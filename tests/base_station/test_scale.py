"""Metres from one known length."""

from __future__ import annotations

import math

import pytest

from base_station.geometry import PinholeCamera
from base_station.scale import Scale, scale_from_distance, scale_from_width
from base_station.types import Box, TrackerResult, TrackingState

CAMERA = PinholeCamera.with_fov(640, 480)


def seen(point: tuple[float, float, float], learned_depth_m: float) -> TrackerResult:
    """The result of a perfect tracker for a target at x right, y down, z ahead."""
    x, y, z = point
    return TrackerResult(
        state=TrackingState.TRACKING,
        bearing_rad=math.atan2(-x, z),
        elevation_rad=math.atan2(-y, z),
        zoom=learned_depth_m / z,
    )


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.5), (0.3, -0.1, 1.2), (-0.2, 0.2, 0.25)])
def test_the_range_is_the_distance_to_the_targets_middle(point):
    result = Scale(learned_depth_m=0.5).measured(seen(point, 0.5))
    assert result.range_m == pytest.approx(math.hypot(*point))


def test_a_known_width_gives_the_learned_depth():
    box = Box.around(400, 200, CAMERA.fx * 0.2 / 0.5, 50)
    assert scale_from_width(0.2, box, CAMERA).learned_depth_m == pytest.approx(0.5)


def test_a_known_distance_gives_the_depth_along_the_axis():
    point = (0.2, 0.1, 0.6)
    x, y = CAMERA.cx + CAMERA.fx * point[0] / point[2], CAMERA.cy + CAMERA.fy * point[1] / point[2]
    scale = scale_from_distance(math.hypot(*point), Box.around(x, y, 40, 40), CAMERA)
    assert scale.learned_depth_m == pytest.approx(point[2])
    assert scale_from_distance(0.7, None, CAMERA).learned_depth_m == 0.7


def test_what_cannot_be_told_stays_as_it_is():
    scale = Scale(learned_depth_m=1.0)
    for result in (
        TrackerResult(state=TrackingState.LOST, reason="gone"),
        TrackerResult(state=TrackingState.TRACKING, bearing_rad=0.1),
        TrackerResult(state=TrackingState.TRACKING, zoom=1.0),
        TrackerResult(state=TrackingState.TRACKING, zoom=1.0, bearing_rad=0.0, range_m=9.0),
    ):
        assert scale.measured(result) is result
