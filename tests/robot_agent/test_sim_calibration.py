"""The simulated calibration board: still in every pose, in view from the first frame on, the same for the same seed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from robot_agent.sim.calibration_board import HOLD_S, MOVE_S, SHEET_M, draw_showing
from robot_agent.sim.textures import calibration_sheet
from robot_agent.sim.world import World


def test_it_is_held_still_then_moved_smoothly():
    showing = draw_showing(np.random.default_rng(0))
    count = len(showing.positions_m)
    period_s = HOLD_S + MOVE_S
    for number in (0, 1, count - 1, count):
        begin = number * period_s
        held = showing.at(begin + 1e-9)
        assert held.position_m == showing.at(begin + HOLD_S - 1e-6).position_m
        assert np.linalg.norm(held.quaternion) == pytest.approx(1.0)
        after = showing.at(begin + period_s - 1e-6)
        assert after.position_m == pytest.approx(showing.at(begin + period_s + 1e-6).position_m, abs=1e-6)
    assert showing.at(0.1) == showing.at(count * period_s + 0.1), "it begins anew"


def test_every_pose_is_tilted_and_above_the_floor():
    showing = draw_showing(np.random.default_rng(3))
    for w, x, y, z in showing.quaternions:
        face = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        assert 0.8 < -face[0] < 0.95  # of its face's direction, towards the camera
    assert showing.positions_m[:, 2].min() > 0.02
    assert 0.15 < showing.positions_m[:, 0].min() < showing.positions_m[:, 0].max() < 0.3


def test_the_camera_sees_the_board():
    """Its markers are found, not mirrored, in the first frame; one seed gives one picture."""
    pictures = []
    for _ in range(2):
        world = World(scenario="calibration", seed=0)
        world.start()
        frame = world.capture()
        world.close()
        assert frame is not None
        pictures.append(frame.image)
    assert (pictures[0] == pictures[1]).all()
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    _, ids, _ = cv2.aruco.ArucoDetector(markers).detectMarkers(pictures[0])
    assert ids is not None and set(ids.ravel()) <= set(range(17)) and len(ids) > 5


def test_the_sheet_has_the_boards_measures():
    sheet = calibration_sheet()
    assert sheet.shape[1] / sheet.shape[0] == pytest.approx(SHEET_M[0] / SHEET_M[1])
    assert set(np.unique(sheet)) == {14, 241}
