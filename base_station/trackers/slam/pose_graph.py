"""Spreads the correction of a closed loop over all keyframes: pose graph optimization in seven degrees of freedom.

Keyframes are nodes, each a similarity `world_from_keyframe`; an edge says what `i_from_j` was measured to be. Between
neighbours that is what the map has said so far, across the loop what `sim3` has found. The optimum turns, moves and
scales every keyframe a little instead of tearing the map at one place. gtsam solves it (extra `slam`).
Source: Strasdat, Montiel and Davison, Scale drift-aware large scale monocular SLAM, RSS 2010.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from base_station.trackers.slam import libraries
from base_station.trackers.slam.sim3 import inverse, rotation_of, scale_of, similarity, transform


@dataclass(frozen=True, kw_only=True)
class PoseGraphSettings:
    """How stiff edges are, and when to end."""

    rotation_sigma_rad: float = 0.01
    """Of an edge of weight 1."""
    translation_sigma: float = 0.05
    """Of an edge of weight 1, as a share of the median length of all edges: a map has no unit of its own."""
    log_scale_sigma: float = 0.02
    """Of an edge of weight 1."""
    rounds: int = 20
    """Of Levenberg and Marquardt, at the most."""


@dataclass(frozen=True)
class Edge:
    """`i_from_j`: 4x4 similarity between nodes i and j. `weight`: how much it counts, such as the number of points
    that both keyframes see over the usual number; positive."""

    i: int
    j: int
    i_from_j: np.ndarray
    weight: float = 1.0


def optimize(
    world_from_keyframe: np.ndarray,
    edges: Sequence[Edge],
    *,
    fixed: Collection[int],
    settings: PoseGraphSettings | None = None,
) -> np.ndarray:
    """The similarities (n, 4, 4) that agree best with the edges, starting from the given ones.

    `fixed`: nodes that stay as they are, at least one. Nodes without a way to a fixed one stay too.
    Raises ValueError when an edge names a node that there is not, or nothing is fixed, and StationError without gtsam.
    """
    settings, count = settings or PoseGraphSettings(), len(world_from_keyframe)
    if not fixed or not all(0 <= node < count for node in fixed):
        raise ValueError("at least one node must be fixed, and be there")
    for edge in edges:
        if not (0 <= edge.i < count and 0 <= edge.j < count and edge.i != edge.j and edge.weight > 0):
            raise ValueError(f"no edge: {edge.i} to {edge.j} of {count} nodes, weight {edge.weight}")
    free = reachable(count, edges, fixed)
    used = [edge for edge in edges if free[edge.i]]
    if not used:
        return world_from_keyframe.copy()
    gtsam = libraries.gtsam()
    graph, start = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for node, place in zip(np.flatnonzero(free).tolist(), _as_gtsam(gtsam, world_from_keyframe[free]), strict=True):
        start.insert(node, place)
        if node in fixed:
            graph.add(gtsam.NonlinearEqualitySimilarity3(node, place))
    measured = np.stack([edge.i_from_j for edge in used])
    length = float(np.median(np.linalg.norm(measured[:, :3, 3], axis=1))) or 1.0
    sigmas = np.repeat(
        [settings.rotation_sigma_rad, settings.translation_sigma * length, settings.log_scale_sigma], [3, 3, 1]
    )
    for edge, between in zip(used, _as_gtsam(gtsam, measured), strict=True):
        noise = gtsam.noiseModel.Diagonal.Sigmas(sigmas / np.sqrt(edge.weight))
        graph.add(gtsam.BetweenFactorSimilarity3(edge.i, edge.j, between, noise))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(settings.rounds)
    result = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()
    out = world_from_keyframe.copy()
    for node in np.flatnonzero(free).tolist():
        if node not in fixed:
            found = result.atSimilarity3(node)
            out[node] = similarity(found.scale(), found.rotation().matrix(), found.scale() * found.translation())
    return out


def reachable(count: int, edges: Sequence[Edge], fixed: Collection[int]) -> np.ndarray:
    """(count,) bool: the nodes that edges join to a fixed one, and these."""
    joined = np.zeros(count, bool)
    joined[list(fixed)] = True
    ends = np.array([(edge.i, edge.j) for edge in edges], np.int64).reshape(-1, 2)
    while True:
        touched = joined[ends].any(1)
        more = ends[touched].ravel()
        if joined[more].all():
            return joined
        joined[more] = True


def spread(points: np.ndarray, owners: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Map points (n, 3) carried along by their reference keyframes, which had the places `before` and have `after`.

    `owners`: (n,), the row of each point's keyframe in `before` and `after`, both world_from_keyframe (m, 4, 4).
    """
    moved = after @ inverse(before)
    return np.asarray(transform(moved[owners], points[:, None])[:, 0])


def _as_gtsam(gtsam: Any, matrices: np.ndarray) -> list[Any]:
    """Of (n, 4, 4); gtsam's similarity is x -> s (R x + t)."""
    scales, turns = scale_of(matrices), rotation_of(matrices)
    places = matrices[:, :3, 3] / scales[:, None]
    parts = zip(turns, places, scales.tolist(), strict=True)
    return [gtsam.Similarity3(gtsam.Rot3(turn), place, scale) for turn, place, scale in parts]
