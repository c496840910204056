"""The pose graph against synthetic truth: a loop that drifted in rotation, place and scale is closed."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.trackers.slam.pose_graph import Edge, optimize, reachable, spread
from base_station.trackers.slam.sim3 import align, exp, inverse, scale_of, similarity, transform

pytest.importorskip("gtsam", reason="the extra slam (gtsam) is not installed")

COUNT = 60


def circle(count=COUNT):
    """Keyframes on a circle of radius 3, looking along it."""
    out = []
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
        out.append(similarity(1.0, turn, 3 * np.array([np.sin(angle), 0, np.cos(angle)])))
    return np.stack(out)


def drifted(truth, *, drift, noise=0.0, seed=0):
    """What odometry makes of it: every step with the same drift, and noise besides. Also the steps."""
    rng = np.random.default_rng(seed)
    places, steps = [truth[0]], []
    for i in range(len(truth) - 1):
        wrong = exp(np.asarray(drift) + rng.normal(0, noise, 7))
        step = inverse(truth[i]) @ truth[i + 1] @ wrong
        steps.append(Edge(i, i + 1, step))
        places.append(places[-1] @ step)
    return np.stack(places), steps


def place_error(found, truth):
    return float(np.sqrt(((found[:, :3, 3] - truth[:, :3, 3]) ** 2).sum(1).mean()))


def test_exact_edges_give_the_exact_places_from_a_wrong_start():
    truth = circle()
    edges = [Edge(i, (i + 1) % COUNT, inverse(truth[i]) @ truth[(i + 1) % COUNT]) for i in range(COUNT)]
    start, _ = drifted(truth, drift=[0, 0.004, 0, 0.01, 0, 0, 0.004])
    assert place_error(start, truth) > 0.3
    assert optimize(start, edges, fixed=[0]) == pytest.approx(truth, abs=1e-5)


def test_a_loop_with_drift_in_scale_is_closed():
    truth = circle()
    start, edges = drifted(truth, drift=[0, 0.002, 0, 0.003, 0, 0, 0.005], noise=0.0005)
    assert 1.2 < scale_of(start[-1]) < 1.5
    loop = Edge(COUNT - 1, 0, inverse(truth[-1]) @ truth[0], weight=4.0)
    found = optimize(start, [*edges, loop], fixed=[0])
    assert found[0] == pytest.approx(start[0])
    assert place_error(found, truth) < 0.25 * place_error(start, truth)
    gap = inverse(found[-1]) @ found[0] @ inverse(loop.i_from_j)
    assert scale_of(gap) == pytest.approx(1, abs=0.02)
    assert np.linalg.norm(gap[:3, 3]) < 0.1
    steps = np.linalg.norm(np.diff(found[:, :3, 3], axis=0), axis=1)
    assert steps.max() / steps.min() < 1.6, "the correction is not spread"


def test_noise_is_averaged_over_many_edges():
    truth, rng = circle(), np.random.default_rng(2)
    edges = []
    for i in range(COUNT):
        for ahead in (1, 2, 3, 20):
            j = (i + ahead) % COUNT
            edges.append(Edge(i, j, inverse(truth[i]) @ truth[j] @ exp(rng.normal(0, 0.004, 7))))
    start, _ = drifted(truth, drift=[0, 0.002, 0, 0.003, 0, 0, 0.002], noise=0.002)
    found = optimize(start, edges, fixed=[0])
    error = place_error(transform_all(found, truth), truth)
    assert 0.001 < error < 0.05


def transform_all(found, truth):
    """As a whole it may still be turned and scaled by the noise of the edges at the fixed node."""
    whole = align(found[:, :3, 3], truth[:, :3, 3])
    return whole @ found


def test_nodes_without_a_way_to_a_fixed_one_stay():
    truth = circle(8)
    edges = [Edge(i, i + 1, inverse(truth[i]) @ truth[i + 1]) for i in (0, 1, 2, 5, 6)]
    start = truth.copy()
    start[2, 0, 3] += 0.3
    start[6, 0, 3] += 0.3
    assert reachable(8, edges, [0]).tolist() == [True] * 4 + [False] * 4
    found = optimize(start, edges, fixed=[0])
    assert found[2] == pytest.approx(truth[2], abs=1e-6)
    assert (found[6] == start[6]).all()
    assert (optimize(start, [], fixed=[0]) == start).all()


@pytest.mark.parametrize(
    ("edges", "fixed"),
    [
        ([Edge(0, 9, np.eye(4))], [0]),
        ([Edge(1, 1, np.eye(4))], [0]),
        ([Edge(0, 1, np.eye(4), 0.0)], [0]),
        ([Edge(0, 1, np.eye(4))], []),
        ([Edge(0, 1, np.eye(4))], [5]),
    ],
)
def test_what_is_no_graph_is_refused(edges, fixed):
    with pytest.raises(ValueError, match=r"no edge|must be fixed"):
        optimize(circle(3), edges, fixed=fixed)


def test_points_go_with_their_keyframes():
    truth = circle(4)
    after = truth.copy()
    after[2] = after[2] @ exp(np.array([0.1, 0, 0, 0.2, 0, 0, 0.3]))
    points, owners = np.random.default_rng(0).normal(0, 1, (30, 3)), np.repeat([0, 2, 3], 10)
    moved = spread(points, owners, truth, after)
    assert moved[owners != 2] == pytest.approx(points[owners != 2])
    seen_before = transform(inverse(truth[2]), points[owners == 2])
    assert transform(inverse(after[2]), moved[owners == 2]) == pytest.approx(seen_before)
