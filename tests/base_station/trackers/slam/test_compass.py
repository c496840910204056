"""The Z compass in a rendered room: it keeps the heading through a turn that no view spans, and says when it cannot."""

from __future__ import annotations

import math

import numpy as np
import pytest

from base_station.geometry import PinholeCamera
from base_station.trackers.slam.compass import ZCompass
from base_station.types import Frame
from tests.base_station.trackers.slam.room import Room, small_camera, standing

CAMERA = small_camera()
PINHOLE = PinholeCamera(width=320, height=240, fx=CAMERA.fx, fy=CAMERA.fy, cx=CAMERA.cx, cy=CAMERA.cy)
ROOM = Room(CAMERA)
STEP_RAD = math.radians(1.5)


def frame(number: int, turned_rad: float) -> Frame:
    """`turned_rad`: to the right."""
    image = ROOM.picture(standing(-0.6, -1.0, turned_rad))
    return Frame(image=image, number=number, time_s=number / 30, camera=PINHOLE)


def test_a_turn_wider_than_the_view_and_back_to_where_it_is_set_right():
    compass = ZCompass()
    compass.start(frame(0, 0.0), 0.0)
    kept = [compass.update(frame(k, k * STEP_RAD)) for k in range(1, 81)]
    errors = [math.degrees(heading - k * STEP_RAD) for k, heading in enumerate(kept, 1)]
    assert float(np.sqrt(np.mean(np.square(errors)))) < 1.0
    assert kept[-1] == pytest.approx(math.radians(120), abs=math.radians(1.5))
    again = frame(81, 80 * STEP_RAD)
    before = compass.update(again)
    compass.correct(again, before - 2.0, 2.0)
    assert compass.update(frame(82, 80 * STEP_RAD)) == pytest.approx(2.0, abs=math.radians(0.2))


def test_without_a_view_it_says_nothing_and_begins_again_where_it_is_told():
    compass = ZCompass()
    assert compass.update(frame(1, 0.0)) is None
    dark = Frame(image=np.zeros((240, 320), np.uint8), number=2, time_s=0.1, camera=PINHOLE)
    compass.start(dark, 0.0)
    assert compass.update(frame(3, 0.0)) is None
    compass.correct(frame(4, 0.3), None, -3.1)
    assert compass.update(dark) is None
    turned = compass.update(frame(6, 0.4))
    assert turned == pytest.approx(-3.0, abs=math.radians(0.5))
