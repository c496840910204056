"""A camera's calibration as YAML text that ORB-SLAM3 and OpenCV read, and agent and station: one format, one place.

ORB-SLAM's keys are `Camera1.fx` and so on since its version 1.0 (`File.version`), `Camera.fx` before. Only lines of
"key: number", "key: text" and "key: [numbers]" are read, which is all that such a file says about a camera.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from protocol.errors import ProtocolError
from protocol.messages import Intrinsics

MOST_BYTES = 1 << 20
"""No file of a camera is larger; whoever reads one stops there."""
ENTRY = re.compile(r"""^[ \t]*([A-Za-z_][\w.]*)[ \t]*:[ \t]*(\[[^\]]*\]|"[^"\n]*"|'[^'\n]*'|[^#\n]*)""", re.MULTILINE)
PINHOLES = ("pinhole", "rectified")
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
SAME_SHAPE = 0.01
"""Two sizes of a picture belong to the same view when width and height are scaled alike up to this."""

ORB_SETTINGS = """
# What else ORB-SLAM3 wants to know.
ORBextractor.nFeatures: 1000
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -3.5
Viewer.ViewpointF: 500.0
"""


@dataclass(frozen=True, kw_only=True)
class CameraFile:
    """What such a file says. `size`: width and height in px that the intrinsics belong to, None where it is silent."""

    intrinsics: Intrinsics
    size: tuple[int, int] | None = None

    def scaled(self, width: int, height: int) -> Intrinsics:
        """The intrinsics for the same view in pictures of this size. Raises ProtocolError when it cannot be the same
        view, or the principal point lies outside of it."""
        own = self.intrinsics
        across, down = (width / self.size[0], height / self.size[1]) if self.size is not None else (1.0, 1.0)
        if self.size is not None and abs(across / down - 1) > SAME_SHAPE:
            raise ProtocolError(
                f"it is for pictures of {self.size[0]}x{self.size[1]} px, these are {width}x{height}, another shape"
            )
        # Pixel centres are at integers: the picture's left edge is at -0.5.
        cx, cy = (own.cx + 0.5) * across - 0.5, (own.cy + 0.5) * down - 0.5
        if not (0 <= cx < width and 0 <= cy < height):
            raise ProtocolError(f"its axis meets them at ({cx:.1f}, {cy:.1f}), outside of {width}x{height}")
        return Intrinsics(fx=own.fx * across, fy=own.fy * down, cx=cx, cy=cy, distortion=own.distortion)


def read_camera_file(text: str) -> CameraFile:
    """Raises ProtocolError, in words that follow "FILE: ", when the text describes no pinhole camera."""
    entries = file_entries(text)
    kind = entries.get("Camera.type", "PinHole").lower()
    if kind not in PINHOLES:
        raise ProtocolError(f"a camera of type {kind[:40]!r} is not supported, only pinholes are")
    prefix = "Camera1" if "Camera1.fx" in entries else "Camera"
    fx, fy, cx, cy = (entry_number(entries, f"{prefix}.{key}") for key in ("fx", "fy", "cx", "cy"))
    names = [f"{prefix}.{key}" for key in COEFFICIENTS]
    given = tuple(entry_number(entries, name) if name in entries else 0.0 for name in names)
    distortion = (given if given[4] else given[:4]) if any(given) else ()
    size = None
    if "Camera.width" in entries and "Camera.height" in entries:
        size = (round(entry_number(entries, "Camera.width")), round(entry_number(entries, "Camera.height")))
        if min(size) < 1:
            raise ProtocolError(f"a picture of {size[0]}x{size[1]} px is none")
    return CameraFile(intrinsics=Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy, distortion=distortion), size=size)


def write_camera_file(camera: CameraFile, *, fps: float, notes: tuple[str, ...] = ()) -> str:
    """The text of a file for ORB-SLAM3, with OpenCV's matrices beside it. `notes`: lines of comment."""
    own = camera.intrinsics
    if camera.size is None:
        raise ValueError("a calibration belongs to pictures of some size")
    width, height = camera.size
    given = dict(zip(COEFFICIENTS, own.distortion or (0.0,) * 4, strict=False))
    lines = ["%YAML:1.0", "---", *(f"# {note}" for note in notes)]
    lines += ['File.version: "1.0"', 'Camera.type: "PinHole"']
    pinhole = {"fx": own.fx, "fy": own.fy, "cx": own.cx, "cy": own.cy}
    lines += [f"Camera1.{key}: {_real(value)}" for key, value in (pinhole | given).items()]
    lines += [f"Camera.width: {width}", f"Camera.height: {height}", f"Camera.fps: {max(1, round(fps))}"]
    lines += ["Camera.RGB: 1", "", "# The same for OpenCV (cv::FileStorage)."]
    lines += [f"image_width: {width}", f"image_height: {height}"]
    lines += _matrix("camera_matrix", 3, (own.fx, 0.0, own.cx, 0.0, own.fy, own.cy, 0.0, 0.0, 1.0))
    lines += _matrix("distortion_coefficients", 1, (*given.values(), 0.0)[:5])
    return "\n".join(lines) + "\n" + ORB_SETTINGS


def file_entries(text: str) -> dict[str, str]:
    """The first value of every key, without quotes."""
    found: dict[str, str] = {}
    for key, value in ENTRY.findall(text):
        found.setdefault(key, value.strip().strip("\"'"))
    return found


def entry_number(entries: Mapping[str, str], key: str) -> float:
    """Raises ProtocolError when it is missing or no finite number."""
    if key not in entries:
        raise ProtocolError(f"it does not say {key}")
    try:
        number = float(entries[key])
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ProtocolError(f"{key} is {entries[key][:40]!r}, not a number")
    return number


def _real(value: float) -> str:
    """With a point: OpenCV tells whole numbers from real ones, and some readers of these files want the latter."""
    text = f"{value:.9g}"
    return text if any(mark in text for mark in ".en") else text + ".0"


def _matrix(name: str, rows: int, values: tuple[float, ...]) -> list[str]:
    data = ", ".join(map(_real, values))
    columns = len(values) // rows
    return [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d", f"   data: [ {data} ]"]
