"""What is asked of a camera is bounded before it reaches the camera's own library."""

from __future__ import annotations

import time

import pytest

from protocol import Request
from robot_agent.answers import LONGEST_EXPOSURE_US, Answers


class LiveCamera:
    """Takes down what exposures it is given."""

    def __init__(self) -> None:
        self.exposures_us: list[float] = []

    def set_exposure(self, exposure_us: float) -> None:
        self.exposures_us.append(exposure_us)


def answers(camera: object) -> Answers:
    """Of an agent of which only the camera is asked."""
    return Answers(
        camera, None, None, frames=None, rhythm="free", speed_scale=1.0, scenario=None, stamps=None, wheels=None,
        supervisor=None, frame_port=None, station=lambda: None, clock=time.monotonic,
    )  # fmt: skip


@pytest.mark.parametrize("exposure_us", [0.0, 8000.0, LONGEST_EXPOSURE_US])
def test_an_exposure_goes_to_the_camera(exposure_us):
    camera = LiveCamera()
    assert answers(camera).to(Request(action="exposure", value=exposure_us)).ok
    assert camera.exposures_us == [exposure_us]


@pytest.mark.parametrize("exposure_us", [-1.0, 2.0 * LONGEST_EXPOSURE_US, 1e300, float("nan"), float("inf")])
def test_an_impossible_exposure_does_not(exposure_us):
    camera = LiveCamera()
    reply = answers(camera).to(Request(action="exposure", value=exposure_us))
    assert not reply.ok and "0 (automatic) to 1000000 us" in reply.error
    assert camera.exposures_us == []


def test_a_camera_that_cannot_says_so():
    reply = answers(object()).to(Request(action="exposure", value=1000.0))
    assert not reply.ok and "cannot be set" in reply.error
