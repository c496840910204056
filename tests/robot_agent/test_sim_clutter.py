"""The cluttered room: pictures like the target beside it, boards that move behind it, and nothing before it."""

import math

import cv2
import numpy as np
import pytest

from robot_agent.sim.clutter import BOARDS, exchanged, mirrored
from robot_agent.sim.courses import ROOM_HALF_SIZE_M
from robot_agent.sim.model import WALL_HEIGHT_M
from robot_agent.sim.scenarios import LEADER_PICTURE_BEHIND_M, build_stage
from robot_agent.sim.world import World

WIDTH, HEIGHT = 320, 240


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.corrcoef(one.ravel().astype(float), other.ravel().astype(float))[0, 1])


def test_look_alikes_are_the_picture_s_own_parts_in_other_places():
    picture = np.arange(64, dtype=np.uint8).reshape(8, 8)
    assert (mirrored(picture)[:, ::-1] == picture).all()
    quarters = exchanged(picture)
    assert (quarters[:4, :4] == picture[4:, 4:]).all() and (quarters[4:, :4] == picture[:4, 4:]).all()
    assert (exchanged(exchanged(picture)) == picture).all()


def best_match(image: np.ndarray, template: np.ndarray) -> tuple[float, tuple[int, int]]:
    """Normalised correlation where it is highest, and column and row there."""
    _, height, _, place = cv2.minMaxLoc(cv2.matchTemplate(image, template, cv2.TM_CCOEFF_NORMED))
    return height, place


@pytest.mark.parametrize("seed", range(6))
def test_boards_stay_in_the_room_and_off_the_leader_s_way(seed):
    stage = build_stage("clutter", seed)
    assert len(stage.clutter.boards) == BOARDS
    for time_s in np.arange(0, 120, 1.7):
        leader = stage.leader(time_s)
        for board in stage.clutter.boards:
            pose = board.pose(time_s)
            ends = [pose.moved(ahead_m=side * board.width_m / 2) for side in (-1, 1)]
            assert all(max(abs(end.x_m), abs(end.y_m)) < ROOM_HALF_SIZE_M - 0.05 for end in ends)
            away_m = math.dist((pose.x_m, pose.y_m), (leader.x_m, leader.y_m)) - board.width_m / 2
            assert away_m > 0.12, "nearer than its outermost picture may come"
            assert board.height_m < WALL_HEIGHT_M
    speeds = [math.dist(_at(board, 0), _at(board, 0.5)) / 0.5 for board in stage.clutter.boards]
    assert min(speeds) > 0.08 and max(speeds) < 0.5


def _at(board, time_s):
    pose = board.pose(time_s)
    return pose.x_m, pose.y_m


def test_the_target_stays_in_view_among_its_likes_and_only_the_background_moves():
    """A robot set down behind the standing leader sees the same target every time; behind it boards come and go, and
    beside it the mirrored picture stands, as far from it as the leader carries it."""
    simulated = World(scenario="clutter", seed=1, width=WIDTH, height=HEIGHT)
    first = simulated.capture()
    x, y, width, height = (round(side) for side in simulated.scenario.events[0].box)
    target = first.image[y : y + height, x : x + width]
    halves = mirrored(target)[:, : width // 2], mirrored(target)[:, width - width // 2 :]
    alike, (beside, below) = max(best_match(first.image, half) for half in halves)  # the frame cuts the outer one off
    assert alike > 0.8 and abs(below - y) <= 2 and abs(beside - x) > width / 2, "no mirrored picture beside it"
    smaller = cv2.resize(target, None, fx=0.62, fy=0.62, interpolation=cv2.INTER_AREA)
    assert best_match(first.image[:y], smaller)[0] > 0.6, "no smaller one above it"
    simulated.start()
    for _ in range(12):
        simulated.advance(1.0)
        leader = simulated._stage.leader(simulated.time_s)
        simulated._engine.place_robot(leader.moved(ahead_m=-LEADER_PICTURE_BEHIND_M - 0.40))
        frame = simulated.capture()
        assert frame.truth.in_view
        assert correlation(frame.image[y : y + height, x : x + width], target) > 0.98
    assert correlation(frame.image[:y], first.image[:y]) < 0.9, "the background stands"
