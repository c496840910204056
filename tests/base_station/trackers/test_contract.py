"""What every tracker must keep, whatever it does inside: one test run over all of them and over the example."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

import base_station.trackers.example as example
from base_station.trackers.base import Tracker
from base_station.trackers.registry import make_tracker, tracker_names
from base_station.types import Box, TrackingState

OWN = f"{Path(example.__file__)}:TorchTracker"
TARGET = Box.around(319.5, 239.5, 180, 160)
NO_SHIFT = {"z-regions"}
"""Trackers that know a direction only, and say by their box how coarsely."""


@pytest.fixture(params=[*tracker_names(), OWN], ids=[*tracker_names(), "example"])
def name(request):
    return request.param


def check_shift(name, result, dx, dy, *, abs_px=1.0):
    """The shift is the true one; from a tracker that knows none, there is none."""
    if name in NO_SHIFT:
        assert (result.shift_px, result.shift_y_px) == (None, None)
    else:
        assert result.shift_px == pytest.approx(dx, abs=abs_px)
        assert result.shift_y_px is None or result.shift_y_px == pytest.approx(dy, abs=abs_px)


@pytest.fixture
def scene(name, world):
    """A world that suits the tracker: for the torch, a dark one with a bright spot in its middle."""
    if name == OWN:
        world._picture[:] = 40 + 0.1 * world._picture
        cv2.circle(world._picture, (639, 479), 9, 250.0, -1, cv2.LINE_AA)
    return world


def test_is_a_tracker(name):
    assert isinstance(make_tracker(name), Tracker)


def test_initializing_until_it_has_learned(name, scene):
    result = make_tracker(name).update(scene.frame(scene.view()))
    assert result.state is TrackingState.INITIALIZING
    assert result.reason


@pytest.mark.parametrize("target", [TARGET, None], ids=["box", "place"])
def test_follows_a_shift_with_the_right_signs(name, scene, target):
    tracker = make_tracker(name)
    tracker.learn(scene.frame(scene.view()), target)
    shifts = [(0, 0), (4, 2), (8, 4), (14, 6), (20, 8)]
    for number, (dx, dy) in enumerate(shifts, 2):
        result = tracker.update(scene.frame(scene.view(dx, dy, noise=1), number))
        assert result.state is TrackingState.TRACKING, result.reason
        check_shift(name, result, dx, dy)
        assert result.zoom is None or result.zoom == pytest.approx(1, abs=0.01)
        assert 0 < result.confidence <= 1
        assert result.reason == ""
    if name in NO_SHIFT:
        assert result.bearing_rad == pytest.approx(scene.camera.bearing_rad(result.box.center_px[0]), abs=1e-9)
        assert result.elevation_rad is None
    else:
        assert result.bearing_rad == pytest.approx(-math.atan2(20, scene.camera.fx), abs=0.003)
        elevation_rad = -math.atan2(8, scene.camera.fy)
        assert result.elevation_rad is None or result.elevation_rad == pytest.approx(elevation_rad, abs=0.003)
        assert (result.elevation_rad is None) == (result.shift_y_px is None) == (result.box is None)


def test_says_the_zoom_or_nothing(name, scene):
    tracker = make_tracker(name)
    tracker.learn(scene.frame(scene.view()), TARGET)
    for number, zoom in enumerate((1.02, 1.05, 1.09), 2):
        result = tracker.update(scene.frame(scene.view(zoom=zoom), number))
    assert result.zoom is None or result.zoom == pytest.approx(1.09, rel=0.01)


@pytest.mark.parametrize("target", [TARGET, None], ids=["box", "place"])
@pytest.mark.parametrize("kind", ["black", "white", "grey", "dark noise"])
def test_a_view_of_nothing_is_lost_and_gives_no_number(name, scene, target, kind):
    tracker = make_tracker(name)
    tracker.learn(scene.frame(scene.view()), target)
    rng = np.random.default_rng(0)
    level = {"black": 0, "white": 255, "grey": 128, "dark noise": 20}[kind]
    for number in range(2, 8):
        noise = rng.normal(0, 5, (480, 640)) if kind == "dark noise" else 0
        image = np.clip(np.full((480, 640), level) + noise, 0, 255).astype(np.uint8)
        result = tracker.update(scene.frame(image, number))
        assert result.state is TrackingState.LOST
        assert result.reason
        assert (result.shift_px, result.bearing_rad, result.zoom, result.box) == (None,) * 4


def test_is_found_again(name, scene):
    tracker = make_tracker(name)
    tracker.learn(scene.frame(scene.view()), TARGET)
    tracker.update(scene.frame(scene.view(3), 2))
    for number in range(3, 8):
        assert tracker.update(scene.frame(np.full((480, 640), 90, np.uint8), number)).state is TrackingState.LOST
    results = [tracker.update(scene.frame(scene.view(6), number)) for number in range(8, 11)]
    assert results[-1].state is TrackingState.TRACKING
    check_shift(name, results[-1], 6, 0)


def test_refuses_to_learn_nothing(name, scene):
    grey = np.full((480, 640), 128, np.uint8)
    for target in (TARGET, None):
        with pytest.raises(ValueError, match="featureless"):
            make_tracker(name).learn(scene.frame(grey), target)


@pytest.mark.parametrize("name", tracker_names())
@pytest.mark.parametrize("target", [Box(700, 10, 50, 50), Box(-100, -90, 60, 60), Box(300, 200, 3, 3)])
def test_refuses_a_box_that_cannot_be_tracked(name, world, target):
    with pytest.raises(ValueError, match=r"outside|small"):
        make_tracker(name).learn(world.frame(world.view()), target)


def test_another_frame_size_is_lost_or_seen_but_no_crash(name, scene):
    tracker = make_tracker(name)
    tracker.learn(scene.frame(scene.view()), TARGET)
    for shape in ((240, 320), (64, 640), (2, 2), (1, 5)):
        result = tracker.update(scene.frame(np.zeros(shape, np.uint8), 2))
        assert result.state is TrackingState.LOST
        assert result.reason


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (9, 16)])
def test_tiny_frames_are_refused_not_crashed_on(name, scene, shape):
    with pytest.raises(ValueError):
        make_tracker(name).learn(scene.frame(np.zeros(shape, np.uint8)), None)


def test_same_frames_give_same_results(name, scene):
    images = [scene.view(3 * i, i, 1 + 0.01 * i, noise=3) for i in range(6)]

    def run():
        tracker = make_tracker(name)
        tracker.learn(scene.frame(images[0]), TARGET)
        return [tracker.update(scene.frame(image, i)) for i, image in enumerate(images[1:], 2)]

    assert run() == run()


def test_learning_again_replaces(name, scene):
    tracker = make_tracker(name)
    tracker.learn(scene.frame(scene.view()), TARGET)
    tracker.update(scene.frame(scene.view(30), 2))
    tracker.learn(scene.frame(scene.view(10), 3), Box.around(329.5, 239.5, 180, 160))
    result = tracker.update(scene.frame(scene.view(10), 4))
    assert result.state is TrackingState.TRACKING
    check_shift(name, result, 0, 0, abs_px=0.2)


def test_close_twice(name, scene):
    tracker = make_tracker(name)
    tracker.learn(scene.frame(scene.view()), TARGET)
    tracker.close()
    tracker.close()
