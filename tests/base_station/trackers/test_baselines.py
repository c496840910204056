"""Each baseline is as exact as its method is, on clean and noisy views and with a part hidden."""

from __future__ import annotations

import math

import numpy as np
import pytest

from base_station.evaluation.conditions import CAMERA, TARGET, Disturbance, disturbed_view, reference_view
from base_station.evaluation.worlds import generated_world
from base_station.trackers.baselines.patch import peak_offset
from base_station.trackers.baselines.similarity import fit_similarity
from base_station.trackers.registry import make_tracker
from base_station.types import Frame, TrackingState

EXACT_PX = {"phase": 0.3, "phase-row": 0.06, "ncc": 0.03, "ratslam": 0.55, "klt": 0.05, "ecc": 0.03, "orb": 0.3}
"""Largest error in a clean view of a shifted picture; whole pixels (ratslam) are half a pixel off at most."""
NOISY_PX = {"phase": 0.5, "phase-row": 0.15, "ncc": 0.06, "ratslam": 1.05, "klt": 0.15, "ecc": 0.06, "orb": 0.6}
KNOW_ZOOM = ("klt", "ecc", "orb")
KNOW_NO_HEIGHT = ("phase-row", "ratslam")
SHIFTS = (3.3, -7.75, 12.5, 19.0)


@pytest.fixture(scope="module")
def worlds():
    return [generated_world(seed) for seed in range(2)]


def frame(image, number=1):
    return Frame(image=image, number=number, time_s=number / 30, camera=CAMERA)


def learned(name, world):
    tracker = make_tracker(name)
    tracker.learn(frame(reference_view(world)), TARGET)
    return tracker


def results(name, world, disturbances):
    rng = np.random.default_rng(0)
    tracker = learned(name, world)
    views = [disturbed_view(world, disturbance, rng) for disturbance in disturbances]
    return [tracker.update(frame(view, number)) for number, view in enumerate(views, 2)]


@pytest.mark.parametrize("name", EXACT_PX)
@pytest.mark.parametrize(("light", "bars"), [({}, EXACT_PX), ({"noise": 10}, NOISY_PX)], ids=["exact", "noisy"])
def test_shifts_are_found_to_the_methods_exactness(worlds, name, light, bars):
    errors = []
    for world in worlds:
        views = [Disturbance(dx=dx, **light) for dx in SHIFTS]
        for dx, result in zip(SHIFTS, results(name, world, views), strict=True):
            assert result.state is TrackingState.TRACKING, result.reason
            errors.append(result.shift_px - dx)
    assert np.abs(errors).max() < bars[name]
    assert abs(np.mean(errors)) < 0.6 * bars[name]


@pytest.mark.parametrize("name", EXACT_PX)
def test_other_light_changes_little(worlds, name):
    views = [Disturbance(dx=dx, gain=0.6, offset=30) for dx in SHIFTS]
    for dx, result in zip(SHIFTS, results(name, worlds[1], views), strict=True):
        assert result.state is TrackingState.TRACKING, result.reason
        assert result.shift_px == pytest.approx(dx, abs=2 * EXACT_PX[name])


@pytest.mark.parametrize("name", KNOW_ZOOM)
@pytest.mark.parametrize("factor", [1.05, 1 / 1.05])
def test_zoom_is_known_where_a_similarity_is_fitted(worlds, name, factor):
    views = [Disturbance(dx=2.0 * number, dy=-number, zoom=factor**number) for number in range(1, 6)]
    for view, result in zip(views, results(name, worlds[0], views), strict=True):
        assert result.zoom == pytest.approx(view.zoom, rel=0.006)
        assert result.shift_px == pytest.approx(view.dx, abs=0.5)
        assert result.shift_y_px == pytest.approx(view.dy, abs=0.5)
        assert result.box.width == pytest.approx(TARGET.width * view.zoom, rel=0.006)


@pytest.mark.parametrize("name", EXACT_PX)
def test_what_a_method_cannot_tell_is_none(worlds, name):
    (result,) = results(name, worlds[0], [Disturbance(dx=4.0)])
    assert (result.zoom is not None) == (name in KNOW_ZOOM)
    assert (result.shift_y_px is None) == (name in KNOW_NO_HEIGHT)
    assert (result.box is None) == (name in KNOW_NO_HEIGHT)


@pytest.mark.parametrize("name", ["ncc", "klt", "orb", "phase-row"])
def test_a_hidden_eighth_is_an_outlier_and_no_more(worlds, name):
    """A piece of another picture before a corner of the target: the rest still says where it is."""
    tracker = learned(name, worlds[0])
    view = disturbed_view(worlds[0], Disturbance(dx=6.5), np.random.default_rng(0)).copy()
    view[150:240, 206:266] = reference_view(worlds[1])[150:240, 206:266]
    result = tracker.update(frame(view, 2))
    assert result.state is TrackingState.TRACKING, result.reason
    assert result.shift_px == pytest.approx(6.5, abs=0.35)


@pytest.mark.parametrize("name", sorted(set(EXACT_PX) - {"ratslam"}))
def test_another_picture_is_not_the_target(worlds, name):
    """Column sums (ratslam) of other pictures do look alike: the benchmark reports how often."""
    for one, other in (worlds, worlds[::-1]):
        tracker = learned(name, one)
        for number in range(2, 5):
            view = disturbed_view(other, Disturbance(dx=15.0 * number), np.random.default_rng(0))
            result = tracker.update(frame(view, number))
            assert result.state is TrackingState.LOST
            assert result.reason


def test_a_similarity_is_fitted_in_spite_of_wrong_pairs():
    rng = np.random.default_rng(0)
    learned = rng.uniform(0, 300, (40, 2))
    turn, zoom, shift = math.radians(10), 1.2, (5.0, -3.0)
    rotation = zoom * np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    seen = learned @ rotation.T + shift
    seen[:12] = rng.uniform(0, 300, (12, 2))
    fitted = fit_similarity(learned.astype(np.float32), seen.astype(np.float32))
    assert fitted is not None
    assert fitted.zoom == pytest.approx(zoom, abs=1e-4)
    assert 28 <= fitted.inliers <= 30
    assert fitted.moved(100, 50) == pytest.approx(tuple(rotation @ (100, 50) + shift), abs=0.01)


def test_pairs_that_agree_on_nothing_are_no_similarity():
    rng = np.random.default_rng(1)
    one, other = (rng.uniform(0, 500, (30, 2)).astype(np.float32) for _ in range(2))
    assert fit_similarity(one, other) is None
    assert fit_similarity(one[:3], one[:3]) is None


def test_the_top_of_a_parabola():
    assert peak_offset(-(0.3**2) * 2 + 1, 1.0, -(0.3**2) * 2 + 1) == 0
    before, peak, after = (5 - 2 * (x - 0.2) ** 2 for x in (-1, 0, 1))
    assert peak_offset(before, peak, after) == pytest.approx(0.2)
    assert peak_offset(1, 1, 1) == 0
