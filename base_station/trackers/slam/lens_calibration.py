"""How long the focal length truly is, and whether the lens bends lines: what a whole map tells of it.

A focal length that is wrong by a percent bends a map: each of its parts fits well, and the whole does not. Printed or
assumed focal lengths are off by as much. The cost of a bundle adjustment over the focal length (fx and fy together) and
one radial coefficient is a quadric near its lowest place: seven adjustments give where that is, and how surely.

It is weighed against the calibration: `SlamCamera.focal_sigma` and `radial_sigma` say how sure that is. A map of one
straight way says little, and then the calibration stays; so it does when the correction could be chance.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from base_station.trackers.slam.bundle_kernels import adjust_with_cost
from base_station.trackers.slam.bundle_problem import BundleProblem
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.lens import Lens
from base_station.trackers.slam.local_bundle import part_of
from base_station.trackers.slam.map import Map

FEWEST, MOST, STRETCHES = 8, 100, 4
"""Keyframes that are asked: of a larger map, so many, in stretches of its way, each of which sees the same points."""
STEPS = np.array([0.01, 0.01])
"""To either side: of the zoom's logarithm, and of the radial coefficient."""
OFFSETS = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (-1, 0), (0, -1), (-1, -1)])
"""In steps, where the cost is asked for."""
FARTHEST = 3.0
"""Steps, in one round."""
ROUNDS = 10
ITERATIONS, ENOUGH = 25, 1e-6
UNCERTAINTY = 2.0
"""The errors of one point or place are alike, and say less than so many independent ones: what they leave uncertain is
taken to be so many times as much."""
WIDEST_SIGMAS = 3.0
"""Further from the calibration something else is wrong."""
SURE_SIGMAS = 2.0
"""A correction that is smaller in both may be chance."""


def calibrated(world: Map, component: int, camera: SlamCamera) -> Lens | None:
    """The lens that this map speaks for; None when that is too little, or as well the one that it has."""
    keyframes = world.keyframes_alive(component)
    sigmas = np.array([camera.focal_sigma, camera.radial_sigma])
    if len(keyframes) < FEWEST or not (sigmas > 0).all():
        return None
    keyframes = _asked(keyframes)
    part = part_of(world, keyframes[1:], keyframes[:1], world.points_alive(component))
    if part is None:
        return None
    now = Lens(*world.lens)
    problem = replace(part[0], uv_px=now.seen(part[0].uv_px, camera))
    return _most_likely(problem, camera, world.scales, np.array([math.log(now.zoom), now.radial]), sigmas)


def _asked(keyframes: np.ndarray) -> np.ndarray:
    if len(keyframes) <= MOST:
        return keyframes
    length = MOST // STRETCHES
    begins = np.linspace(0, len(keyframes) - length, STRETCHES).astype(np.int64)
    return np.concatenate([keyframes[begin : begin + length] for begin in begins])


def _most_likely(
    problem: BundleProblem, camera: SlamCamera, scales: np.ndarray, start: np.ndarray, sigmas: np.ndarray
) -> Lens | None:
    """`problem`: with keypoints as the camera's own calibration has them; `start`: zoom's logarithm and radial."""
    prior = np.diag(1.0 / sigmas**2)
    place, near = start.copy(), False
    for _ in range(ROUNDS):
        problem, costs = _costs_about(problem, camera, scales, place)
        if not np.isfinite(costs).all():
            return None
        gradient, curve = _quadric(costs)
        if not (np.linalg.eigvalsh(curve) > 0).all():  # far from the lowest place: downhill
            lowest = int(np.argmin(costs))
            if lowest == 0:
                return None
            place = place + OFFSETS[lowest] * STEPS
            continue
        information = curve / (2.0 * UNCERTAINTY**2) + prior  # a chi-square is twice a log likelihood
        step = -np.linalg.solve(information, gradient / (2.0 * UNCERTAINTY**2) + prior @ place)
        close, near = near, bool((np.abs(step) <= STEPS).all())
        if near and (close or (np.abs(step) <= STEPS / 3.0).all()):  # the quadric about a near place is the better one
            place = place + step
            changed = place - start
            if (np.abs(place) > WIDEST_SIGMAS * sigmas).any() or changed @ information @ changed < SURE_SIGMAS**2:
                return None
            return Lens(math.exp(place[0]), float(place[1]))
        place = place + np.clip(step, -FARTHEST * STEPS, FARTHEST * STEPS)
    return None


def _costs_about(
    problem: BundleProblem, camera: SlamCamera, scales: np.ndarray, place: np.ndarray
) -> tuple[BundleProblem, np.ndarray]:
    """The problem solved at `place`, and the lowest costs there and at all other `OFFSETS`, (7,)."""
    middle, solved = _adjusted(problem, camera, scales, place)
    around = [_adjusted(solved, camera, scales, place + off * STEPS)[0] for off in OFFSETS[1:]]
    return solved, np.array([middle, *around])


def _quadric(costs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient (2,) and second derivatives (2, 2) of the quadric through the costs at `OFFSETS`."""
    middle, zoom, radial, both, zoom_back, radial_back, both_back = costs
    gradient = np.array([zoom - zoom_back, radial - radial_back]) / (2.0 * STEPS)
    mixed = (both + both_back - zoom - zoom_back - radial - radial_back) / 2.0 + middle
    curve = np.array([[zoom + zoom_back - 2.0 * middle, mixed], [mixed, radial + radial_back - 2.0 * middle]])
    return gradient, curve / np.outer(STEPS, STEPS)


def _adjusted(
    problem: BundleProblem, camera: SlamCamera, scales: np.ndarray, place: np.ndarray
) -> tuple[float, BundleProblem]:
    """The lowest cost with this lens, in px of the picture, and the problem with the poses and points of it."""
    lens = Lens(math.exp(place[0]), float(place[1]))
    ideal = lens.ideal(problem.uv_px, camera)
    poses, points, cost = adjust_with_cost(
        replace(problem, uv_px=ideal), camera.intrinsics, scales, iterations=ITERATIONS, enough=ENOUGH,
        magnification=lens.px_per_ideal_px(ideal, camera),
    )  # fmt: skip
    return cost, replace(problem, poses=poses, points=points)
