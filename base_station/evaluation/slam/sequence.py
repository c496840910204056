"""Recorded sequences for SLAM: pictures with times, the camera, and the true poses where there are any.

TUM: `rgb.txt` with lines of time and file, truth in `groundtruth.txt`, the camera in ORB-SLAM's YAML beside them, or
known by the name (freiburg1 to 3). EuRoC: `mav0/cam0/data.csv` with nanoseconds and file, the camera and its place on
the body in `mav0/cam0/sensor.yaml`, truth in `mav0/state_groundtruth_estimate0/data.csv`. KITTI odometry: `image_0/`,
`times.txt`, the camera in `calib.txt`, truth in `poses.txt` or `../../poses/NAME.txt`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from base_station.errors import StationError, counted
from base_station.evaluation.slam.camera_files import (
    CameraFile,
    freiburg_camera,
    read_euroc_sensor,
    read_kitti_calibration,
    read_orbslam,
)
from base_station.evaluation.slam.trajectory import NS_PER_S, Trajectory, read_euroc, read_kitti, read_lines, read_tum
from base_station.trackers.slam.camera import SlamCamera

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".pgm", ".bmp")
MOST_PICTURES = 1_000_000
LEAST_PICTURES = 2
EUROC_TRUTHS = ("state_groundtruth_estimate0", "mocap0")
CAMERA_NAMES = ("orbslam3.yaml", "orbslam2.yaml", "camera.yaml")
UNCALIBRATED = "none"
"""As the camera's file: assume the default field of view, as of a camera that nobody has calibrated."""


@dataclass(frozen=True, kw_only=True)
class SlamSequence:
    """`times_s`: (n,), rising. `truth`: None without ground truth. `camera_source`: where the calibration is from."""

    name: str
    layout: str
    pictures: Sequence[Path]
    times_s: np.ndarray
    camera: SlamCamera
    camera_source: str
    truth: Trajectory | None

    def __len__(self) -> int:
        return len(self.pictures)


@dataclass(frozen=True)
class _Found:
    """What a layout's reader found."""

    layout: str
    pictures: list[Path]
    times_s: list[float]
    camera: CameraFile | None
    truth: Trajectory | None


def read_sequence(folder: Path, *, camera: str | None = None, max_frames: int | None = None) -> SlamSequence:
    """`camera`: an ORB-SLAM YAML file instead of the folder's own calibration, or "none" for the default field of view.

    Raises StationError when the folder is none of the layouts, a list is damaged, or no picture can be read.
    """
    if not folder.is_dir():
        raise StationError(f"There is no folder {folder}.", usage=True)
    own_camera = camera is None
    named = _named_camera(camera)
    found = _read_layout(folder, own_camera)
    times = np.array(found.times_s[:max_frames])
    pictures = found.pictures[:max_frames]
    if len(pictures) < LEAST_PICTURES:
        many = counted(len(pictures), "picture")
        raise StationError(f"{folder} lists {many}; at least {LEAST_PICTURES} are needed.", usage=True)
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise StationError(f"{folder}: the times of the pictures must rise.")
    width, height = _size(folder, pictures)
    calibration = found.camera if own_camera else named
    if calibration is None:
        source = f"assumed: {np.degrees(2 * np.arctan(width / 2 / SlamCamera.with_fov(width, height).fx)):.1f} degrees"
        shown = SlamCamera.with_fov(width, height)
    else:
        source, shown = calibration.source, _fitted(calibration, width, height, named=not own_camera)
    return SlamSequence(
        name=folder.resolve().name, layout=found.layout, pictures=pictures, times_s=times, camera=shown,
        camera_source=source, truth=found.truth,
    )  # fmt: skip


def read_gray(path: Path) -> np.ndarray | None:
    """uint8 (height, width), or None when there is no such file or it is no picture."""
    try:
        image = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_GRAYSCALE)
    except (OSError, cv2.error):
        return None
    return None if image is None else np.asarray(image)


def _named_camera(camera: str | None) -> CameraFile | None:
    """What a flag says. Raises StationError: what is wrong with it is a mistake of usage."""
    if camera is None or camera == UNCALIBRATED:
        return None
    try:
        return read_orbslam(Path(camera))
    except StationError as error:
        raise StationError(f"--camera {error}", usage=True) from error


def _fitted(calibration: CameraFile, width: int, height: int, *, named: bool) -> SlamCamera:
    try:
        return calibration.camera(width, height)
    except StationError as error:
        raise (StationError(f"--camera {error}", usage=True) if named else error) from error


def _size(folder: Path, pictures: Sequence[Path]) -> tuple[int, int]:
    """Width and height of the first picture that can be read."""
    for path in pictures:
        image = read_gray(path)
        if image is not None:
            return image.shape[1], image.shape[0]
    raise StationError(f"{folder}: none of the {len(pictures)} pictures can be read; the first is {pictures[0]}.")


