"""Similarities of space (Sim3): rotation, translation and scale, seven degrees of freedom.

A monocular map has no scale of its own and drifts in it too, so what joins two ends of a loop is a similarity. It is a
4x4 matrix [s R, t; 0, 1] named `target_from_source`; any number of them is an array (..., 4, 4), and they are chained
by matrix products. The tangent is (rotation vector, translation part, log of scale).

Between two keyframes it is found from map points that both of them see: three pairs give a candidate (Umeyama, PAMI
1991), the candidate that most pairs agree with in both pictures wins (RANSAC), and it is refined on the distances in
both pictures (Horn, JOSA 1987, did the closed form first; Mur-Artal and Tardos, T-RO 2017, for the check).
Observations are in normalised image coordinates (x/z, y/z), so no camera is needed here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CHI2_99_2DOF = 9.21
"""A squared distance in units of its variance is above this for one correct observation in a hundred."""
TINY = 1e-12
PREVIEW_PAIRS, PREVIEW_KEPT = 50, 30
"""Candidates are compared by so many pairs first, and so many of them are then compared by all pairs."""


@dataclass(frozen=True, kw_only=True)
class Sim3Settings:
    """How a similarity between two keyframes is searched for."""

    samples: int = 300
    """Candidates that are tried, each from three pairs. With a third of the pairs right, 300 hold an all-right one with
    probability 0.99999."""
    least_inliers: int = 12
    """With fewer pairs that agree there is no similarity."""
    rounds: int = 10
    """Of the refinement, at the most."""
    scales: tuple[float, float] = (0.05, 20.0)
    """Beyond these a candidate is not believed."""
    seed: int = 0


@dataclass(frozen=True)
class Sim3Estimate:
    """`a_from_b`: 4x4. `inliers`: (n,) bool, the pairs that agree with it in both pictures."""

    a_from_b: np.ndarray
    inliers: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Sighted:
    """Map points as one keyframe has them: pair n of one keyframe is the same thing as pair n of the other.

    `points`: (n, 3) in the keyframe's camera coordinates. `seen`: (n, 2), where its picture shows them, normalised.
    `sigma`: (n,), the standard deviation of that, normalised (px of the feature's pyramid level / focal length).
    """

    points: np.ndarray
    seen: np.ndarray
    sigma: np.ndarray


def similarity(scale: float, rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """4x4 of its parts: x -> scale * rotation @ x + translation."""
    matrix = np.eye(4)
    matrix[:3, :3] = scale * rotation
    matrix[:3, 3] = translation
    return matrix


def scale_of(matrix: np.ndarray) -> np.ndarray:
    """Scales (...) of similarities (..., 4, 4)."""
    return np.asarray(np.cbrt(np.linalg.det(matrix[..., :3, :3])))


def rotation_of(matrix: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) of similarities (..., 4, 4)."""
    return np.asarray(matrix[..., :3, :3] / scale_of(matrix)[..., None, None])


def inverse(matrix: np.ndarray) -> np.ndarray:
    """source_from_target of target_from_source, (..., 4, 4)."""
    turned = np.swapaxes(matrix[..., :3, :3], -1, -2) / (scale_of(matrix) ** 2)[..., None, None]
    out = np.zeros_like(matrix)
    out[..., :3, :3] = turned
    out[..., :3, 3] = -(turned @ matrix[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1
    return out


def transform(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., n, 3) by similarities (..., 4, 4)."""
    return np.asarray(points @ np.swapaxes(matrix[..., :3, :3], -1, -2) + matrix[..., None, :3, 3])


def as_pose(world_from_camera: np.ndarray) -> np.ndarray:
    """The rigid pose, cam_from_world (..., 4, 4), of a camera whose place in the world is a similarity.

    Pictures do not show a camera's own scale: (x/s, y/s, z/s) looks the same as (x, y, z).
    """
    rigid = inverse(world_from_camera)
    rigid[..., :3, :] *= scale_of(world_from_camera)[..., None, None]
    return rigid


def exp(tangent: np.ndarray) -> np.ndarray:
    """4x4 of (7,): rotation vector (rad), translation, log of scale. The translation is not turned or scaled: this is
    the retraction that `refine` steps with, not the group's own exponential."""
    return similarity(float(np.exp(tangent[6])), rotation_matrix(tangent[:3]), tangent[3:6])


def rotation_matrix(vector: np.ndarray) -> np.ndarray:
    """3x3 of a rotation vector (axis times angle in rad), by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    cross = _cross(vector)
    if angle < 1e-8:
        return np.asarray(np.eye(3) + cross)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross)


def align(source: np.ndarray, target: np.ndarray, *, with_scale: bool = True) -> np.ndarray:
    """target_from_source (..., 4, 4) that brings source points nearest to target points in the least squares sense.

    `source`, `target`: (..., n, 3), n >= 3, not all on a line. Without scale it is 1. Umeyama, PAMI 1991.
    Raises ValueError when there are fewer than three points.
    """
    if source.shape != target.shape or source.shape[-2] < 3:
        raise ValueError(f"three pairs of points are needed, not {source.shape} and {target.shape}")
    source_mean, target_mean = source.mean(-2, keepdims=True), target.mean(-2, keepdims=True)
    centred, wanted = source - source_mean, target - target_mean
    u, spread, vt = np.linalg.svd(np.swapaxes(wanted, -1, -2) @ centred)
    mirrored = np.linalg.det(u) * np.linalg.det(vt) < 0
    u[..., :, 2] = np.where(mirrored[..., None], -u[..., :, 2], u[..., :, 2])
    spread[..., 2] = np.where(mirrored, -spread[..., 2], spread[..., 2])
    rotation = u @ vt
    out = np.zeros((*source.shape[:-2], 4, 4))
    scale = spread.sum(-1) / np.maximum((centred**2).sum((-1, -2)), TINY) if with_scale else np.ones(spread.shape[:-1])
    out[..., :3, :3] = scale[..., None, None] * rotation
    out[..., :3, 3] = target_mean[..., 0, :] - (out[..., :3, :3] @ source_mean[..., 0, :, None])[..., 0]
    out[..., 3, 3] = 1
    return out


def estimate(a: Sighted, b: Sighted, settings: Sim3Settings | None = None) -> Sim3Estimate | None:
    """The similarity between two keyframes from pairs of which many may be wrong; None when too few agree."""
    settings = settings or Sim3Settings()
    count = len(a.points)
    if count < max(settings.least_inliers, 3):
        return None
    rng = np.random.default_rng(settings.seed)
    picks = rng.random((settings.samples, count)).argpartition(3, axis=1)[:, :3]
    candidates = align(b.points[picks], a.points[picks])
    scales = scale_of(candidates)
    believed = np.isfinite(candidates).all((1, 2)) & (scales > settings.scales[0]) & (scales < settings.scales[1])
    candidates = candidates[believed]
    if not len(candidates):
        return None
    some = rng.permutation(count)[:PREVIEW_PAIRS]  # most candidates are so wrong that some pairs tell it
    promise = agreement(candidates, _part(a, some), _part(b, some)).sum(1)
    candidates = candidates[np.argsort(-promise, kind="stable")[:PREVIEW_KEPT]]
    agreeing = agreement(candidates, a, b)
    best = int(agreeing.sum(1).argmax())
    a_from_b, inliers = candidates[best], agreeing[best]
    for _ in range(2):  # the pairs that agree may be others after the refinement
        if inliers.sum() < settings.least_inliers:
            return None
        a_from_b = refine(a_from_b, _part(a, inliers), _part(b, inliers), rounds=settings.rounds)
        inliers = agreement(a_from_b[None], a, b)[0]
    return Sim3Estimate(a_from_b, inliers) if inliers.sum() >= settings.least_inliers else None


def agreement(a_from_b: np.ndarray, a: Sighted, b: Sighted) -> np.ndarray:
    """(m, n) bool: which pairs lie in front of both cameras and where both pictures show them, for (m, 4, 4)."""
    good = np.ones((len(a_from_b), len(a.points)), bool)
    for matrix, points, shown in ((a_from_b, b.points, a), (inverse(a_from_b), a.points, b)):
        here = transform(matrix, points)
        depth = here[..., 2]
        off = here[..., :2] / np.where(depth > TINY, depth, np.inf)[..., None] - shown.seen
        good &= (depth > TINY) & ((off**2).sum(-1) < CHI2_99_2DOF * shown.sigma**2)
    return good


def refine(a_from_b: np.ndarray, a: Sighted, b: Sighted, *, rounds: int = 10) -> np.ndarray:
    """Least squares on the distances in both pictures, with Huber's weights; Levenberg and Marquardt's steps."""
    damping, cost = 1e-4, _Residuals(a_from_b, a, b)
    for _ in range(rounds):
        hessian, gradient = cost.normal_equations()
        step = -np.linalg.solve(hessian + damping * np.diag(np.diag(hessian)), gradient)
        tried = _Residuals(exp(step) @ cost.a_from_b, a, b)
        if tried.cost < cost.cost:
            gained = cost.cost - tried.cost
            cost, damping = tried, max(damping / 10, 1e-9)
            if gained < 1e-9 * tried.cost or np.abs(step).max() < 1e-10:
                break
        else:
            damping *= 10
            if damping > 1e6:
                break
    return cost.a_from_b


class _Residuals:
    """Distances in both pictures in units of sigma, and how they change with a step exp(d) on the left."""

    def __init__(self, a_from_b: np.ndarray, a: Sighted, b: Sighted) -> None:
        self.a_from_b = a_from_b
        self._scale, self._rotation = float(scale_of(a_from_b)), rotation_of(a_from_b)
        self._sides = (
            (transform(a_from_b, b.points), a),
            (transform(inverse(a_from_b), a.points), b),
        )
        self._off = [self._distances(here, shown) for here, shown in self._sides]
        squares = np.concatenate([(off**2).sum(1) for off in self._off])
        bound = CHI2_99_2DOF
        far = squares > bound
        self.cost = float(np.where(far, 2 * np.sqrt(bound * squares) - bound, squares).sum())
        self._weights = np.where(far, np.sqrt(bound / np.maximum(squares, TINY)), 1.0)
        self._a_points = a.points

    @staticmethod
    def _distances(here: np.ndarray, shown: Sighted) -> np.ndarray:
        depth = np.maximum(here[:, 2], TINY)
        return np.asarray((here[:, :2] / depth[:, None] - shown.seen) / shown.sigma[:, None])

    def normal_equations(self) -> tuple[np.ndarray, np.ndarray]:
        """Hessian (7, 7) and gradient (7,)."""
        (in_a, shown_a), (in_b, shown_b) = self._sides
        # exp(d) moves a point x of camera a to x + w x x + t + l x, and a_from_b's inverse turns that around.
        moved_in_a = _generators(in_a)
        moved_in_b = -np.einsum("ij,njk->nik", self._rotation.T / self._scale, _generators(self._a_points))
        jacobian = np.concatenate(
            [
                _projected(in_a, moved_in_a) / shown_a.sigma[:, None, None],
                _projected(in_b, moved_in_b) / shown_b.sigma[:, None, None],
            ]
        )
        off = np.concatenate(self._off)
        weighted = jacobian * self._weights[:, None, None]
        return np.einsum("nij,nik->jk", weighted, jacobian), np.einsum("nij,ni->j", weighted, off)


def _generators(points: np.ndarray) -> np.ndarray:
    """(n, 3, 7): how points (n, 3) move with each of the seven numbers of a small step."""
    out = np.zeros((len(points), 3, 7))
    x, y, z = points.T
    out[:, 0, 1], out[:, 0, 2] = z, -y
    out[:, 1, 0], out[:, 1, 2] = -z, x
    out[:, 2, 0], out[:, 2, 1] = y, -x
    out[:, [0, 1, 2], [3, 4, 5]] = 1
    out[:, :, 6] = points
    return out


def _projected(points: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """(n, 2, 7): how (x/z, y/z) moves when a point moves so."""
    depth = np.maximum(points[:, 2], TINY)[:, None, None]
    plane = points[:, :2, None] / depth
    return np.asarray((moved[:, :2] - plane * moved[:, 2:]) / depth)


def _cross(vector: np.ndarray) -> np.ndarray:
    x, y, z = vector
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def _part(sighted: Sighted, chosen: np.ndarray) -> Sighted:
    return Sighted(points=sighted.points[chosen], seen=sighted.seen[chosen], sigma=sighted.sigma[chosen])
