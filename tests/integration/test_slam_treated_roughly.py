"""SLAM in the simulated room, treated roughly: found again soon, and never told a pose that is far from the truth."""

from __future__ import annotations

import math

import pytest

from base_station.trackers.slam.camera import SlamCamera
from base_station.types import TrackingState
from robot_agent.sim.free_camera import FreeCamera

pytest.importorskip("pycolmap")
pytest.importorskip("gtsam")


def test_kidnapped_in_the_dark_before_a_wall_and_spun() -> None:
    from base_station.evaluation.slam.robustness import Treatments, TrueRoom
    from base_station.trackers.slam.system import SlamSystem

    camera = FreeCamera(seed=0)
    assert camera.lap is not None
    room = TrueRoom(view=camera.view, way=camera.on_lap, length_m=camera.lap.length_m)
    lens = camera.intrinsics
    pinhole = SlamCamera(width_px=640, height_px=480, fx=lens.fx, fy=lens.fy, cx=lens.cx, cy=lens.cy)
    try:
        with SlamSystem(pinhole, single_process=True) as slam:
            treat = Treatments(room, slam)
            assert 1e-4 < treat.lap() < 0.03
            treat.kidnap(4.6, left_m=0.1)
            treat.unseen(1.9)
            treat.kidnap(2.7, turned_rad=math.radians(15))
            treat.darken(3.3)
            treat.before_a_wall(5.2)
            treat.spin(0.4)
            found = treat.figures()
    finally:
        camera.close()
    assert set(treat.found_after) >= {"kidnapped", "dark", "light again", "after the wall", "after the spin"}
    assert found["found_after_frames_max"] <= 10
    assert found["wild"] == 0
    assert found["error_m_max"] <= 0.10 and found["error_deg_max"] <= 5.0
    assert found["told"] > 130
    covered = [one.state for one in treat.seen if one.treatment in ("covered", "bare wall")]
    assert len(covered) == 3 * 30 + 15
    assert TrackingState.TRACKING not in covered
