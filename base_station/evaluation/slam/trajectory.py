"""Where a camera was: times and poses, and the files that hold them (TUM, EuRoC, KITTI).

TUM: lines of "time tx ty tz qx qy qz qw", seconds, camera to world; ORB-SLAM's CameraTrajectory.txt and
KeyFrameTrajectory.txt are such files. EuRoC: "nanoseconds,px,py,pz,qw,qx,qy,qz", commas, maybe more columns.
KITTI: twelve numbers a line, the upper three rows of camera to world, one line per picture and no times.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from base_station.errors import StationError

MOST_BYTES = 512 << 20
NS_PER_S = 1_000_000_000
EUROC_HEADER = "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []"


@dataclass(frozen=True)
class Trajectory:
    """`times_s`: (n,), rising. `world_from_cam`: (n, 4, 4), rigid."""

    times_s: np.ndarray
    world_from_cam: np.ndarray

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def positions(self) -> np.ndarray:
        """(n, 3)."""
        return np.asarray(self.world_from_cam[:, :3, 3])

    @property
    def length(self) -> float:
        """Of the path, in the trajectory's own unit."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    @classmethod
    def of(cls, poses: Iterable[tuple[float, np.ndarray]]) -> Trajectory:
        """From (time_s, world_from_cam) pairs in any order; of equal times the last."""
        by_time = {float(time_s): pose for time_s, pose in poses}
        times = sorted(by_time)
        stacked = np.stack([by_time[time_s] for time_s in times]) if times else np.empty((0, 4, 4))
        return cls(np.array(times, float), stacked)


def quaternions(rotations: np.ndarray) -> np.ndarray:
    """(n, 4) x, y, z, w with w >= 0 of rotation matrices (n, 3, 3). Bar-Itzhack, J. Guidance 2000."""
    r = rotations
    k = np.empty((len(r), 4, 4))
    for i in range(3):
        for j in range(3):
            k[:, i, j] = r[:, i, j] + r[:, j, i]
        k[:, i, i] = 2 * r[:, i, i] - np.trace(r, axis1=1, axis2=2)
    k[:, 3, 0] = k[:, 0, 3] = r[:, 2, 1] - r[:, 1, 2]
    k[:, 3, 1] = k[:, 1, 3] = r[:, 0, 2] - r[:, 2, 0]
    k[:, 3, 2] = k[:, 2, 3] = r[:, 1, 0] - r[:, 0, 1]
    k[:, 3, 3] = np.trace(r, axis1=1, axis2=2)
    found = np.linalg.eigh(k)[1][..., -1]
    return np.asarray(np.where(found[:, 3:] < 0, -found, found))


def rotations(quaternions_xyzw: np.ndarray) -> np.ndarray:
    """(n, 3, 3) of (n, 4) x, y, z, w of any length but 0."""
    x, y, z, w = (quaternions_xyzw / np.linalg.norm(quaternions_xyzw, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def read_tum(path: Path) -> Trajectory:
    """Raises StationError, which says what is wrong in which line."""
    table = _table(path, 8, separator=None)
    return _trajectory(path, table[:, 0], table[:, 1:4], table[:, 4:8])


def read_euroc(path: Path) -> Trajectory:
    """Poses as the file has them: in EuRoC's ground truth those of the IMU. Raises StationError."""
    table = _table(path, 8, separator=",")
    return _trajectory(path, table[:, 0] / NS_PER_S, table[:, 1:4], table[:, [5, 6, 7, 4]])


def read_kitti(path: Path, times_s: np.ndarray) -> Trajectory:
    """`times_s`: of the pictures; a pose more or less at the end is left out. Raises StationError."""
    table = _table(path, 12, separator=None)
    count = min(len(table), len(times_s))
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3] = table[:count].reshape(-1, 3, 4)
    if not np.allclose(np.linalg.det(poses[:, :3, :3]), 1, atol=1e-2):
        raise StationError(f"{path}: the rotations are none.")
    return Trajectory(times_s[:count], poses)


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Raises StationError when it cannot be written."""
    values = np.concatenate([trajectory.positions, quaternions(trajectory.world_from_cam[:, :3, :3])], axis=1)
    pairs = zip(trajectory.times_s, values, strict=True)
    _write(path, [f"{time_s:.6f} " + " ".join(f"{value:.9f}" for value in row) for time_s, row in pairs])


def write_euroc(path: Path, trajectory: Trajectory) -> None:
    """Raises StationError when it cannot be written."""
    values = np.concatenate([trajectory.positions, quaternions(trajectory.world_from_cam[:, :3, :3])], axis=1)
    values = values[:, [0, 1, 2, 6, 3, 4, 5]]
    pairs = zip(trajectory.times_s, values, strict=True)
    lines = [f"{round(time_s * NS_PER_S)}," + ",".join(f"{value:.9f}" for value in row) for time_s, row in pairs]
    _write(path, [EUROC_HEADER, *lines])


def read_lines(path: Path) -> list[str]:
    """Lines that are neither empty nor comments. Raises StationError."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise StationError(f"{path} is too large to be read ({path.stat().st_size >> 20} MiB).")
        text = path.read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise StationError(f"{path} cannot be read ({error.strerror}).") from error
    return [line.strip() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]


def _table(path: Path, columns: int, *, separator: str | None) -> np.ndarray:
    """(n, columns): the first columns of every line; further ones are left out."""
    rows = []
    for number, line in enumerate(read_lines(path), 1):
        words = line.split(separator)
        try:
            rows.append([float(word) for word in words[:columns]])
        except ValueError:
            rows.append([])
        if len(rows[-1]) != columns or not np.isfinite(rows[-1]).all():
            apart = "spaces" if separator is None else "commas"
            raise StationError(
                f"{path}, entry {number}: {columns} numbers are expected, with {apart} between them, not {line[:60]!r}."
            )
    if not rows:
        raise StationError(f"{path} holds no poses.")
    return np.array(rows)


def _trajectory(path: Path, times_s: np.ndarray, positions: np.ndarray, xyzw: np.ndarray) -> Trajectory:
    if (np.abs(np.linalg.norm(xyzw, axis=1) - 1) > 0.1).any():
        raise StationError(f"{path}: quaternions must have length 1.")
    order = np.argsort(times_s, kind="stable")
    order = order[np.append(np.diff(times_s[order]) > 0, True)]
    poses = np.tile(np.eye(4), (len(order), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = rotations(xyzw[order]), positions[order]
    return Trajectory(times_s[order], poses)


def _write(path: Path, lines: Sequence[str]) -> None:
    try:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error
