"""Similarities between keyframes against synthetic truth: exact, noisy, with wrong pairs, and where there is none."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.sim3 import (
    Sighted,
    Sim3Settings,
    align,
    as_pose,
    estimate,
    exp,
    inverse,
    refine,
    rotation_matrix,
    rotation_of,
    scale_of,
    similarity,
    transform,
)

FOCAL_PX = 500.0


def angle_deg(one, other):
    return np.degrees(np.arccos(np.clip((np.trace(one.T @ other) - 1) / 2, -1, 1)))


def project(points):
    return points[:, :2] / points[:, 2:]


def two_keyframes(seed, *, count=120, noise_px=0.0, depth_noise=0.0, wrong=0.0):
    """Maps of the same points, seen by two cameras that are a bit apart; the true a_from_b; which pairs are right."""
    rng = np.random.default_rng(seed)
    rotation = rotation_matrix(rng.normal(0, 0.15, 3))
    a_from_b = similarity(float(rng.uniform(0.5, 2.0)), rotation, rng.normal(0, 0.3, 3))
    in_a = np.column_stack([rng.uniform(-1, 1, (count, 2)), rng.uniform(2, 5, count)]) * [1.5, 1.0, 1.0]
    in_b = transform(inverse(a_from_b), in_a)
    seen_a = project(in_a) + rng.normal(0, noise_px / FOCAL_PX, (count, 2))
    seen_b = project(in_b) + rng.normal(0, noise_px / FOCAL_PX, (count, 2))
    in_a = in_a * (1 + rng.normal(0, depth_noise, (count, 1)))
    in_b = in_b * (1 + rng.normal(0, depth_noise, (count, 1)))
    right = np.ones(count, bool)
    right[: int(wrong * count)] = False
    shuffled = np.roll(np.arange(int(wrong * count)), 1)
    in_b[~right], seen_b[~right] = in_b[shuffled], seen_b[shuffled]
    sigma = np.full(count, 1.0 / FOCAL_PX)
    a, b = Sighted(points=in_a, seen=seen_a, sigma=sigma), Sighted(points=in_b, seen=seen_b, sigma=sigma)
    return a, b, a_from_b, right


def errors(found, truth):
    """Rotation in degrees, scale and translation as shares."""
    apart = np.linalg.norm(found[:3, 3] - truth[:3, 3])
    return angle_deg(rotation_of(found), rotation_of(truth)), abs(scale_of(found) / scale_of(truth) - 1), apart


def test_the_group_keeps_its_laws():
    rng = np.random.default_rng(3)
    one, two = (exp(rng.normal(0, 0.4, 7)) for _ in range(2))
    assert inverse(one) @ one == pytest.approx(np.eye(4), abs=1e-12)
    assert scale_of(one @ two) == pytest.approx(scale_of(one) * scale_of(two))
    many = np.stack([one, two])
    assert inverse(many)[1] == pytest.approx(inverse(two))
    points = rng.normal(0, 1, (5, 3))
    assert transform(one, transform(two, points)) == pytest.approx(transform(one @ two, points))
    assert rotation_of(one) @ rotation_of(one).T == pytest.approx(np.eye(3), abs=1e-12)


def test_a_pose_shows_what_the_similarity_shows():
    """A camera with a scale of its own sees the same picture as the rigid pose made of it."""
    world_from_camera = exp(np.array([0.2, -0.1, 0.3, 1.0, 2.0, -1.0, np.log(1.7)]))
    points = np.random.default_rng(1).normal([0, 0, 6], 1, (20, 3))
    with_scale = transform(inverse(world_from_camera), points)
    rigid = transform(as_pose(world_from_camera), points)
    assert project(rigid) == pytest.approx(project(with_scale))
    assert scale_of(as_pose(world_from_camera)) == pytest.approx(1)
    assert inverse(as_pose(world_from_camera))[:3, 3] == pytest.approx(world_from_camera[:3, 3])


def test_points_are_aligned_exactly_and_never_mirrored():
    rng = np.random.default_rng(0)
    source, truth = rng.normal(0, 1, (50, 3)), exp(np.array([0.5, -1.0, 2.0, 3.0, -4.0, 5.0, np.log(3.0)]))
    assert align(source, transform(truth, source)) == pytest.approx(truth, abs=1e-10)
    assert align(source[:3], transform(truth, source[:3])) == pytest.approx(truth, abs=1e-9)
    assert scale_of(align(source, transform(truth, source), with_scale=False)) == pytest.approx(1)
    mirrored = source * [1, 1, -1]
    assert np.linalg.det(align(source, mirrored)[:3, :3]) > 0
    flat = source * [1, 1, 0]
    assert align(flat, transform(truth, flat)) == pytest.approx(truth, abs=1e-9)
    with pytest.raises(ValueError, match="three pairs"):
        align(source[:2], source[:2])


def test_noisy_points_are_aligned_as_well_as_their_number_allows():
    rng = np.random.default_rng(1)
    source, truth = rng.normal(0, 1, (400, 3)), exp(np.array([0.1, 0.2, 0.3, 1.0, 1.0, 1.0, np.log(0.5)]))
    turn, scale, apart = errors(align(source, transform(truth, source) + rng.normal(0, 0.02, (400, 3))), truth)
    assert 0.001 < turn < 0.5
    assert 1e-5 < scale < 0.01
    assert 1e-5 < apart < 0.005


@pytest.mark.parametrize("seed", range(4))
def test_exact_pairs_give_the_exact_similarity(seed):
    a, b, truth, _ = two_keyframes(seed)
    found = estimate(a, b)
    assert found is not None and found.inliers.all()
    assert found.a_from_b == pytest.approx(truth, abs=1e-7)


@pytest.mark.parametrize("wrong", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("seed", range(3))
def test_noise_and_wrong_pairs(seed, wrong):
    a, b, truth, right = two_keyframes(seed, count=200, noise_px=0.7, depth_noise=0.01, wrong=wrong)
    found = estimate(a, b)
    assert found is not None
    assert found.inliers[right].mean() > 0.85
    assert found.inliers[~right].sum() <= 3
    turn, scale, apart = errors(found.a_from_b, truth)
    assert 1e-4 < turn < 0.3
    assert 1e-6 < scale < 0.01
    assert 1e-5 < apart < 0.03


def test_refinement_comes_back_from_a_wrong_start_and_betters_the_alignment():
    a, b, truth, _ = two_keyframes(5, noise_px=0.5, depth_noise=0.05)
    start = exp(np.array([0.03, -0.02, 0.03, 0.05, -0.05, 0.05, 0.05])) @ truth
    refined = refine(start, a, b, rounds=20)
    turn, scale, _ = errors(refined, truth)
    coarse_turn, coarse_scale, _ = errors(align(b.points, a.points), truth)
    assert turn < 0.3 and turn < coarse_turn
    assert scale < 0.02 and scale < 1.5 * coarse_scale


def test_no_similarity_where_there_is_none():
    a, b, _, _ = two_keyframes(7, wrong=1.0)
    assert estimate(a, b) is None
    few_a, few_b, _, _ = two_keyframes(7, count=11)
    assert estimate(few_a, few_b) is None
    behind = Sighted(points=-a.points, seen=a.seen, sigma=a.sigma)
    assert estimate(behind, b) is None


def test_the_same_pairs_give_the_same_answer():
    a, b, _, _ = two_keyframes(2, noise_px=1.0, wrong=0.5)
    one, two = (estimate(a, b, Sim3Settings(seed=4)) for _ in range(2))
    assert one is not None and two is not None
    assert (one.a_from_b == two.a_from_b).all()
