"""Trackers that say which rows they need see the same in a band as in the whole frame, and go back to it when lost."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from base_station.rows import band_for
from base_station.trackers.base import WantsRows
from base_station.trackers.registry import make_tracker, tracker_names
from base_station.types import Box, Frame, TrackingState

COLUMNS, ROWS = 320, 240
TARGET = Box.around(159.5, 100.5, 90, 50)
ON_BANDS = {"ztransform", "z-shift", "z-regions", "phase-row", "ratslam"}
PROVEN = {"ztransform": 66}
"""Frames after which it takes the target for rigid and wants no more than its rows; the others want them at once."""


@pytest.fixture
def world(make_world):
    return make_world(0, COLUMNS, ROWS)


def cut(frame: Frame, rows: tuple[int, int] | None) -> Frame:
    """The frame as it comes when only these rows are sent."""
    if rows is None:
        return frame
    image = np.ascontiguousarray(frame.image[rows[0] : rows[1]])
    return dataclasses.replace(frame, image=image, first_row=rows[0], full_height=len(frame.image))


def test_those_that_can_work_on_a_band_say_so():
    assert {name for name in tracker_names() if isinstance(make_tracker(name), WantsRows)} == ON_BANDS


@pytest.mark.parametrize("name", sorted(ON_BANDS))
def test_a_band_tells_the_same_as_the_whole_frame(name, world):
    """The target moves, down and nearer too; the band is asked for as the station does, and comes two frames late."""
    whole, banded = make_tracker(name), make_tracker(name)
    first = world.frame(world.view())
    whole.learn(first, TARGET)
    banded.learn(first, TARGET)
    assert banded.wanted_rows() is None or name != "ztransform"
    coming, sent = [None, None, None], []
    proven = PROVEN.get(name, 4)
    for number in range(2, proven + 20):
        t = max(number - proven, 0)
        grows = 1 + 0.004 * t if name == "ztransform" else 1
        frame = world.frame(world.view(8 * np.sin(number / 9), 0.2 * t, grows, noise=1), number)
        expected, result = whole.update(frame), banded.update(cut(frame, coming[0]))
        sent.append(coming[0] or (0, ROWS))
        coming = [*coming[1:], band_for(banded.wanted_rows(), coming[-1], ROWS)]
        assert (result.state, result.reason) == (expected.state, expected.reason)
        assert result.state is TrackingState.TRACKING
        for field in ("shift_px", "shift_y_px", "zoom", "bearing_rad", "confidence"):
            one, other = getattr(result, field), getattr(expected, field)
            assert (one is None) == (other is None)
            # The column that z-shift reads is cut off where the band ends; the others read what they always read.
            assert one is None or one == pytest.approx(other, abs=0.1 if name == "z-shift" else 1e-4), field
    assert np.mean([last - first for first, last in sent[proven:]]) < 0.8 * ROWS


@pytest.mark.parametrize("name", sorted(ON_BANDS))
def test_a_target_lost_in_a_band_is_looked_for_in_whole_frames(name, world):
    tracker = make_tracker(name)
    tracker.learn(world.frame(world.view()), TARGET)
    proven, view = PROVEN.get(name, 4), world.view(1, noise=1)
    for number in range(2, proven):
        tracker.update(world.frame(view, number))
    band = band_for(tracker.wanted_rows(), None, ROWS)
    assert band is not None
    for number in range(proven, proven + 3):
        nothing = world.frame(np.full((ROWS, COLUMNS), 90, np.uint8), number)
        result = tracker.update(cut(nothing, band))
        assert result.state is TrackingState.LOST and result.box is None
    if name in ("ztransform", "z-shift"):  # the others read the same rows always, and search in them
        assert tracker.wanted_rows() is None
    for number in range(proven + 3, proven + 6):
        result = tracker.update(world.frame(world.view(4), number))
    assert result.state is TrackingState.TRACKING
    assert result.shift_px == pytest.approx(4, abs=1) if name != "z-regions" else result.shift_px is None


@pytest.mark.parametrize("rows", [(220, 240), (100, 104)])
@pytest.mark.parametrize("name", sorted(ON_BANDS))
def test_a_band_that_came_from_elsewhere_is_never_misread(name, rows, world):
    """A band asked for before the target was learned anew: LOST with a reason, or what is truly there."""
    tracker = make_tracker(name)
    tracker.learn(world.frame(world.view()), TARGET)
    for number in range(2, 5):
        result = tracker.update(cut(world.frame(world.view(3, noise=1), number), rows))
        if result.state is TrackingState.TRACKING:
            assert result.shift_px is None or result.shift_px == pytest.approx(3, abs=1)
        else:
            assert result.reason
    result = tracker.update(world.frame(world.view(3), 6))
    assert result.state is TrackingState.TRACKING, result.reason


def test_a_place_and_a_target_that_is_not_proven_want_whole_frames(world):
    tracker = make_tracker("ztransform")
    assert tracker.wanted_rows() is None
    for target in (None, TARGET):
        tracker.learn(world.frame(world.view()), target)
        for number in range(2, 8):
            assert tracker.update(world.frame(world.view(noise=1), number)).state is TrackingState.TRACKING
            assert tracker.wanted_rows() is None
