"""The patch held against the learned one: kernels as defined, exact, not misled by a cover or a mirror image."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.evaluation.conditions import TARGET, Disturbance, disturbed_view, reference_view
from base_station.evaluation.tracker_benchmark import Sitting
from base_station.evaluation.worlds import generated_world
from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform import alignment_kernels, cells, kernels, reference, resemblance
from base_station.trackers.ztransform.alignment import Aligner, AlignmentSettings
from base_station.trackers.ztransform.appearance import appearances
from base_station.trackers.ztransform.boxes import sample_boxes
from base_station.trackers.ztransform.outline import lens_of
from base_station.trackers.ztransform.pieces import count_votes
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.signature import SignatureReader, SignatureSettings
from base_station.types import TrackingState

CAMERA = PinholeCamera.with_fov(640, 480)
LENS = lens_of(CAMERA, curved=False)
PLACEMENT = np.array([*TARGET.center_px, TARGET.width, TARGET.height, 0.0])


@pytest.fixture(scope="module")
def worlds():
    return [generated_world(seed) for seed in (40, 41)]


@pytest.fixture(scope="module")
def aligner(worlds):
    aligner = Aligner(AlignmentSettings(), SignatureReader(SignatureSettings()))
    aligner.seen = Pyramid(reference_view(worlds[0]))
    aligner.learn(aligner.seen, PLACEMENT, LENS)
    return aligner


def patches(seed, cells=24):
    """A smooth patch, and the same in other light, with noise, and a corner covered."""
    rng = np.random.default_rng(seed)
    learned = rng.normal(128, 30, (cells, cells)).cumsum(0).cumsum(1)
    learned = ((learned - learned.mean()) / learned.std() * 40 + 128).astype(np.float32)
    patch = (0.7 * learned + 20 + rng.normal(0, 2, learned.shape)).astype(np.float32)
    patch[: cells // 3, : cells // 2] = rng.normal(100, 30, (cells // 3, cells // 2))
    return learned, patch


def as_patch(cut, blocks):
    """Undoes `reference.blocks_of`."""
    side = round(cut.shape[-1] ** 0.5)
    square = cut.reshape(blocks, blocks, side, side).swapaxes(1, 2)
    return np.ascontiguousarray(square.reshape(blocks * side, blocks * side))


def directions_of(patch):
    slopes, scales = np.empty((2, *patch.shape), np.float32), np.empty_like(patch)
    resemblance.slope_directions(patch, slopes, scales)
    return slopes, scales


@pytest.mark.parametrize("seed", range(4))
def test_kernels_are_their_definitions(seed):
    learned, patch = patches(seed)
    rng, blocks = np.random.default_rng(seed), 6
    cut, seen, shown = reference.blocks_of(patch, blocks), np.ones(patch.shape, np.uint8), np.empty(36, np.uint8)
    seen[3:5, 10], seen[:, -1] = 0, 0
    alignment_kernels.are_shown(seen, shown)
    np.testing.assert_array_equal(shown == 1, reference.blocks_of(seen, blocks).all(1))
    learned_cut = reference.blocks_of(learned, blocks)
    learned_cut -= learned_cut.mean(1, keepdims=True)
    energies = (learned_cut**2).sum(1)
    changes = rng.normal(0, 9, (36, 7, cut.shape[1])).astype(np.float32)
    changes -= changes.mean(2, keepdims=True)
    prior, step, strong = np.array([1e3, 1e3, 1e2, 1e2, 10, 4, 4]), np.zeros(5), float(np.median(energies))
    deviations, compared = np.empty_like(patch), np.empty((2, 36), np.float32)
    compare = shown, as_patch(learned_cut, blocks), deviations, compared
    alignment_kernels.compare_blocks(patch, *compare)
    away = cut - cut.mean(1, keepdims=True)
    np.testing.assert_allclose(deviations, as_patch(away, blocks), atol=1e-3)
    both, whole = away[shown == 1], learned_cut[shown == 1]
    alike = (both * whole).sum() / np.sqrt((both**2).sum() * (whole**2).sum())
    assert alignment_kernels.likeness(compared, energies) == pytest.approx(alike, abs=1e-3)
    planes, products = [as_patch(changes[:, k], blocks) for k in range(7)], np.einsum("bki,bji->kjb", changes, changes)
    gains, pairs = np.empty(36, np.float32), np.ascontiguousarray(products[np.tril_indices(7)])
    usual = alignment_kernels.weigh_blocks(deviations, compared, energies, strong, gains)
    alignment_kernels.least_squares(deviations, gains, usual, np.stack(planes), pairs, prior, step)
    expected = reference.robust_step(cut.astype(float), shown == 1, learned_cut, changes, prior)
    np.testing.assert_allclose(step, expected[:5], rtol=2e-3, atol=1e-5)
    for found, plain in zip(directions_of(patch), reference.slope_directions(patch.astype(float)), strict=True):
        np.testing.assert_allclose(found, plain, rtol=1e-4, atol=1e-4)
    then = directions_of(learned)[0]
    alignment_kernels.compare_blocks(patch, np.ones(36, np.uint8), *compare[1:])
    then_energies = sum((reference.blocks_of(slopes, blocks) ** 2).sum(1) for slopes in then)
    for noise in (0.0, 2.0, 20.0):
        like, alike = resemblance.resemblance(patch, compared, energies, then, then_energies, 0.5, 0.7, noise)
        assert like == pytest.approx(reference.resemblance(patch, learned, blocks, 0.5, noise), abs=1e-3)
    assert 0.5 < alike < 0.95


def test_no_block_in_the_frame_is_no_step():
    deviations, nothing = np.zeros((24, 24), np.float32), np.full((2, 36), -1, np.float32)
    energies, gains = np.ones((2, 36), np.float32)
    assert alignment_kernels.weigh_blocks(deviations, nothing, energies, 1.0, gains) == 0


def test_votes_are_their_definition():
    learned, patch = patches(1, 12)
    window = np.random.default_rng(0).normal(128, 30, (17, 17)).astype(np.float32)
    window[2:14, 4:16] = patch
    votes = np.empty((6, 6), np.float32)
    count_votes(window, learned, 4, np.float32(5), votes)
    np.testing.assert_allclose(votes, reference.count_votes(window.astype(float), learned, 4, 5), rtol=1e-3, atol=1e-3)
    assert divmod(int(votes.argmax()), 6) == (2, 4)


@pytest.mark.parametrize("keystone", [0.0, 0.004, 0.11, -0.2])
@pytest.mark.parametrize("size", [(240, 180), (30, 41), (520, 300)])
def test_cells_are_means_of_pixels(worlds, keystone, size):
    image, horizon_px = reference_view(worlds[0]), 231.3
    placement, patch = np.array([322.8, 231.8, *size, keystone]), np.empty((48, 48), np.float32)
    assert cells.read_inside(image, placement, horizon_px, patch)
    np.testing.assert_allclose(patch, reference.cell_means(image, horizon_px, placement, 48), atol=2e-3)
    if abs(keystone) < 0.01:  # there cells are next to upright boxes
        boxes, seen = np.empty_like(patch), np.empty(patch.shape, np.uint8)
        lens = LENS * (1, 1, 1, 0) + (0, 0, 0, horizon_px)
        assert sample_boxes(*Pyramid(image).sums(1.0), lens, placement, boxes, seen) == 1
        np.testing.assert_allclose(patch, boxes, atol=2e-3 if not keystone else 1)


@pytest.mark.parametrize("placement", [(100, 240, 240, 180, 0), (320, 450, 100, 80, 0), (320, 240, 200, 100, 2.1)])
def test_what_sticks_out_is_not_read(placement):
    placement, image = np.array(placement, float), np.full((480, 640), 255, np.uint8)
    assert not cells.read_inside(image, placement, 239.5, np.empty((48, 48), np.float32))


def test_reading_is_exact_at_the_frame_s_very_edge():
    image = np.random.default_rng(0).integers(0, 255, (96, 144), np.uint8)
    placement, patch = np.array([71.5, 47.5, 144, 96, 0]), np.empty((48, 48), np.float32)
    assert cells.read_inside(image, placement, 47.5, patch)
    np.testing.assert_allclose(patch, image.reshape(48, 2, 48, 3).mean((1, 3)), atol=1e-3)


@pytest.mark.parametrize(
    ("disturbance", "left"),
    [
        (Disturbance(gamma=1.3), 0.05),
        (Disturbance(gamma=0.7), 0.15),
        (Disturbance(gradient=30), 0.1),
        (Disturbance(blur_px=9), 0.25),
    ],
)
def test_appearance_explains_what_light_and_blur_change(worlds, disturbance, left):
    """Least squares with an offset and a gain leave a misfit; with the learned changes besides, little of it."""

    def read(pyramid):
        patch = np.empty((48, 48), np.float32)
        assert cells.read_inside(pyramid.image, PLACEMENT, LENS[3], patch)
        return patch

    learned = Pyramid(reference_view(worlds[0]))
    patch, rng = read(learned).ravel(), np.random.default_rng(0)
    seen = read(Pyramid(disturbed_view(worlds[0], disturbance, rng))).ravel()
    plain = [np.ones_like(patch), patch]
    looks = [look.ravel() for look in appearances(learned, PLACEMENT, read)]
    misfits = []
    for known in (plain, plain + looks):
        found = np.linalg.lstsq(np.stack(known, 1), seen, rcond=None)[0]
        misfits.append(((seen - np.stack(known, 1) @ found) ** 2).sum())
    assert misfits[1] < left * misfits[0]


@pytest.mark.parametrize(
    ("disturbance", "px"),
    [
        (Disturbance(dx=3.7), 0.015),
        (Disturbance(dx=-20.21, noise=10), 0.06),
        (Disturbance(dx=8.4, gain=0.5, offset=30), 0.03),
        (Disturbance(dx=8.4, gamma=1.8), 0.01),
        (Disturbance(dx=8.4, gamma=0.5), 0.01),
        (Disturbance(dx=-3.3, gradient=40), 0.01),
        (Disturbance(dx=5.6, blur_px=9), 0.03),
        (Disturbance(dx=-6.1, zoom=1.2), 0.03),
    ],
)
def test_it_settles_where_the_target_is(worlds, aligner, disturbance, px):
    d, rng = disturbance, np.random.default_rng(0)
    there = PLACEMENT * np.array([1, 1, d.zoom, d.zoom, 0]) + np.array([d.dx, 0, 0, 0, 0])
    pyramid = Pyramid(disturbed_view(worlds[0], d, rng))
    found = aligner.settle(pyramid, there + np.array([0.4, -0.3, 0.6, 0.5, 0.002]), LENS)
    assert np.abs(found.placement - there)[:2].max() < px
    assert found.placement[3] / there[3] == pytest.approx(1, abs=1e-3)
    assert found.confidence > 0.93
    assert (found.share, found.alike > 0.97) == (1, True)


def plainly_settled(aligner, pyramid, placement):
    """`Aligner.settle`, step by step in plain numpy; of a target that lies in the frame, confidence too."""
    settings, reader, fine = aligner._settings, aligner._reader, aligner._fine
    placement, confidence, before = placement.copy(), None, None
    if reader.means(pyramid, placement, LENS, reader.cells)[2] == 1:
        rough, patch = aligner._rough, reference.cell_means(pyramid.image, LENS[3], placement, reader.cells // 2)
        learned, _, _, *changes = (reference.blocks_of(plane, settings.blocks) for plane in rough.planes)
        cut, shown = reference.blocks_of(patch, settings.blocks), np.ones(settings.blocks**2, bool)
        step = reference.robust_step(cut, shown, learned, np.stack(changes, 1), rough.prior)
        kernels.move(placement, step, settings.largest_step)
    for turn in range(settings.steps + 1):
        patch, seen, share = reader.means(pyramid, placement, LENS, reader.cells)
        if turn == settings.steps:
            break
        cut, shown = (reference.blocks_of(p, settings.blocks) for p in (patch.astype(float), seen))
        learned, _, _, *changes = (reference.blocks_of(plane, settings.blocks) for plane in fine.planes)
        step = reference.robust_step(cut, shown.all(1), learned, np.stack(changes, 1), fine.prior)[:5]
        long_px = np.hypot(step[0] * placement[2], step[1] * placement[3])
        then, now = (blocks - blocks.mean(1, keepdims=True) for blocks in (learned[shown.all(1)], cut[shown.all(1)]))
        unlike = 1 - (then * now).sum() / np.sqrt((then**2).sum() * (now**2).sum())
        if turn > 0:
            step = reference.follow_on(step, before, placement[2:4])
        before = step
        kernels.move(placement, step, settings.largest_step)
        if long_px < settings.repeat_px and (turn > 0 or long_px * unlike < settings.exact_px):
            break
    if share == 1:
        learned = reader.means(aligner.seen, PLACEMENT, LENS, reader.cells)[0]
        confidence = reference.resemblance(patch, learned, settings.blocks, settings.judged_part, 0.0)
        pixels = placement[2] * placement[3] / reader.cells**2
        if confidence < settings.noisy_below and pixels >= settings.fewest_pixels:
            noise = reference.pixel_noise(pyramid.image, placement) / np.sqrt(pixels)
            confidence = reference.resemblance(patch, learned, settings.blocks, settings.judged_part, noise)
    return placement, confidence, share


@pytest.mark.parametrize("dx", [0, 3.7, -150.3, -230.6, 250.2])
@pytest.mark.parametrize("noise", [0, 12, 40])
def test_settling_in_one_call_is_settling_step_by_step(worlds, aligner, dx, noise):
    view = disturbed_view(worlds[0], Disturbance(dx=dx, noise=noise), np.random.default_rng(3))
    start = PLACEMENT + np.array([dx + 1.4, -1.3, 0.9, 0.5, 0.004])
    placement, confidence, share = plainly_settled(aligner, Pyramid(view), start)
    found = aligner.settle(Pyramid(view), start, LENS)
    np.testing.assert_allclose(found.placement, placement, rtol=1e-5, atol=1e-4)
    assert found.share == share
    if confidence is not None:
        assert found.confidence == pytest.approx(confidence, abs=1e-3)


@pytest.mark.parametrize(("off_px", "is_found"), [(0.0, True), (3.0, True), (12.0, False), (60.0, False)])
def test_a_target_that_should_be_near_is_near_or_not_found(worlds, aligner, off_px, is_found):
    there = Pyramid(disturbed_view(worlds[0], Disturbance(dx=7.3, noise=3), np.random.default_rng(1)))
    expected = PLACEMENT + np.array([7.3 - off_px, 0.4, 1, -1, 0])
    found = aligner.settle(there, expected, LENS, is_near=True)
    assert (found.confidence > 0.9) == is_found
    assert found.confidence == 0 or found.placement[0] - PLACEMENT[0] == pytest.approx(7.3, abs=0.05)


def test_a_covered_quarter_is_left_out(worlds, aligner):
    """From two cells away, whatever part it is; and it is told how much of it is seen."""
    cover = worlds[1].view()
    for seed in range(6):
        view = disturbed_view(worlds[0], Disturbance(dx=5, hidden_share=0.25), np.random.default_rng(seed), cover=cover)
        found = aligner.approach(Pyramid(view), PLACEMENT + np.array([-2, 3, 4, 0, 0]), LENS)
        assert found.placement[0] - PLACEMENT[0] == pytest.approx(5, abs=0.05)
        assert found.confidence > 0.75
        assert 0.5 < found.alike < 0.85


def test_a_mirror_image_is_not_alike(worlds, aligner):
    found = aligner.settle(Pyramid(np.ascontiguousarray(reference_view(worlds[0])[:, ::-1])), PLACEMENT, LENS)
    assert found.confidence < 0.3


def test_the_tracker_finds_a_target_that_is_suddenly_a_quarter_covered(worlds):
    cover, hits = worlds[1].view(), 0
    rng = np.random.default_rng(5)
    with Sitting("ztransform", reference_view(worlds[0])) as sitting:
        for dx in (-45, -20, 0, 15, 30, 48):
            view = disturbed_view(worlds[0], Disturbance(dx=dx, hidden_share=0.25), rng, cover=cover)
            result, _ = sitting.surprise(view)
            hits += result.state is TrackingState.TRACKING and abs(result.shift_px - dx) < 0.1
    assert hits >= 5
