"""base-station export: a recording as a folder of pictures, times and poses that other programs read.

TUM's layout: `rgb/*.png`, `rgb.txt`, `groundtruth.txt`, `camera.yaml`. EuRoC's: `mav0/cam0/data/*.png` with `data.csv`
and `sensor.yaml`, `mav0/state_groundtruth_estimate0/data.csv`. Beside them `trajectory.txt` (the tracker's poses, where
it has any) and `odometry.txt` (by the wheels), in TUM's form. All poses are the camera's; times are of the recording.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Literal

import cv2
import numpy as np
import tyro
from rich.console import Console

from base_station.errors import StationError
from base_station.evaluation.slam.trajectory import NS_PER_S, Trajectory, write_euroc, write_tum
from base_station.geometry import PinholeCamera
from base_station.recording.poses import ROBOT_FROM_CAMERA, inverse, turned_about_z, world_from_camera
from base_station.recording.reader import RecordedStep, Recording

PNG_LEVEL = 1
FORMATS = Literal["tum", "euroc"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Export:
    """Write a recording as a folder of PNG pictures, times and trajectories."""

    recording: tyro.conf.Positional[Path]
    """FILE.mcap of `base-station run --record`."""
    folder: tyro.conf.Positional[Path]
    """To be made; must not exist, or be empty."""
    format: Annotated[FORMATS, tyro.conf.arg()] = "tum"
    """tum: rgb.txt, groundtruth.txt; euroc: mav0/cam0, mav0/state_groundtruth_estimate0."""


@dataclasses.dataclass
class _Written:
    """What was met on the way through the recording."""

    stamps_ns: list[int] = dataclasses.field(default_factory=list)
    steps: dict[tuple[str, int], tuple[int, float]] = dataclasses.field(default_factory=dict)
    """By the frame's key: its time, and the camera's pan."""
    seen: list[tuple[float, np.ndarray]] = dataclasses.field(default_factory=list)
    """The tracker's poses."""
    camera: PinholeCamera | None = None
    left_out: int = 0


def export(command: Export, console: Console) -> None:
    """Do it. Raises StationError."""
    recording = Recording(command.recording)
    folder = command.folder
    try:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise StationError(f"{folder} is there already: name a folder that is not, or is empty.", usage=True)
        pictures = folder / ("rgb" if command.format == "tum" else "mav0/cam0/data")
        pictures.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StationError(f"{folder} cannot be made ({error.strerror}).", usage=True) from error
    written = _Written()
    for step in recording:
        _take(step, written, pictures, command.format)
    if written.camera is None:
        raise StationError(f"{command.recording} has no whole picture to export.")
    (_tum if command.format == "tum" else _euroc)(folder, written, _truth(recording, written))
    if written.seen:
        write_tum(folder / "trajectory.txt", Trajectory.of(written.seen))
    if recording.odometry:
        write_tum(folder / "odometry.txt", _odometry(recording, written))
    notes = list(recording.notes)
    if written.left_out:
        notes.append(f"{written.left_out} frames are left out: without a picture, a band of rows, or of the same time")
    for note in notes:
        console.print(f"base-station: {note}", style="yellow", highlight=False, markup=False, soft_wrap=True)
    print(f"{folder}: {len(written.stamps_ns)} pictures; base-station evaluate slam {folder}")


def _take(step: RecordedStep, written: _Written, pictures: Path, form: str) -> None:
    frame = step.frame
    rises = not written.stamps_ns or step.log_ns > written.stamps_ns[-1]
    if frame is None or not frame.is_whole or not rises or frame.camera != (written.camera or frame.camera):
        written.left_out += 1
        return
    written.camera = frame.camera
    name = _time(step.log_ns) if form == "tum" else str(step.log_ns)
    _write_png(pictures / f"{name}.png", frame.image)
    written.stamps_ns.append(step.log_ns)
    written.steps[step.key] = step.log_ns, step.pan_rad or 0.0
    if step.result.cam_from_world is not None:
        written.seen.append((step.log_ns / NS_PER_S, inverse(step.result.cam_from_world)))


