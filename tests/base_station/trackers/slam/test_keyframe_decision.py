"""Which pictures become keyframes: by what they still see, and by how far the camera has come."""

from __future__ import annotations

import math

import numpy as np
import pytest

from base_station.trackers.slam.keyframe_decision import (
    ELSEWHERE,
    KeyframeSettings,
    Moved,
    moved_since,
    wants_keyframe,
)

SETTINGS = KeyframeSettings()
STANDS, TURNED, NEAR, FAR = Moved(0.005, 0.001), Moved(0.005, 0.1), Moved(0.03, 0.001), Moved(0.05, 0.001)


def wanted(*, share: float, moved: Moved, frames_since: int = 2, matches: int = 100, waiting: int = 0) -> bool:
    return wants_keyframe(
        SETTINGS, frames_since=frames_since, matches=matches, share=share, waiting=waiting, moved=moved
    )


def test_how_a_camera_has_moved():
    before, now = np.eye(4), np.eye(4)
    turn = math.radians(30.0)
    now[:3, :3] = [[math.cos(turn), 0, math.sin(turn)], [0, 1, 0], [-math.sin(turn), 0, math.cos(turn)]]
    now[:3, 3] = -now[:3, :3] @ [0.0, 0.0, 0.6]
    moved = moved_since(before, now, 12.0)
    assert moved.step == pytest.approx(0.05)
    assert moved.turn_rad == pytest.approx(turn)


@pytest.mark.parametrize("moved", [TURNED, NEAR])
def test_from_nearby_a_picture_is_kept_that_sees_much_less(moved):
    assert not wanted(share=0.75, moved=moved)
    assert wanted(share=0.65, moved=moved)


@pytest.mark.parametrize("moved", [FAR, ELSEWHERE])
def test_from_further_on_it_is_kept_sooner(moved):
    assert not wanted(share=0.9, moved=moved)
    assert wanted(share=0.75, moved=moved)


def test_a_busy_mapper_gets_only_what_is_urgent():
    assert not wanted(share=0.75, moved=FAR, waiting=1)
    assert wanted(share=0.35, moved=FAR, waiting=1)
    assert not wanted(share=0.35, moved=FAR, waiting=SETTINGS.queue + 1)


def test_a_camera_that_stands_takes_none_unless_it_sees_less_for_long():
    assert not wanted(share=0.65, moved=STANDS)
    assert not wanted(share=0.9, moved=STANDS, frames_since=100)
    assert wanted(share=0.65, moved=STANDS, frames_since=SETTINGS.most_frames)


def test_a_picture_that_sees_next_to_nothing_is_none():
    assert not wanted(share=0.1, moved=FAR, matches=SETTINGS.least_matches - 1)
