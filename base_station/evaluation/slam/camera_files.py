"""Camera settings from files: ORB-SLAM's YAML (old keys and new), EuRoC's sensor.yaml, KITTI's calib.txt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from base_station.calibration.camera_file import camera_text, read_camera
from base_station.errors import StationError
from base_station.trackers.slam.camera import SlamCamera
from protocol.camera_file import PINHOLES, file_entries

DISTORTIONS = ("radial-tangential", "radtan", "plumb_bob", "none", "")

FREIBURG = {
    "freiburg1": (517.3, 516.5, 318.6, 255.3, 0.2624, -0.9531, -0.0054, 0.0026, 1.1633),
    "freiburg2": (520.9, 521.0, 325.1, 249.7, 0.2312, -0.7849, -0.0033, -0.0001, 0.9172),
    "freiburg3": (535.4, 539.2, 320.1, 247.6, 0.0, 0.0, 0.0, 0.0, 0.0),
}
"""The TUM RGB-D benchmark tells its cameras on its page, not in the sequences: fx fy cx cy k1 k2 p1 p2 k3, 640x480."""


@dataclass(frozen=True)
class CameraFile:
    """What a file says. `size`: width and height in px, None where it does not tell. `distortion`: k1 k2 p1 p2 [k3]."""

    intrinsics: tuple[float, float, float, float]
    distortion: tuple[float, ...] = ()
    size: tuple[int, int] | None = None
    body_from_camera: np.ndarray | None = None
    """4x4, EuRoC: where the camera is on the body whose poses the ground truth tells."""
    source: str = ""

    def camera(self, width_px: int, height_px: int) -> SlamCamera:
        """For pictures of this size. Raises StationError when it is the calibration of another camera."""
        if self.size is not None and self.size != (width_px, height_px):
            raise StationError(
                f"{self.source} is for pictures of {self.size[0]}x{self.size[1]} px, these are {width_px}x{height_px}."
            )
        fx, fy, cx, cy = self.intrinsics
        try:
            return SlamCamera(
                width_px=width_px, height_px=height_px, fx=fx, fy=fy, cx=cx, cy=cy, distortion=self.distortion
            )
        except ValueError as error:
            raise StationError(f"{self.source} is no camera of these pictures: {error}.") from error


def read_orbslam(path: Path) -> CameraFile:
    """Settings of ORB-SLAM2 or 3, or what base-station calibrate wrote. Raises StationError."""
    found = read_camera(path)
    own = found.intrinsics
    return CameraFile((own.fx, own.fy, own.cx, own.cy), own.distortion, found.size, source=str(path))


def read_euroc_sensor(path: Path) -> CameraFile:
    """A camera's sensor.yaml in EuRoC's layout. Raises StationError."""
    entries = _entries(path)
    model = entries.get("camera_model", "pinhole").lower()
    distorts = entries.get("distortion_model", "").lower()
    if model not in PINHOLES or distorts not in DISTORTIONS:
        raise StationError(f"{path}: a {model} camera with {distorts or 'no'} distortion is not supported.")
    fx, fy, cx, cy = _numbers(entries, "intrinsics", path, 4)
    distortion = _numbers(entries, "distortion_coefficients", path) if "distortion_coefficients" in entries else ()
    if len(distortion) not in (0, 4, 5):
        raise StationError(f"{path}: distortion_coefficients are {len(distortion)} numbers; 4 or 5 are known.")
    size = None
    if "resolution" in entries:
        width, height = _numbers(entries, "resolution", path, 2)
        size = (round(width), round(height))
    body_from_camera = None
    if "data" in entries:
        body_from_camera = np.array(_numbers(entries, "data", path, 16)).reshape(4, 4)
        if abs(np.linalg.det(body_from_camera[:3, :3]) - 1) > 1e-2:
            raise StationError(f"{path}: T_BS is no pose.")
    return CameraFile((fx, fy, cx, cy), distortion if any(distortion) else (), size, body_from_camera, str(path))


def read_kitti_calibration(path: Path, camera: int) -> CameraFile:
    """Line "P0: ..." (or of another camera) of calib.txt: a projection matrix of rectified pictures, row by row."""
    numbers = _plain_rows(path).get(f"P{camera}", ())
    if len(numbers) != 12:
        raise StationError(f"{path} has no line 'P{camera}:' with twelve numbers.")
    fx, _, cx, _, _, fy, cy, *_ = numbers
    return CameraFile((fx, fy, cx, cy), source=str(path))


def freiburg_camera(name: str) -> CameraFile | None:
    """The published camera of a TUM RGB-D sequence, by the sequence's name."""
    for key, numbers in FREIBURG.items():
        if key in name:
            fx, fy, cx, cy, *distortion = numbers
            given = tuple(distortion) if any(distortion) else ()
            return CameraFile((fx, fy, cx, cy), given, (640, 480), source=f"the published camera of {key}")
    return None


def _entries(path: Path) -> dict[str, str]:
    return file_entries(camera_text(path))


def _plain_rows(path: Path) -> dict[str, tuple[float, ...]]:
    rows = {}
    for line in camera_text(path).splitlines():
        key, colon, rest = line.partition(":")
        try:
            rows[key.strip()] = tuple(float(word) for word in rest.split()) if colon else ()
        except ValueError:
            continue
    return rows


def _numbers(entries: Mapping[str, str], key: str, path: Path, count: int | None = None) -> tuple[float, ...]:
    text = entries.get(key, "").strip("[]")
    try:
        numbers = tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        numbers = ()
    if not all(map(math.isfinite, numbers)) or (count is not None and len(numbers) != count):
        raise StationError(f"{path}: {key} must be {count or 'some'} numbers in brackets.")
    return numbers
