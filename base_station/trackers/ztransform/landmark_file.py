"""Landmarks in one file: NumPy's .npz, no pickle in it. Whatever is not such a file is one clear sentence."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from base_station.errors import StationError
from base_station.geometry import PinholeCamera
from base_station.output_files import replace_file
from base_station.trackers.ztransform.landmark import CELLS, LONGEST_NAME, Landmark, check_name
from base_station.trackers.ztransform.verification import SMALL_SIZE
from base_station.types import Box

KIND, VERSION, OLDEST_VERSION = "zservo landmarks", 2, 1
"""Version 1 also held descriptors, which are now made from the picture."""
MOST_LANDMARKS = 4096
MOST_BYTES = 64 << 20
MOST_PX = 1e5
"""Of a box's place and size, and of focal lengths."""
_SHAPES: dict[str, tuple[type, tuple[int, ...]]] = {
    "names": (np.str_, ()),
    "pictures": (np.uint8, (CELLS, CELLS)),
    "step_maps": (np.float16, (5, SMALL_SIZE)),
    "boxes": (np.float64, (4,)),
    "cameras": (np.float64, (6,)),
    "depths_m": (np.float64, ()),
}
"""Of one landmark. A place has a box of NaN, an unknown depth is NaN."""
LANDMARK_BYTES = sum(
    math.prod(shape) * (4 * LONGEST_NAME if kind is np.str_ else np.dtype(kind).itemsize)
    for kind, shape in _SHAPES.values()
)
"""What one landmark takes in the file, before compression: all that is needed to find it again."""


def write_landmarks(path: Path, landmarks: list[Landmark]) -> None:
    """All of them into this file, whole or not at all. Raises StationError."""
    if len(landmarks) > MOST_LANDMARKS:
        raise StationError(f"A file holds {MOST_LANDMARKS} landmarks at the most; forget some.")
    arrays: dict[str, Any] = {
        "kind": np.array(KIND),
        "version": np.array(VERSION),
        "names": np.array([landmark.name for landmark in landmarks], f"<U{LONGEST_NAME}"),
        "pictures": _stack([landmark.picture for landmark in landmarks], "pictures"),
        "step_maps": _stack([landmark.step_map for landmark in landmarks], "step_maps"),
        "boxes": _stack([np.array(_box_numbers(landmark.box)) for landmark in landmarks], "boxes"),
        "cameras": _stack([np.array(_camera_numbers(landmark.camera)) for landmark in landmarks], "cameras"),
        "depths_m": np.array([landmark.learned_depth_m or np.nan for landmark in landmarks], np.float64),
    }
    replace_file(path, lambda file: np.savez_compressed(file, **arrays))


def read_landmarks(path: Path) -> list[Landmark]:
    """Raises StationError when the file cannot be read, is none of ours, of another version, or damaged."""
    try:
        arrays = _arrays(path)
    except OSError as error:
        raise StationError(f"{path} cannot be read ({error.strerror or error}).", usage=True) from error
    except zipfile.BadZipFile as error:
        raise StationError(_unreadable(path, f"it was cut short or changed, or is something else: {error}")) from error
    except (ValueError, KeyError, EOFError, NotImplementedError, RuntimeError) as error:
        raise StationError(_unreadable(path, str(error).strip("'"))) from error
    except Exception as error:
        if type(error).__module__ != "zlib":
            raise
        raise StationError(_unreadable(path, str(error))) from error
    try:
        return [_landmark(arrays, number) for number in range(len(arrays["names"]))]
    except (ValueError, OverflowError) as error:
        raise StationError(_unreadable(path, str(error))) from error


def _unreadable(path: Path, why: str) -> str:
    return f"{path} is no file of landmarks, or a damaged one ({why}). Give another with --memory, or learn anew."


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays, with the right types and shapes."""
    with zipfile.ZipFile(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > MOST_BYTES:
            raise ValueError(f"it holds more than {MOST_BYTES >> 20} MiB")
    with np.load(path, allow_pickle=False) as file:
        if "kind" not in file or file["kind"].shape != () or str(file["kind"]) != KIND:
            raise ValueError("it says nothing of landmarks")
        _check_version(path, file["version"] if "version" in file else np.array("unknown"))
        arrays = {name: file[name] for name in _SHAPES}
    count = arrays["names"].shape[:1]
    for name, (kind, shape) in _SHAPES.items():
        if not np.issubdtype(arrays[name].dtype, kind) or arrays[name].shape != (*count, *shape):
            raise ValueError(f"{name} are {arrays[name].dtype} {arrays[name].shape}")
    if count[0] > MOST_LANDMARKS or len(set(arrays["names"].tolist())) != count[0]:
        raise ValueError("too many landmarks, or two of one name")
    return arrays


def _check_version(path: Path, version: np.ndarray) -> None:
    if version.shape != () or not np.issubdtype(version.dtype, np.integer):
        raise ValueError("it does not tell its version")
    if not OLDEST_VERSION <= int(version) <= VERSION:
        raise StationError(
            f"{path} is of version {int(version)}, and this program reads {OLDEST_VERSION} to {VERSION}:"
            " another version of this program wrote it. Use that one, or learn the landmarks again."
        )


def _landmark(arrays: dict[str, np.ndarray], number: int) -> Landmark:
    """Raises ValueError for numbers that make no landmark."""
    name, depth_m = str(arrays["names"][number]), float(arrays["depths_m"][number])
    check_name(name)
    width, height, fx, fy, cx, cy = arrays["cameras"][number].tolist()
    step_map = arrays["step_maps"][number]
    if not np.isfinite(arrays["cameras"][number]).all() or not (1 <= width <= 8192 and 1 <= height <= 8192):
        raise ValueError(f"{name}: no camera")
    if min(fx, fy) <= 0 or max(fx, fy, abs(cx), abs(cy)) > MOST_PX:
        raise ValueError(f"{name}: no camera")
    if not np.isfinite(step_map).all() or depth_m <= 0 or np.isinf(depth_m):
        raise ValueError(f"{name}: numbers out of range")
    box = arrays["boxes"][number]
    if not np.isnan(box).all() and not (np.abs(box) <= MOST_PX).all():
        raise ValueError(f"{name}: its box is out of range")
    return Landmark(
        name=name,
        camera=PinholeCamera(width=int(width), height=int(height), fx=fx, fy=fy, cx=cx, cy=cy),
        box=None if np.isnan(box).all() else Box(*box.tolist()),
        picture=arrays["pictures"][number].copy(),
        step_map=step_map.copy(),
        learned_depth_m=None if np.isnan(depth_m) else depth_m,
    )


def _stack(parts: list[np.ndarray], name: str) -> np.ndarray:
    kind, shape = _SHAPES[name]
    return np.stack(parts).astype(kind) if parts else np.empty((0, *shape), kind)


def _box_numbers(box: Box | None) -> tuple[float, float, float, float]:
    return (box.x, box.y, box.width, box.height) if box is not None else (float("nan"),) * 4


def _camera_numbers(camera: PinholeCamera) -> tuple[float, ...]:
    return camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
