"""Each condition changes what it is named for, within the ranges of the benchmark, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.evaluation.conditions import (
    CONDITIONS,
    TARGET,
    Disturbance,
    disturbed_view,
    looks_without_target,
    reference_view,
    views_without_target,
)
from base_station.evaluation.worlds import generated_world

RANGES = {
    "shift": {},
    "noise": {"noise": (10, 10)},
    "gain_offset": {"gain": (0.4, 1.6), "offset": (-40, 40)},
    "gamma": {"gamma": (0.5, 2)},
    "gradient": {"gradient": (-40, 40)},
    "zoom": {"zoom": (0.7, 1.4)},
    "vertical": {"dy": (-6, 6)},
    "blur": {"blur_px": (9, 9)},
    "occlusion": {"hidden_share": (0.25, 0.25)},
    "all": {"noise": (8, 8), "gain": (0.6, 0.6), "offset": (20, 20), "zoom": (0.9, 1.1), "dy": (-4, 4)},
}


@pytest.fixture(scope="module")
def world():
    return generated_world(3)


@pytest.fixture(scope="module")
def other():
    return generated_world(4)


@pytest.mark.parametrize("name", CONDITIONS)
def test_ranges_are_kept_and_used(name):
    rng = np.random.default_rng(0)
    drawn = [CONDITIONS[name](rng) for _ in range(400)]
    ranges = {"dx": (-50, 50)} | RANGES[name]
    for field, plain in vars(Disturbance()).items():
        values = np.array([getattr(disturbance, field) for disturbance in drawn])
        low, high = ranges.get(field, (plain, plain))
        assert low <= values.min() <= low + 0.05 * (high - low), field
        assert high - 0.05 * (high - low) <= values.max() <= high, field


def change(world, **disturbance):
    """Reference and disturbed view, float."""
    rng = np.random.default_rng(0)
    view = disturbed_view(world, Disturbance(**disturbance), rng)
    return reference_view(world).astype(float), view.astype(float)


def test_noise_is_as_strong_as_said(world):
    before, after = change(world, noise=10)
    open_to_both_sides = (before > 50) & (before < 205)
    assert (after - before)[open_to_both_sides].std() == pytest.approx(10, rel=0.02)
    assert abs((after - before)[open_to_both_sides].mean()) < 0.1


def test_light_is_as_said(world):
    before, after = change(world, gain=0.6, offset=20)
    assert np.abs(after - (0.6 * before + 20)).max() <= 1
    before, after = change(world, gamma=2)
    assert np.abs(after - before**2 / 255).max() <= 2
    before, after = change(world, gradient=-40)
    inside = (before > 45) & (before < 210)
    ramp = np.broadcast_to(np.linspace(40, -40, 640), before.shape)
    assert np.abs(after - before - ramp)[inside].max() <= 1


def test_blur_is_a_streak_of_nine_pixels_along_the_row(world):
    before, after = change(world, blur_px=9)
    streaks = np.lib.stride_tricks.sliding_window_view(before, 9, axis=1).mean(2)
    assert np.abs(after[:, 4:-4] - streaks).max() <= 1.01


def test_a_quarter_of_the_target_is_hidden_wherever_it_is(world, other):
    rng = np.random.default_rng(0)
    for dx, zoom in ((0.0, 1.0), (-50.0, 1.0), (30.0, 1.2)):
        plain = disturbed_view(world, Disturbance(dx=dx, zoom=zoom), rng).astype(int)
        disturbance = Disturbance(dx=dx, zoom=zoom, hidden_share=0.25)
        hidden = disturbed_view(world, disturbance, rng, cover=other.view()).astype(int)
        y, x = np.nonzero(plain != hidden)
        covered = (np.ptp(x) + 1) * (np.ptp(y) + 1) / (TARGET.width * TARGET.height * zoom**2)
        assert covered == pytest.approx(0.25, rel=0.03)
        assert abs(x.min() + x.max() - 639 - 2 * dx) <= TARGET.width * zoom
        assert abs(x - 319.5 - dx).max() <= TARGET.width * zoom / 2 + 1
        assert abs(y - 239.5).max() <= TARGET.height * zoom / 2 + 1


def test_views_are_read_only_and_repeatable(world):
    first, again = (disturbed_view(world, Disturbance(noise=5), np.random.default_rng(7)) for _ in range(2))
    assert (first == again).all()
    assert (first.dtype, first.shape, first.flags.writeable) == (np.uint8, (480, 640), False)


def test_look_alikes_share_what_they_are_named_for_and_not_the_target(world, other):
    reference = reference_view(world)
    views = views_without_target(reference, reference_view(other))
    assert set(views) == {"other", "mirrored", "shuffled", "spectrum"}
    assert (views["mirrored"][:, ::-1] == reference).all()
    box = slice(150, 330), slice(200, 440)
    assert sorted(views["shuffled"][box].ravel()) == sorted(reference[box].ravel())
    assert (views["shuffled"] == reference)[:150].all()
    spectra = [np.abs(np.fft.rfft2(view - view.mean())) for view in (reference, views["spectrum"].astype(float))]
    assert np.corrcoef(np.log1p(spectra[0]).ravel(), np.log1p(spectra[1]).ravel())[0, 1] > 0.7
    for name, view in views.items():
        likeness = np.corrcoef(view[box].ravel(), reference[box].ravel())[0, 1]
        assert abs(likeness) < 0.5, name


def test_looks_without_the_target_are_many_and_all_different():
    rng = np.random.default_rng(0)
    reference, *others = (rng.integers(60, 200, (480, 640)).astype(np.uint8) for _ in range(3))
    looks = list(looks_without_target(reference, others, 3, np.random.default_rng(1)))
    assert [kind for kind, _ in looks] == ["other", "mirrored", "shuffled", "spectrum"] * 3
    assert len({view.tobytes() for _, view in looks}) == 12
    assert all(view.dtype == np.uint8 and view.shape == (480, 640) for _, view in looks)
    first = views_without_target(reference, others[0])
    assert all((view == first[kind]).all() for kind, view in looks[:4])
    again = looks_without_target(reference, others, 3, np.random.default_rng(1))
    assert all((view == same).all() for (_, view), (_, same) in zip(looks, again, strict=True))
