"""The thesis's two algorithms: kernels against their definitions, what each finds, and what z = 0.9 cannot."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from base_station.trackers.ztransform import reference
from base_station.trackers.ztransform.thesis import kernels
from base_station.trackers.ztransform.thesis.z_regions import ZRegionsSettings, ZRegionsTracker
from base_station.trackers.ztransform.thesis.z_shift import ZShiftSettings, ZShiftTracker
from base_station.types import Box, TrackingState

TARGET = Box.around(319.5, 239.5, 180, 160)
POLES = st.builds(lambda s, b: complex(np.exp(s * (1 + 1j * b))), st.floats(-0.1, 0.3), st.floats(0, 3))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 999), z=POLES, anchor=st.integers(40, 80))
def test_foretelling_by_the_shift_property_is_moving_the_row(seed, z, anchor):
    row = np.random.default_rng(seed).uniform(0, 255, 121)
    foretold = np.empty((81, 1, 2), complex)
    kernels.predict_shifts(row, anchor, np.array([z]), 40, foretold)
    moved = reference.predicted_transforms(row, anchor, z, 40)
    np.testing.assert_allclose(foretold[:, 0], moved, rtol=1e-8, atol=1e-8 * np.abs(moved).max())


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 999), any_gain=st.booleans(), true=st.floats(0.1, 8.9), gain=st.floats(0.5, 2))
def test_fit_is_the_best_of_all_fractions(seed, any_gain, true, gain):
    rng = np.random.default_rng(seed)
    predicted = rng.normal(size=(10, 6)) + 1j * rng.normal(size=(10, 6))
    low, part = int(true), true - int(true)
    seen = gain * ((1 - part) * predicted[low] + part * predicted[low + 1]) + 0.05 * rng.normal(size=6)
    found, plain = kernels.fit_shift(predicted, seen, any_gain), reference.fit_shift(predicted, seen, any_gain)
    assert found[1] == pytest.approx(plain[1], abs=1e-4)
    assert found[1] <= plain[1] + 1e-12
    assert found[0] == pytest.approx(plain[0], abs=2e-3)
    assert found[2] == pytest.approx(plain[2], rel=1e-2)


def test_nothing_fits_nothing():
    assert kernels.fit_shift(np.ones((3, 2), complex), np.zeros(2, complex), True) == (0.0, 1.0, 0.0)
    assert kernels.fit_shift(np.zeros((3, 2), complex), np.ones(2, complex), True)[1:] == (1.0, 0.0)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 999), regions=st.integers(2, 9), columns=st.integers(60, 200))
def test_regions_are_their_definition(seed, regions, columns):
    row, z = np.random.default_rng(seed).uniform(0, 255, columns), np.array([0.7, 0.8, 0.9])
    found = np.empty((regions, 3, 2))
    kernels.transform_regions(row, regions, z, found)
    np.testing.assert_allclose(found, reference.region_transforms(row, regions, z), rtol=1e-9)


def one_row_errors(settings, make_world, border, shifts=(5, -10, 20, -50)):
    """|error| in px of one-shot shifts by whole pixels; what enters at the border is black or more of the picture."""
    errors = []
    for seed in range(6):
        for dx in shifts:
            world = make_world(seed)
            first, second = world.view(), world.view(dx).copy()
            if border == "black":
                second[:, : max(dx, 0)] = 0
                second[:, 640 + min(dx, 0) :] = 0
            tracker = ZShiftTracker(settings=settings)
            tracker.learn(world.frame(first), None)
            result = tracker.update(world.frame(second, 2))
            errors.append(abs(result.shift_px - dx) if result.shift_px is not None else np.inf)
    return np.array(errors)


def test_the_thesis_z_is_exact_with_a_black_border_and_wrong_with_a_real_one(make_world):
    """The reproduction: with z = 0.9 what enters at the border outweighs all the rest, with z = 1.1 it does not count.

    Of both sides: one real number, from one half of the row, is met by several shifts between whole pixels.
    """
    thesis = ZShiftSettings.thesis()
    assert one_row_errors(thesis, make_world, "black", shifts=(-5, -10, -20, -50)).max() < 0.01
    assert np.median(one_row_errors(thesis, make_world, "real", shifts=(-5, -10, -20, -50))) > 3
    mended = ZShiftSettings(z=(1.1,), rows=1, any_light=False, vertical=False, largest_residual=1)
    assert one_row_errors(mended, make_world, "real").max() < 0.01


@pytest.mark.parametrize(
    ("name", "view", "least_px", "median_px"),
    [
        ("whole pixels", {}, 0, 0.01),
        ("noise", {"noise": 10}, 0.01, 0.4),
        ("light", {"gain": 0.5, "offset": 20}, 0, 0.05),
        ("another height", {"dy": 4}, 0, 0.05),
    ],
)
def test_finds_the_shift(make_world, name, view, least_px, median_px):
    errors = []
    for seed in range(5):
        world = make_world(seed)
        tracker = ZShiftTracker()
        tracker.learn(world.frame(world.view()), TARGET)
        for number, dx in enumerate((-31, 8, 47), 2):
            result = tracker.update(world.frame(world.view(dx, **view), number))
            assert result.state is TrackingState.TRACKING, result.reason
            assert result.zoom is None
            errors.append(abs(result.shift_px - dx))
    assert least_px <= np.median(errors) <= median_px
    assert max(errors) < 1.5


def test_finds_fractions_of_a_pixel(make_world):
    errors = []
    for seed in range(5):
        world = make_world(seed)
        tracker = ZShiftTracker()
        tracker.learn(world.frame(world.view()), TARGET)
        for number, dx in enumerate((-30.5, 7.25, 12.7), 2):
            errors.append(abs(tracker.update(world.frame(world.view(dx), number)).shift_px - dx))
    assert 0 < np.median(errors) < 0.1
    assert max(errors) < 0.3


def test_the_search_ends_at_the_span(world):
    tracker = ZShiftTracker(settings=ZShiftSettings(span_px=30))
    tracker.learn(world.frame(world.view()), TARGET)
    assert tracker.update(world.frame(world.view(60), 2)).state is TrackingState.LOST
    assert tracker.update(world.frame(world.view(25), 3)).shift_px == pytest.approx(25, abs=0.1)
    assert tracker.update(world.frame(world.view(45), 4)).shift_px == pytest.approx(45, abs=0.1)


@pytest.mark.parametrize("wrong", [{"z": ()}, {"z": (0.0,)}, {"z": (2.0,)}, {"span_px": 0}, {"z": (float("nan"),)}])
def test_settings_that_cannot_work_are_refused(wrong):
    with pytest.raises(ValueError, match="z"):
        ZShiftSettings(**wrong)


@pytest.mark.parametrize("wrong", [{"regions": 1}, {"z": (1.1,)}, {"z": ()}])
def test_regions_that_cannot_work_are_refused(wrong):
    with pytest.raises(ValueError, match="z-regions"):
        ZRegionsSettings(**wrong)


@pytest.mark.parametrize("light", [(1.0, 0.0), (0.6, 15.0)], ids=["same light", "darker"])
def test_regions_point_at_what_moves(make_world, light):
    """A thing before a still background, moving: the bearing is that of the thing, to half a region."""
    for seed in range(4):
        world = make_world(seed)
        background = world.view()
        tracker = ZRegionsTracker()
        tracker.learn(world.frame(background), None)
        still = tracker.update(world.frame(world.view(noise=2), 2))
        assert (still.state, still.bearing_rad, still.confidence) == (TrackingState.TRACKING, None, 1.0)
        for number, x in enumerate((90, 260, 410, 560), 3):
            view = background.copy()
            under = float(background[200:280, x - 20 : x + 20].mean())
            cv2.rectangle(view, (x - 20, 190), (x + 19, 290), 255.0 if under < 128 else 0.0, -1)
            seen = np.clip(light[0] * view + light[1], 0, 255).astype(np.uint8)
            result = tracker.update(world.frame(seen, number))
            assert result.shift_px is None and result.zoom is None
            assert abs(result.box.center_px[0] - x) <= 40
            assert result.confidence > 0.7
            assert result.bearing_rad == pytest.approx(world.camera.bearing_rad(result.box.center_px[0]))


def test_regions_are_not_sure_when_the_camera_moves(world):
    tracker = ZRegionsTracker()
    tracker.learn(world.frame(world.view()), None)
    assert tracker.update(world.frame(world.view(25), 2)).confidence < 0.9
