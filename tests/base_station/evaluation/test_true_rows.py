"""Frames and truths meet in any order, come back as they were noted, and take little memory."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from base_station.evaluation.true_rows import MAX_UNMATCHED, Reading, TrueRows
from base_station.types import Box, TrackerResult, TrackingState
from protocol import Truth

SEEN = TrackerResult(
    state=TrackingState.TRACKING, bearing_rad=0.125, view_angle_rad=-0.25, range_m=0.75, box=Box(1, 2, 3, 4),
    cam_from_world=np.eye(4), confidence=0.9, zoom=1.1,
)  # fmt: skip
GONE = TrackerResult(state=TrackingState.LOST, reason="left the view", compass_rad=3.0)
SHOWN = Reading(TrackingState.TRACKING, "", 0.125, -0.25, 0.75, None, True)
FULL = Truth(
    robot=(1.0, -2.0, 0.5), target=(3.0, 4.0, -0.5), bearing_rad=0.375, range_m=0.875, in_view=True, collisions=2
)
BARE = Truth(robot=(0.0, 0.0, 0.0))


def test_rows_come_back_as_noted() -> None:
    rows = TrueRows()
    for number, (result, shadow, pan_rad, truth) in enumerate([(SEEN, None, None, FULL), (GONE, SEEN, -0.375, BARE)]):
        rows.note_truth(("a", number), truth)
        rows.note_frame(("a", number), 10.0 + number, result, shadow, pan_rad)
    first, second = rows.rows()
    assert (first.index, first.time_s, first.shown, first.shadow, first.pan_rad, first.truth) == (
        0, 10.0, SHOWN, None, None, FULL,
    )  # fmt: skip
    assert second.shown == Reading(TrackingState.LOST, "left the view", None, None, None, 3.0, False)
    assert (second.index, second.time_s, second.shadow, second.pan_rad, second.truth) == (1, 11.0, SHOWN, -0.375, BARE)
    assert first.shown.tracking and not second.shown.tracking
    assert [row.index for row in rows.rows(since=1)] == [1]


def test_a_truth_may_come_late_and_only_the_first_one_counts() -> None:
    rows = TrueRows()
    rows.note_truth(("a", 1), FULL)
    rows.note_truth(("a", 1), BARE)
    for number in (1, 2, 3):
        rows.note_frame(("a", number), float(number), SEEN, None, None)
    rows.note_truth(("a", 1), BARE)
    assert not rows.complete
    rows.note_truth(("b", 3), BARE)
    assert not rows.complete, "another connection's frame"
    rows.note_truth(("a", 3), FULL)
    rows.note_truth(("a", 3), BARE)
    assert rows.complete
    rows.note_truth(("a", 2), BARE)
    assert [(row.index, row.truth) for row in rows.rows()] == [(0, FULL), (1, BARE), (2, FULL)]
    assert rows.seen == 3


def test_without_truths_nothing_is_awaited_and_little_kept() -> None:
    rows = TrueRows()
    for number in range(3 * MAX_UNMATCHED):
        rows.note_frame(("a", number), float(number), SEEN, None, None)
    assert rows.complete and rows.rows() == [] and rows.seen == 3 * MAX_UNMATCHED
    for number in range(3 * MAX_UNMATCHED):
        rows.note_truth(("a", number), BARE)
    assert [row.index for row in rows.rows()] == list(range(2 * MAX_UNMATCHED, 3 * MAX_UNMATCHED))


def test_a_frame_takes_less_than_200_bytes() -> None:
    rows = TrueRows()
    tracemalloc.start()
    try:
        for number in range(3000):
            place = number / 1000
            rows.note_truth(("a", number), Truth(robot=(place, place, place), bearing_rad=place, range_m=1 + place))
            rows.note_frame(("a", number), place, SEEN, GONE, None)
        taken_bytes, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert taken_bytes < 3000 * 200
    assert rows.rows()[2999].truth.robot == pytest.approx((2.999,) * 3, rel=1e-6)
