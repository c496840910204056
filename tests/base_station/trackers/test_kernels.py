"""The compiled kernels against their plain definitions, and the properties of the transform that they rest on."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from base_station.trackers.ztransform import reference
from base_station.trackers.ztransform.boxes import (
    IN_FRAME,
    LEAVES_FRAME,
    LEAVES_TABLE,
    MOST_STRIPS,
    SCALE,
    lies,
    read_profiles,
    sample_boxes,
    strips_needed,
)
from base_station.trackers.ztransform.kernels import fill_unseen, match_light, sample_patch
from base_station.trackers.ztransform.poles import PoleSettings, decay_rates, scale_weights, spiral_poles
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.search_kernels import (
    LANES,
    best_position,
    column_profile,
    distinct,
    energies,
    read_field,
    row_profile,
    score_position,
)
from base_station.trackers.ztransform.signature import SignatureReader, SignatureSettings

POLES = st.builds(lambda s, b: complex(np.exp(s * (1 + 1j * b))), st.floats(0.02, 1.5), st.floats(0, 3))


@given(seed=st.integers(0, 999), z=POLES, n0=st.integers(0, 60))
def test_shift_property_is_exact(seed, z, n0):
    row = np.random.default_rng(seed).uniform(0, 255, 300)
    shifted = reference.shifted_transform(reference.one_sided_transform(row, 0, z), row[:n0], z)
    assert shifted == pytest.approx(reference.one_sided_transform(row, n0, z), rel=1e-6 * abs(z) ** n0, abs=1e-6)


@given(seed=st.integers(0, 999), z=POLES, anchor=st.integers(0, 199))
def test_recursion_gives_the_transform_about_every_pixel(seed, z, anchor):
    row = np.random.default_rng(seed).uniform(0, 255, 200)
    assert reference.recursive_transform(row, z)[anchor] == pytest.approx(
        reference.one_sided_transform(row, anchor, z), rel=1e-9
    )


@given(seed=st.integers(0, 999), z=POLES)
def test_second_order_is_the_derivative(seed, z):
    row = np.random.default_rng(seed).uniform(-1, 1, 100)
    h = 1e-6
    slope = (reference.one_sided_transform(row, 0, z + h) - reference.one_sided_transform(row, 0, z - h)) / (2 * h)
    assert reference.one_sided_transform(row, 0, z, order=2) == pytest.approx(-z * slope, rel=1e-3, abs=1e-4)


def test_below_one_the_far_end_outweighs_all():
    """z = 0.9, as in the thesis: the weight of the last of 320 pixels against the first."""
    assert 0.9**-319 > 1e14


def test_enlarging_shifts_along_the_scale_index():
    """X(s) of a signal enlarged by g is g X(g s): with s in a geometric series, a step of g is a step of the index."""
    bank = PoleSettings(count=9, longest_cells=400.0, shortest_cells=25.0)
    rates = decay_rates(bank)
    g = rates[1] / rates[0]
    u = np.arange(6000)

    def transform(signal):
        return np.array([np.sum(signal(u) * p**u) for p in spiral_poles(bank)])

    def signal(x):
        return np.exp(-(((x - 300) / 90) ** 2)) * np.cos(x / 40)

    small, large = transform(signal), transform(lambda x: signal(x / g))
    np.testing.assert_allclose(large[:-1], g * small[1:], rtol=2e-2, atol=1e-2 * np.abs(small).max())


def test_poles_lie_inside_the_unit_circle_on_a_logarithmic_spiral():
    bank = PoleSettings(count=5, longest_cells=20, shortest_cells=2, slope=1.5)
    poles = spiral_poles(bank)
    assert (np.abs(poles) < 1).all()
    np.testing.assert_allclose(-np.log(np.abs(poles)), decay_rates(bank))
    ratio = decay_rates(bank)[1:] / decay_rates(bank)[:-1]
    np.testing.assert_allclose(ratio, ratio[0])
    assert scale_weights(bank)[1] == pytest.approx(decay_rates(bank)[1] ** 1.5)


@settings(max_examples=40, deadline=None)
@given(
    x=st.floats(-40, 200),
    y=st.floats(-30, 140),
    width=st.floats(12, 300),
    height=st.floats(12, 200),
    keystone=st.floats(-0.4, 0.4),
    curved=st.booleans(),
    scale=st.sampled_from([1, 2, 4]),
    samples=st.integers(1, 4),
)
def test_sample_patch_is_its_definition(x, y, width, height, keystone, curved, scale, samples):
    image = np.random.default_rng(1).integers(0, 256, (100 // scale, 160 // scale), np.uint8)
    image.flags.writeable = False
    placement = np.array([x, y, width, height, keystone])
    lens = np.array([float(curved), 300.0, 79.5, 49.5])
    patch, seen = np.empty((16, 16), np.float32), np.empty((16, 16), np.uint8)
    share = sample_patch(image, scale, placement, lens, samples, patch, seen)
    plain, plain_seen = reference.sample_patch(image, scale, placement, lens, samples, 16)
    np.testing.assert_allclose(patch, plain, atol=0.1)
    assert share == pytest.approx(plain_seen.mean(), abs=0.02)  # float32 rounds cells that lie on the very border


@settings(max_examples=40, deadline=None)
@given(
    x=st.floats(-20, 180),
    y=st.floats(-20, 120),
    width=st.floats(12, 200),
    height=st.floats(12, 150),
    keystone=st.floats(-0.4, 0.4),
    curved=st.booleans(),
    scale=st.sampled_from([1, 2, 4]),
)
def test_boxes_are_the_means_of_what_they_cover(x, y, width, height, keystone, curved, scale):
    frame = np.random.default_rng(1).integers(0, 256, (100, 160), np.uint8)
    placement, lens = np.array([x, y, width, height, keystone]), np.array([float(curved), 300.0, 79.5, 49.5])
    pyramid, patch, seen = Pyramid(frame), np.empty((16, 16), np.float32), np.empty((16, 16), np.uint8)
    table, where = pyramid.sums(1.5 * scale)
    assert where[SCALE] == scale
    share = sample_boxes(table, where, lens, placement, patch, seen)
    plain, plain_seen = reference.sample_boxes(pyramid.at(scale), scale, placement, lens, 16)
    np.testing.assert_allclose(patch[seen == 1], plain[seen == 1], atol=0.01)
    np.testing.assert_array_equal(seen, plain_seen)
    assert share == pytest.approx(plain_seen.mean())
    if lies(table, where, lens, placement) == IN_FRAME:
        profiles, strips = np.empty((8, 16), np.float32), strips_needed(4, 16, where, lens, placement)
        read_profiles(table, where, lens, placement, profiles)
        plain = reference.box_profiles(pyramid.at(scale), scale, placement, lens, 16, 4, strips)
        np.testing.assert_allclose(profiles, plain, atol=0.01)
        assert strips == MOST_STRIPS or strips >= 0.9 * 32 * abs(keystone) / 4 * (not curved)


def test_running_sums_of_a_part_read_the_same():
    frame = np.random.default_rng(1).integers(0, 256, (99, 161), np.uint8)
    placement, lens = np.array([70.3, 50.2, 60.0, 40.0, 0.1]), np.array([0.0, 300.0, 79.5, 49.5])
    for scale in (1, 2, 4):
        read = []
        for around in (None, (30.0, 22.0, 110.0, 78.0)):
            table, where = Pyramid(frame).sums(1.5 * scale, around)
            assert lies(table, where, lens, placement) == IN_FRAME
            read.append(np.empty((4, 24), np.float32))
            read_profiles(table, where, lens, placement, read[-1])
        np.testing.assert_allclose(*read, atol=1e-3)
    pyramid = Pyramid(frame)
    table, where = pyramid.sums(1.0, (30.0, 22.0, 110.0, 78.0))
    assert table.shape[1] < 100
    assert lies(table, where, lens, placement + np.array([40, 0, 0, 0, 0])) == LEAVES_TABLE
    assert lies(table, where, lens, placement + np.array([70, 0, 0, 0, 0])) == LEAVES_FRAME
    assert pyramid.sums(1.0, (40.0, 30.0, 100.0, 70.0))[0] is table
    assert pyramid.sums(1.0, (20.0, 22.0, 110.0, 78.0))[0].shape == (100, 162)


@pytest.mark.parametrize(("bands", "cells"), [(4, 48), (3, 32), (2, 21)])
def test_signature_is_its_definition(bands, cells):
    options = SignatureSettings(cells=cells, bands=bands, anchors=5, is_compact=False)
    patch = np.random.default_rng(cells).uniform(0, 255, (cells, cells)).astype(np.float32)
    fast, length = SignatureReader(options).signature(patch)
    np.testing.assert_allclose(fast[::2] + 1j * fast[1::2], plain_signature(options, patch).ravel(), atol=2e-5)
    assert np.linalg.norm(fast) == pytest.approx(1, abs=1e-5)
    assert length > 0


def test_a_compact_signature_has_the_inner_products_of_the_whole():
    options, rng = SignatureSettings(), np.random.default_rng(0)
    first, second = (rng.uniform(0, 255, (48, 48)).astype(np.float32) for _ in range(2))
    reader = SignatureReader(options)
    one, other = reader.signature(first)[0], reader.signature((first + second) / 2)[0]
    plain = np.vdot(plain_signature(options, first), plain_signature(options, (first + second) / 2)).real
    assert len(one) == 2 * options.bands * options.cells
    assert one @ other == pytest.approx(plain, abs=1e-5)
    assert one @ other < 0.95


def plain_signature(options, patch):
    cells, reach = options.cells, options.spread / 2
    anchors = np.round(np.linspace(cells * (0.5 - reach), cells * (0.5 + reach), options.anchors)).astype(int)
    u = (np.arange(cells) + 0.5) / cells
    taper = np.minimum(1, np.minimum(u, 1 - u) / options.taper)
    bank = options.poles
    return reference.read_signature(patch, options.bands, spiral_poles(bank), scale_weights(bank), anchors, taper)


def test_signature_does_not_see_gain_and_offset():
    reader = SignatureReader(SignatureSettings())
    patch = np.random.default_rng(0).uniform(0, 200, (48, 48)).astype(np.float32)
    other = (0.3 * patch + 40).astype(np.float32)
    np.testing.assert_allclose(reader.signature(patch)[0], reader.signature(other)[0], atol=1e-4)


def test_what_is_not_seen_is_taken_from_the_reference_in_this_light():
    rng = np.random.default_rng(0)
    learned = rng.uniform(0, 255, (20, 20)).astype(np.float32)
    patch = (0.5 * learned + 20).astype(np.float32)
    whole = patch.copy()
    seen = np.ones((20, 20), np.uint8)
    seen[:, 13:] = 0
    patch[:, 13:] = 0
    gain, offset = match_light(patch, seen, learned)
    assert (gain, offset) == (pytest.approx(0.5, abs=1e-4), pytest.approx(20, abs=0.05))
    fill_unseen(patch, seen, learned, gain, offset)
    np.testing.assert_allclose(patch, whole, atol=0.1)


@pytest.mark.parametrize("along_rows", [True, False])
def test_profiles_of_a_search_are_the_means_of_their_cells(along_rows):
    image = np.random.default_rng(2).integers(0, 256, (60, 90), np.uint8)
    table, _ = Pyramid(image).sums(1.0)
    edges = np.array([-9.0, -4.0, 3.0, 10.0, 20.5, 33.25, 70.5, 200.0])
    cells, sums = np.empty(7, np.float32), np.empty(91)
    (row_profile if along_rows else column_profile)(table, 7.25, 19.0, edges, sums, cells)
    lines = (image if along_rows else image.T).astype(float)
    band = (0.75 * lines[7] + lines[8:19].sum(0)) / 11.75
    length = len(band)

    def mean(low, high):
        pixels = np.arange(length)
        weights = np.clip(np.minimum(pixels + 1, high) - np.maximum(pixels, low), 0, 1)
        return weights @ band / weights.sum()

    cut = np.clip(edges, 0, length - 0.02)
    expected = [mean(low, high) for low, high in itertools.pairwise(cut[1:]) if high > low]
    np.testing.assert_allclose(cells[1 : 1 + len(expected)], expected, rtol=1e-5)
    assert cells[0] == 0
    assert (cells[1 + len(expected) :] == cells[len(expected)]).all()


def test_field_and_scores_are_their_definitions():
    rng = np.random.default_rng(3)
    bank = PoleSettings(count=3, longest_cells=5, shortest_cells=2)
    poles, weights = spiral_poles(bank), scale_weights(bank)
    profiles = rng.uniform(0, 255, (2, 50)).astype(np.float32)
    field, lanes = np.empty((50, 4 * LANES), np.float32), np.zeros((3, LANES), np.float32)
    for lane, values in zip(lanes, (poles.real, poles.imag, weights), strict=True):
        lane[:6] = np.tile(values, 2)
    read_field(profiles, 3, lanes.ravel(), field)
    parts = field.reshape(50, 2, 2, LANES)
    assert not parts[..., 6:].any()
    fast = np.stack([(parts[:, :, 0] + 1j * parts[:, :, 1])[..., b * 3 : b * 3 + 3] for b in range(2)])
    plain = np.stack([reference.read_field(profile, poles, weights) for profile in profiles]).transpose(0, 1, 3, 2)
    np.testing.assert_allclose(fast, plain, atol=1e-3 * np.abs(plain).max())

    anchors = np.array([-6, 0, 6])
    learned = field[24 + anchors]
    scale, energy, energy_here = np.linalg.norm(learned), np.empty(3, np.float32), np.empty(50, np.float32)
    learned = (learned / scale).astype(np.float32)
    energies(learned, energy)
    energies(field, energy_here)
    plain = reference.score_positions(field[None], learned[:, None], anchors, 0.6)
    fast = [score_position(field, energy_here, learned, energy, anchors, 0.6, n) for n in range(50)]
    np.testing.assert_allclose(fast, plain, atol=1e-4)
    for first, beyond in ((0, 50), (11, 40)):
        score, place = best_position(field, learned, energy, anchors, 0.6, first, beyond)
        assert score == pytest.approx(1, abs=1e-4)
        assert place == pytest.approx(24, abs=0.5)


def test_the_best_few_are_no_neighbours():
    sizes = np.array([[240.0, 100, 80], [240, 100, 80], [240, 106, 85], [240, 100, 80], [280, 100, 80]])
    found = np.array([[0.9, 300.0], [0.8, 305], [0.95, 300], [0.5, 500], [-1, 0]])
    assert distinct(sizes, found, 4).tolist() == [2, 3]
    assert distinct(sizes, found, 1).tolist() == [2]
