"""How far a trajectory is from the truth: absolute and relative errors, after a similarity has aligned it.

A monocular camera tells neither where the world begins nor its scale, so the found positions are first brought onto
the true ones by the similarity that fits best (Umeyama). ATE is what is left of each position, RPE what is wrong with
the motion between two frames. Definitions: Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS
2012; the numbers are those of evo's `evo_ape tum -as` and `evo_rpe tum -as -d 1 -u f`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from base_station.evaluation.slam.trajectory import Trajectory
from base_station.trackers.slam.sim3 import align, inverse, rotation_of, scale_of

MOST_APART_S = 0.02
"""A pose and a true pose belong together when their times differ by no more."""
LEAST_POSES = 3


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Lengths are in the truth's unit. None: there was nothing to measure it with."""

    poses: int
    """That have a true pose at their time."""
    scale: float
    """True length of one unit of the found trajectory."""
    ate_rmse: float
    ate_mean: float
    ate_median: float
    ate_max: float
    rpe_trans_rmse: float | None
    """Of the step from one pose to the next."""
    rpe_rot_deg_rmse: float | None
    rpe_1s_trans_rmse: float | None
    """Of the motion within a second."""
    rpe_1s_rot_deg_rmse: float | None


@dataclass(frozen=True)
class Aligned:
    """Found and true poses of the same times: (m,), (m, 4, 4) each; the found ones are in the truth's world."""

    times_s: np.ndarray
    found: np.ndarray
    truth: np.ndarray
    scale: float


def associate(found_s: np.ndarray, truth_s: np.ndarray, most_apart_s: float = MOST_APART_S) -> np.ndarray:
    """(m, 2) int: for each time of the shorter series the nearest of the longer one, where one is near enough."""
    if not len(found_s) or not len(truth_s):
        return np.empty((0, 2), np.int64)
    swapped = len(found_s) > len(truth_s)
    short, long = (truth_s, found_s) if swapped else (found_s, truth_s)
    after = np.clip(np.searchsorted(long, short), 0, len(long) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(long[before] - short) <= np.abs(long[after] - short), before, after)
    kept = np.flatnonzero(np.abs(long[nearest] - short) <= most_apart_s)
    pairs = np.column_stack([kept, nearest[kept]])
    return pairs[:, ::-1] if swapped else pairs


def aligned(found: Trajectory, truth: Trajectory, most_apart_s: float = MOST_APART_S) -> Aligned | None:
    """None when fewer than three poses have a true one, or all of them are at one place."""
    pairs = associate(found.times_s, truth.times_s, most_apart_s)
    if len(pairs) < LEAST_POSES:
        return None
    ours, theirs = found.world_from_cam[pairs[:, 0]], truth.world_from_cam[pairs[:, 1]]
    if min(float(np.ptp(poses[:, :3, 3], axis=0).max()) for poses in (ours, theirs)) < 1e-12:
        return None
    truth_from_found = align(ours[:, :3, 3], theirs[:, :3, 3])
    scale = float(scale_of(truth_from_found))
    moved = truth_from_found @ ours
    moved[:, :3, :3] = rotation_of(moved)
    return Aligned(found.times_s[pairs[:, 0]], moved, theirs, scale)


def errors(found: Trajectory, truth: Trajectory, most_apart_s: float = MOST_APART_S) -> Errors | None:
    """None when there is too little to align, see `aligned`."""
    pairs = aligned(found, truth, most_apart_s)
    if pairs is None:
        return None
    off = absolute_errors(pairs)
    steps = np.arange(len(pairs.times_s) - 1)
    step = relative_errors(pairs, steps, steps + 1)
    second = relative_errors(pairs, *_a_second_apart(pairs.times_s))
    return Errors(
        poses=len(off),
        scale=pairs.scale,
        ate_rmse=float(np.sqrt((off**2).mean())),
        ate_mean=float(off.mean()),
        ate_median=float(np.median(off)),
        ate_max=float(off.max()),
        rpe_trans_rmse=_rms(step[0]),
        rpe_rot_deg_rmse=_rms(np.degrees(step[1])),
        rpe_1s_trans_rmse=_rms(second[0]),
        rpe_1s_rot_deg_rmse=_rms(np.degrees(second[1])),
    )


def absolute_errors(pairs: Aligned) -> np.ndarray:
    """(m,) distances."""
    return np.asarray(np.linalg.norm(pairs.found[:, :3, 3] - pairs.truth[:, :3, 3], axis=1))


def relative_errors(pairs: Aligned, begins: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k,) distances and (k,) angles in rad between the found and the true motions from `begins` to `ends`."""
    found = inverse(pairs.found[begins]) @ pairs.found[ends]
    truth = inverse(pairs.truth[begins]) @ pairs.truth[ends]
    wrong = inverse(truth) @ found
    return np.linalg.norm(wrong[:, :3, 3], axis=1), rotation_angles_rad(wrong[:, :3, :3])


def rotation_angles_rad(rotations: np.ndarray) -> np.ndarray:
    """(k,) of (k, 3, 3); exact for small angles too."""
    r = rotations
    twice_sine = np.sqrt(
        (r[:, 2, 1] - r[:, 1, 2]) ** 2 + (r[:, 0, 2] - r[:, 2, 0]) ** 2 + (r[:, 1, 0] - r[:, 0, 1]) ** 2
    )
    return np.asarray(np.arctan2(twice_sine, np.trace(r, axis1=1, axis2=2) - 1))


def _a_second_apart(times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of each pose the one that is nearest to a second later, if that is within a tenth of it."""
    wanted = times_s + 1.0
    after = np.clip(np.searchsorted(times_s, wanted), 0, len(times_s) - 1)
    before = np.maximum(after - 1, 0)
    ends = np.where(np.abs(times_s[before] - wanted) <= np.abs(times_s[after] - wanted), before, after)
    begins = np.flatnonzero(np.abs(times_s[ends] - wanted) <= 0.1)
    return begins, ends[begins]


def _rms(values: np.ndarray) -> float | None:
    return float(np.sqrt((values**2).mean())) if len(values) else None
