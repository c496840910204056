"""The furnished room leaves the lap free, for every seed that is tried."""

import math

import numpy as np
import pytest

from robot_agent.sim.furnishing import CLEARANCE_M
from robot_agent.sim.scenarios import build_stage


@pytest.mark.parametrize("seed", range(6))
def test_the_lap_is_long_enough_and_free_of_furniture(seed):
    stage = build_stage("loop", seed)
    way = np.array(stage.course)
    length = np.linalg.norm(np.diff(np.vstack([way, way[:1]]), axis=0), axis=1)
    assert 5.95 <= length.sum() <= 7.5 and length.max() < 0.12
    assert way[0] == pytest.approx((0, 0), abs=1e-9) and abs(math.atan2(*(way[1] - way[0])[::-1])) < 0.15
    start = stage.robot_start
    on_floor = [block for block in stage.furniture if block.size_m[0] > 0.2]
    assert len(on_floor) >= 10 and len(stage.furniture) >= 26
    for block in on_floor:
        corners = [
            block.pose.moved(ahead_m=a * block.size_m[0] / 2, left_m=b * block.size_m[1] / 2)
            for a in (-1, 1)
            for b in (-1, 1)
        ]
        for ahead, left in stage.course:
            place = start.moved(ahead_m=ahead, left_m=left)
            assert all(math.dist((place.x_m, place.y_m), (c.x_m, c.y_m)) > CLEARANCE_M for c in corners)


def test_the_same_seed_furnishes_alike_and_another_differently():
    assert build_stage("loop", 3).furniture == build_stage("loop", 3).furniture != build_stage("loop", 4).furniture
