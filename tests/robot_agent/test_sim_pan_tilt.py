"""The simulated pan-tilt: the picture moves as a pinhole says, the truth stays the body's, servos slew and lag."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from protocol import PanTiltLimits
from robot_agent.pantilt.sim import SimPanTilt
from robot_agent.pantilt.slew import PI_PAN
from robot_agent.sim.faults import Faults
from robot_agent.sim.world import World

SILENT = Faults(noise_sigma=0.0)


def world(scenario: str = "plain", **more) -> World:
    return World(scenario=scenario, seed=2, width=320, height=240, faults=SILENT, pan_tilt=PI_PAN, **more)


def settled(simulated: World, pan_rad: float, tilt_rad: float = 0.0):
    """The frame when the camera has come to rest there."""
    simulated.look(pan_rad, tilt_rad)
    simulated.advance(1.0)
    return simulated.capture()


def cam_from_mount(pan_rad: float, tilt_rad: float) -> np.ndarray:
    """Rotation from the camera that looks straight ahead (x right, y down, z ahead) to the one that was turned."""
    c, s = math.cos(pan_rad), math.sin(pan_rad)
    panned = np.array([(c, 0, s), (0, 1, 0), (-s, 0, c)])  # to the left: what was ahead is to the right
    c, s = math.cos(tilt_rad), math.sin(tilt_rad)
    return np.array([(1, 0, 0), (0, c, s), (0, -s, c)]) @ panned  # up: what was ahead is below


@pytest.fixture(scope="module")
def room() -> World:
    return world("turn")


@pytest.mark.parametrize("degrees", [(-20.0, 0.0), (9.0, 0.0), (0.0, 12.0), (0.0, -12.0), (15.0, -10.0)], ids=str)
def test_the_whole_picture_moves_as_the_pinhole_says(room, degrees):
    """A camera that only turns: its pictures differ by the homography K R K^-1, whatever is in them. The other way
    round, and with the axes swapped, they do not fit."""
    pan_rad, tilt_rad = np.radians(degrees)
    ahead, turned = settled(room, 0.0).image, settled(room, pan_rad, tilt_rad).image
    lens = room.intrinsics
    k = np.array([(lens.fx, 0, lens.cx), (0, lens.fy, lens.cy), (0, 0, 1)])

    def misfit(rotation: np.ndarray) -> float:
        """Mean difference (gray levels) where both pictures show the same."""
        homography = k @ rotation @ np.linalg.inv(k)
        expected = cv2.warpPerspective(ahead, homography, (320, 240))
        shared = cv2.warpPerspective(np.full_like(ahead, 255), homography, (320, 240)) == 255
        assert shared.mean() > 0.3
        return float(np.abs(expected.astype(int) - turned)[shared].mean())

    right = misfit(cam_from_mount(pan_rad, tilt_rad))
    assert right < 4.0
    assert misfit(cam_from_mount(-pan_rad, -tilt_rad)) > 4 * right
    assert misfit(cam_from_mount(tilt_rad, pan_rad)) > 4 * right


def test_the_true_bearing_is_the_body_s_wherever_the_camera_looks():
    simulated = world()
    simulated.set_wheels(-20, 20)
    simulated.start()
    simulated.advance(0.3)
    simulated.set_wheels(0, 0)
    simulated.advance(0.3)
    ahead = settled(simulated, 0.0).truth
    assert ahead.bearing_rad < -0.03
    for pan_rad, in_view in ((0.3, True), (-0.3, True), (1.2, False)):
        truth = settled(simulated, pan_rad, 0.05).truth
        travelled_rad = math.remainder(truth.robot[2] - ahead.robot[2], 2 * math.pi)
        expected_rad = math.atan2(truth.target[1] - truth.robot[1], truth.target[0] - truth.robot[0]) - truth.robot[2]
        assert abs(travelled_rad) < 1e-3
        assert truth.bearing_rad == pytest.approx(math.remainder(expected_rad, 2 * math.pi), abs=2e-3)
        assert truth.in_view == in_view


def test_in_turn_too_the_truth_is_the_body_s(room):
    assert settled(room, 0.5).truth.bearing_rad == pytest.approx(settled(room, 0.0).truth.bearing_rad, abs=1e-4)


def test_with_the_camera_ahead_the_picture_is_the_fixed_camera_s():
    fixed = World(scenario="turn", seed=2, width=320, height=240, faults=SILENT)
    difference = fixed.capture().image.astype(int) - world("turn").capture().image
    assert np.mean(np.abs(difference)) < 0.5


def test_the_camera_turns_at_the_slew_rate_with_the_servos_lag_which_the_estimate_knows():
    slow = PanTiltLimits(pan_rad=(-1.5, 1.5), tilt_rad=(-0.9, 0.9), slew_rad_s=1.0)
    simulated = World(scenario="plain", seed=2, width=64, height=48, faults=SILENT, pan_tilt=slow)
    head = SimPanTilt(simulated)
    joint = simulated._engine._data.joint("pan")
    begin_s = simulated.time_s
    head.look(0.5, 0.0)
    errors = []
    for _ in range(60):
        simulated.advance(0.01)
        errors.append(float(joint.qpos[0]) - head.angles_at(simulated.time_s)[0])
        if 0.2 < simulated.time_s - begin_s < 0.45:
            assert float(joint.qvel[0]) == pytest.approx(1.0, abs=0.02)
    assert float(joint.qpos[0]) == pytest.approx(0.5, abs=0.01)
    assert max(map(abs, errors)) < 0.015  # less than a degree at the start and the end of the ramp
    assert np.max(np.abs(errors[15:40])) < 0.003


def test_a_fixed_camera_cannot_be_turned():
    fixed = World(scenario="plain", seed=2, width=64, height=48, faults=SILENT)
    with pytest.raises(ValueError, match="fixed"):
        SimPanTilt(fixed)
    with pytest.raises(ValueError, match="fixed"):
        fixed.look(0.1, 0.0)
    assert fixed.looked_at(0.0) == (0.0, 0.0)