def _read_layout(folder: Path, own_camera: bool) -> _Found:
    if (folder / "rgb.txt").is_file():
        return _tum(folder, own_camera)
    for mav in (folder / "mav0", folder):
        if (mav / "cam0" / "data.csv").is_file():
            return _euroc(folder, mav, own_camera)
    if (folder / "times.txt").is_file():
        return _kitti(folder, own_camera)
    raise StationError(
        f"{folder} is no sequence: rgb.txt (TUM), mav0/cam0/data.csv (EuRoC) or times.txt (KITTI) is expected in it.",
        usage=True,
    )


def _tum(folder: Path, own_camera: bool) -> _Found:
    times, pictures = _list(folder / "rgb.txt", None, folder)
    truth = folder / "groundtruth.txt"
    camera = (_yaml_in(folder) or freiburg_camera(folder.resolve().name)) if own_camera else None
    return _Found("TUM", pictures, times, camera, read_tum(truth) if truth.is_file() else None)


def _yaml_in(folder: Path) -> CameraFile | None:
    named = [folder / name for name in CAMERA_NAMES if (folder / name).is_file()]
    any_yaml = sorted(path for path in folder.iterdir() if path.suffix in (".yaml", ".yml"))
    if not named and len(any_yaml) > 1:
        names = ", ".join(path.name for path in any_yaml)
        raise StationError(f"{folder} has several camera files ({names}): name one with --camera.", usage=True)
    chosen = (named or any_yaml)[:1]
    return read_orbslam(chosen[0]) if chosen else None


def _euroc(folder: Path, mav: Path, own_camera: bool) -> _Found:
    stamps, pictures = _list(mav / "cam0" / "data.csv", ",", mav / "cam0" / "data")
    sensor = mav / "cam0" / "sensor.yaml"
    camera = read_euroc_sensor(sensor) if sensor.is_file() else None
    truth = None
    for name in EUROC_TRUTHS:
        if truth is None and (mav / name / "data.csv").is_file():
            body = read_euroc(mav / name / "data.csv")
            mounted = np.eye(4) if camera is None or camera.body_from_camera is None else camera.body_from_camera
            truth = Trajectory(body.times_s, body.world_from_cam @ mounted)
    if truth is None and (mav / "groundtruth.txt").is_file():
        truth = read_tum(mav / "groundtruth.txt")
    own = (camera or _yaml_in(folder)) if own_camera else None
    return _Found("EuRoC", pictures, [stamp / NS_PER_S for stamp in stamps], own, truth)


def _kitti(folder: Path, own_camera: bool) -> _Found:
    number = next((n for n in (0, 1, 2, 3) if (folder / f"image_{n}").is_dir()), None)
    if number is None:
        raise StationError(f"{folder} has times.txt, but no pictures in image_0 to image_3.")
    images = folder / f"image_{number}"
    pictures = sorted(path for path in images.iterdir() if path.suffix.lower() in PICTURE_SUFFIXES)
    times = [
        _time(line.split()[0], folder / "times.txt", at) for at, line in enumerate(read_lines(folder / "times.txt"), 1)
    ]
    if not pictures or len(pictures) > MOST_PICTURES:
        raise StationError(f"{images} has {len(pictures)} pictures.")
    if len(times) < len(pictures):
        raise StationError(f"{folder}/times.txt has {len(times)} times for {len(pictures)} pictures.")
    name = folder.resolve().name
    calibration = folder / "calib.txt"
    truths = (folder / "poses.txt", folder.resolve().parent.parent / "poses" / f"{name}.txt")
    truth = next((read_kitti(path, np.array(times)) for path in truths if path.is_file()), None)
    camera = read_kitti_calibration(calibration, number) if calibration.is_file() else None
    own = (camera or _yaml_in(folder)) if own_camera else None
    return _Found("KITTI", pictures, times[: len(pictures)], own, truth)


def _list(path: Path, separator: str | None, folder: Path) -> tuple[list[float], list[Path]]:
    times, pictures = [], []
    for number, line in enumerate(read_lines(path), 1):
        words = [word.strip() for word in line.split(separator)]
        if len(words) < 2 or not words[1]:
            raise StationError(f"{path}, entry {number}: a time and a file are expected, not {line[:60]!r}.")
        times.append(_time(words[0], path, number))
        pictures.append(folder / words[1])
        if number > MOST_PICTURES:
            raise StationError(f"{path} lists more than {MOST_PICTURES} pictures.")
    return times, pictures


def _time(word: str, path: Path, number: int) -> float:
    try:
        return float(word)
    except ValueError:
        raise StationError(f"{path}, entry {number}: {word[:40]!r} is not a time.") from None
