"""The patch held against the learned one: kernels as defined, exact, not misled by a cover or a mirror image."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.evaluation.conditions import TARGET, Disturbance, disturbed_view, reference_view
from base_station.evaluation.tracker_benchmark import Sitting
from base_station.evaluation.worlds import generated_world
from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform import alignment_kernels, kernels, reference
from base_station.trackers.ztransform.alignment import Aligner, AlignmentSettings
from base_station.trackers.ztransform.boxes import IN_FRAME, lies, sample_boxes, sample_inside
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


@pytest.mark.parametrize("seed", range(4))
def test_kernels_are_their_definitions(seed):
    learned, patch = patches(seed)
    rng, blocks = np.random.default_rng(seed), 6
    cut = alignment_kernels.cut_blocks(patch, blocks)
    np.testing.assert_array_equal(cut, reference.blocks_of(patch, blocks))
    shown = rng.random(len(cut)) > 0.1
    deviations = reference.blocks_of(learned, blocks)
    deviations -= deviations.mean(1, keepdims=True)
    energies = (deviations**2).sum(1)
    changes = rng.normal(0, 9, (len(cut), 5, cut.shape[1])).astype(np.float32)
    changes -= changes.mean(2, keepdims=True)
    prior, step = np.array([1e3, 1e3, 1e2, 1e2, 10]), np.zeros(5)
    seen = np.repeat(shown[:, None].astype(np.uint8), cut.shape[1], 1)
    compared = alignment_kernels.compare_blocks(cut, seen, deviations, energies)
    hessians = np.einsum("bki,bji->bkj", changes, changes)
    assert alignment_kernels.robust_step(cut, compared, deviations, energies, changes, hessians, prior, step)
    np.testing.assert_allclose(
        step, reference.robust_step(cut.astype(float), shown, deviations, changes, prior), rtol=2e-3, atol=1e-5
    )
    slopes = alignment_kernels.slope_directions(patch)
    for found, plain in zip(slopes, reference.slope_directions(patch.astype(float)), strict=True):
        np.testing.assert_allclose(found, plain, rtol=1e-4, atol=1e-4)
    then = np.stack([alignment_kernels.cut_blocks(s, blocks) for s in alignment_kernels.slope_directions(learned)[0]])
    compared = alignment_kernels.compare_blocks(cut, np.ones_like(seen), deviations, energies)
    for noise in (0.0, 2.0, 20.0):
        like, alike = alignment_kernels.resemblance(
            patch, compared, energies, then, (then**2).sum((0, 2)), 0.5, 0.7, noise
        )
        assert like == pytest.approx(reference.resemblance(patch, learned, blocks, 0.5, noise), abs=1e-3)
    assert 0.5 < alike < 0.95


def test_votes_are_their_definition():
    learned, patch = patches(1, 12)
    window = np.random.default_rng(0).normal(128, 30, (17, 17)).astype(np.float32)
    window[2:14, 4:16] = patch
    votes = np.empty((6, 6), np.float32)
    count_votes(window, learned, 4, np.float32(5), votes)
    np.testing.assert_allclose(votes, reference.count_votes(window.astype(float), learned, 4, 5), rtol=1e-3, atol=1e-3)
    assert divmod(int(votes.argmax()), 6) == (2, 4)


@pytest.mark.parametrize("keystone", [0.0, 0.11, -0.2])
def test_reading_inside_of_the_frame_is_reading(worlds, keystone):
    reader, pyramid = SignatureReader(SignatureSettings()), Pyramid(reference_view(worlds[0]))
    placement = PLACEMENT + np.array([3.3, -7.7, 13, -9, keystone])
    quick, plain, seen = np.empty((48, 48), np.float32), np.empty((48, 48), np.float32), np.empty((48, 48), np.uint8)
    sample_boxes(*reader.source(pyramid, placement, LENS, whole=True), LENS, placement, plain, seen)
    part = reader.source(Pyramid(pyramid.image), placement, LENS)
    assert lies(*part, LENS, placement) == IN_FRAME
    sample_inside(*part, LENS, placement, quick)
    np.testing.assert_allclose(quick, plain, atol=1e-3)


@pytest.mark.parametrize(
    ("disturbance", "px"),
    [
        (Disturbance(dx=3.7), 0.015),
        (Disturbance(dx=-20.21, noise=10), 0.06),
        (Disturbance(dx=8.4, gain=0.5, offset=30), 0.03),
        (Disturbance(dx=8.4, gamma=1.8), 0.05),
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
    placement, confidence = placement.copy(), None
    for turn in range(settings.steps + 1):
        patch, seen, share = reader.means(pyramid, placement, LENS, reader.cells)
        if turn == settings.steps:
            break
        cut, shown = (reference.blocks_of(p, settings.blocks) for p in (patch.astype(float), seen))
        step = reference.robust_step(cut, shown.all(1), fine.learned, fine.changes, aligner._prior)
        kernels.move(placement, step, settings.largest_step)
        if np.hypot(step[0] * placement[2], step[1] * placement[3]) < settings.repeat_px:
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