def _truth(recording: Recording, written: _Written) -> Trajectory | None:
    """Of the camera, for the frames that are exported."""
    poses = [
        (stamp_ns / NS_PER_S, world_from_camera(*recording.truths[key].robot, pan_rad))
        for key, (stamp_ns, pan_rad) in written.steps.items()
        if key in recording.truths
    ]
    return Trajectory.of(poses) if poses else None


def _odometry(recording: Recording, written: _Written) -> Trajectory:
    pans = dict(written.steps.values())
    return Trajectory.of(
        (stamp_ns / NS_PER_S, world_from_robot @ turned_about_z(pans.get(stamp_ns, 0.0)) @ ROBOT_FROM_CAMERA)
        for stamp_ns, world_from_robot in recording.odometry
    )


def _tum(folder: Path, written: _Written, truth: Trajectory | None) -> None:
    times = [_time(stamp_ns) for stamp_ns in written.stamps_ns]
    _write_lines(folder / "rgb.txt", ["# timestamp filename", *(f"{time} rgb/{time}.png" for time in times)])
    if truth is not None:
        write_tum(folder / "groundtruth.txt", truth)
    assert written.camera is not None
    _write_lines(folder / "camera.yaml", list(_orbslam(written.camera, written.stamps_ns)))


def _euroc(folder: Path, written: _Written, truth: Trajectory | None) -> None:
    assert written.camera is not None
    cam = folder / "mav0" / "cam0"
    lines = [f"{stamp_ns},{stamp_ns}.png" for stamp_ns in written.stamps_ns]
    _write_lines(cam / "data.csv", ["#timestamp [ns],filename", *lines])
    _write_lines(cam / "sensor.yaml", list(_sensor(written.camera, written.stamps_ns)))
    if truth is not None:
        known = folder / "mav0" / "state_groundtruth_estimate0"
        _make(known)
        write_euroc(known / "data.csv", truth)


def _orbslam(camera: PinholeCamera, stamps_ns: Sequence[int]) -> Iterator[str]:
    yield "%YAML:1.0"
    yield 'File.version: "1.0"'
    yield 'Camera.type: "PinHole"'
    for name, value in zip(("fx", "fy", "cx", "cy"), (camera.fx, camera.fy, camera.cx, camera.cy), strict=True):
        yield f"Camera1.{name}: {value!r}"
    for name, value in zip(("k1", "k2", "p1", "p2", "k3"), camera.distortion or (0.0,) * 4, strict=False):
        yield f"Camera1.{name}: {value!r}"
    yield f"Camera.width: {camera.width}"
    yield f"Camera.height: {camera.height}"
    yield f"Camera.fps: {max(1, round(_rate_hz(stamps_ns)))}"
    yield "Camera.RGB: 1"


def _sensor(camera: PinholeCamera, stamps_ns: Sequence[int]) -> Iterator[str]:
    yield "sensor_type: camera"
    yield "T_BS:"
    yield "  cols: 4"
    yield "  rows: 4"
    yield "  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]"
    yield f"rate_hz: {_rate_hz(stamps_ns):.3f}"
    yield f"resolution: [{camera.width}, {camera.height}]"
    yield "camera_model: pinhole"
    yield f"intrinsics: [{camera.fx!r}, {camera.fy!r}, {camera.cx!r}, {camera.cy!r}]"
    yield "distortion_model: radial-tangential"
    yield f"distortion_coefficients: {list(camera.distortion or (0.0,) * 4)}"


def _rate_hz(stamps_ns: Sequence[int]) -> float:
    span_s = (stamps_ns[-1] - stamps_ns[0]) / NS_PER_S
    return (len(stamps_ns) - 1) / span_s if span_s > 0 else 30.0


def _time(stamp_ns: int) -> str:
    """As in the trajectories, so that equal times read equal."""
    return f"{stamp_ns / NS_PER_S:.6f}"


def _write_png(path: Path, image: np.ndarray) -> None:
    data = cv2.imencode(".png", image, (cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL))[1]
    try:
        path.write_bytes(data.tobytes())
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error


def _write_lines(path: Path, lines: Sequence[str]) -> None:
    try:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StationError(f"{folder} cannot be made ({error.strerror}).") from error
