"""The camera's file on the station's side: read with errors for people, and fitted to the frames that come."""

from __future__ import annotations

from pathlib import Path

from base_station.errors import StationError
from base_station.geometry import PinholeCamera
from protocol import FrameFormat, ProtocolError
from protocol.camera_file import MOST_BYTES, CameraFile, read_camera_file


def camera_text(path: Path) -> str:
    """What a camera's file says. Raises StationError when it cannot be read or is far too large."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise StationError(f"{path} is too large for a camera's settings.")
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise StationError(f"{path} cannot be read ({error.strerror}).") from error


def read_camera(path: Path) -> CameraFile:
    """Raises StationError when the file describes no pinhole camera."""
    try:
        return read_camera_file(camera_text(path))
    except ProtocolError as error:
        raise StationError(f"{path}: {error}.") from error


def named_camera(path: Path) -> CameraFile:
    """The file that a flag names: what is wrong with it is a mistake of usage. Raises StationError."""
    try:
        return read_camera(path)
    except StationError as error:
        raise StationError(f"--camera {error}", usage=True) from error


def camera_of(file: CameraFile, frames: FrameFormat) -> PinholeCamera:
    """The camera of frames (or bands of them) as they come. Raises ProtocolError when the file is about others."""
    found = file.scaled(frames.width, frames.full_height or frames.height)
    return PinholeCamera(
        width=frames.width,
        height=frames.height,
        fx=found.fx,
        fy=found.fy,
        cx=found.cx,
        cy=found.cy - frames.first_row,
        distortion=found.distortion,
    )
