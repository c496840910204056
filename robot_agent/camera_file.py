"""The camera's calibration (`--camera-file`), which hello then tells to every station."""

from __future__ import annotations

from pathlib import Path

from protocol import ProtocolError
from protocol.camera_file import MOST_BYTES, CameraFile, read_camera_file
from robot_agent.errors import UsageError


def read_calibration(name: str) -> CameraFile:
    """Raises UsageError when the file cannot be read or describes no pinhole camera."""
    path = Path(name).expanduser()
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise UsageError(f"--camera-file {name} cannot be read ({error.strerror}).") from error
    if len(data) > MOST_BYTES:
        raise UsageError(f"--camera-file {name} is too large for a camera's settings.")
    try:
        return read_camera_file(data.decode(errors="replace"))
    except ProtocolError as error:
        raise UsageError(f"--camera-file {name}: {error}.") from error
