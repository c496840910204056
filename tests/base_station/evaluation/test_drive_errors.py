"""The trajectory's error against the simulator's truth."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from base_station.evaluation.drive_errors import mapped, world_from_camera
from base_station.trackers.base import Survey
from protocol import Truth

TRUTHS = [
    (k / 10, Truth(robot=(math.cos(a), math.sin(a), a + math.pi / 2))) for k, a in enumerate(np.arange(0, 6, 0.1))
]


def survey(noise_m: float) -> Survey:
    """The drive as a monocular map has it: at half its size, elsewhere; each pose aside by the noise, in turn left and
    right."""
    world_from_true = np.array([[0, -0.5, 0, 3], [0, 0, -0.5, 1], [0.5, 0, 0, 2], [0, 0, 0, 1.0]])
    poses = []
    for k, (time_s, truth) in enumerate(TRUTHS[:50]):
        true = world_from_camera(truth)
        true[2, 3] += noise_m * (-1) ** k
        pose = world_from_true @ true
        pose[:3, :3] *= 2
        poses.append((time_s, pose))
    return Survey(
        trajectory=poses, loops=2, keyframes=9, maps=1, confirmed=1, loop_times_s=(TRUTHS[9][0], TRUTHS[30][0])
    )


@pytest.mark.parametrize("noise_m", [0.0, 0.02])
def test_what_no_similarity_explains_is_the_error(noise_m):
    told = mapped(survey(noise_m), TRUTHS, 5.0)
    assert told["ate_rmse_m"] == pytest.approx(noise_m, abs=1e-3)
    assert told["ate_share_of_path"] == pytest.approx(noise_m / 5, abs=2e-4)
    assert (told["loops_closed"], told["loops_confirmed"], told["keyframes"], told["maps"]) == (2, 1, 9, 1)
    driven_m = [
        sum(math.dist(one.robot[:2], two.robot[:2]) for (_, one), (_, two) in pairwise(TRUTHS[: k + 1]))
        for k in (9, 30)
    ]
    assert told["loops_at_m"] == pytest.approx(driven_m, abs=2e-3) and driven_m[0] > 0
    assert told["trajectory_share"] == pytest.approx(50 / 60, abs=1e-5)


def test_the_camera_looks_where_the_robot_drives_with_its_top_up():
    pose = world_from_camera(Truth(robot=(1.0, 2.0, math.pi / 2)))
    assert pose[:3, 2] == pytest.approx([0, 1, 0]) and pose[:3, 1] == pytest.approx([0, 0, -1])
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


def test_without_a_map_there_is_nothing_to_tell():
    assert set(mapped(None, TRUTHS, 5.0).values()) == {None}
    empty = mapped(Survey(trajectory=[], loops=0, keyframes=0, maps=0), TRUTHS, 5.0)
    assert empty["ate_rmse_m"] is None and empty["trajectory_share"] == 0
