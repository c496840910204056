"""SLAM's map in one file: NumPy's .npz, no pickle in it. Whatever is not such a file is one clear sentence.

What a file claims is checked before anything is made of it: the sizes in each array's header against the bytes that
are there, types and shapes, then the numbers and the indices. Not compressed: descriptors look like noise.
"""

from __future__ import annotations

import io
import math
import struct
import tokenize
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from base_station.errors import StationError
from base_station.output_files import replace_file
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.saved_map import SavedMap

KIND, VERSION = "zservo map", 1
MOST_KEYFRAMES, MOST_POINTS, MOST_FEATURES, MOST_LEVELS = 4096, 1 << 20, 1 << 23, 32
"""Of a file."""
MOST_BYTES = 512 << 20
FARTHEST = 1e9
"""Of places, in the map's unit."""
MOST_PX = 1e5
ORTHONORMAL = 1e-6
K, N, P, LEVELS = "keyframes", "features", "points", "levels"
MOST = {K: MOST_KEYFRAMES, N: MOST_FEATURES, P: MOST_POINTS, LEVELS: MOST_LEVELS}
SHAPES: dict[str, tuple[type, tuple[str | int, ...]]] = {
    "camera": (np.float64, (11,)),  # width, height, fx, fy, cx, cy, k1, k2, p1, p2, k3
    "lens": (np.float64, (2,)),
    "scales": (np.float64, (LEVELS,)),
    "poses": (np.float64, (K, 4, 4)),
    "sizes": (np.float64, (K,)),
    "time_s": (np.float64, (K,)),
    "component": (np.int32, (K,)),
    "feature_counts": (np.int32, (K,)),
    "xy_px": (np.float32, (N, 2)),
    "octave": (np.uint8, (N,)),
    "angle_deg": (np.float32, (N,)),
    "looks": (np.uint64, (N, 4)),
    "point_of": (np.int32, (N,)),
    "xyz": (np.float64, (P, 3)),
    "descriptors": (np.uint64, (P, 4)),
    "normals": (np.float32, (P, 3)),
    "nearest": (np.float32, (P,)),
    "farthest": (np.float32, (P,)),
    "point_component": (np.int32, (P,)),
}
"""Of each array: type, and shape; the counts are the same wherever they stand."""
OF_THE_WHOLE = ("camera", "lens", "scales")
DAMAGES = (
    ValueError, KeyError, TypeError, SyntaxError, EOFError, NotImplementedError, RuntimeError, OverflowError,
    MemoryError, struct.error, tokenize.TokenError,
)  # fmt: skip
"""What reading a damaged archive, or a header that is none, may raise besides."""


def write_map(path: Path, saved: SavedMap) -> None:
    """Into this file, whole or not at all. Raises StationError."""
    c = saved.camera
    distortion = (*c.distortion, *(0.0,) * 5)[:5]
    arrays: dict[str, Any] = saved.columns | {
        "kind": np.array(KIND),
        "version": np.array(VERSION),
        "camera": np.array([c.width_px, c.height_px, c.fx, c.fy, c.cx, c.cy, *distortion], np.float64),
        "lens": np.array(saved.lens, np.float64),
        "scales": saved.scales,
    }
    sizes = {
        "keyframes": (len(saved.columns["poses"]), MOST_KEYFRAMES),
        "points": (len(saved.columns["xyz"]), MOST_POINTS),
    }
    for name, (count, most) in sizes.items():
        if count > most:
            raise StationError(f"{path}: a map of {count} {name} is not saved; a file holds {most} at the most.")
    replace_file(path, lambda file: np.savez(file, **arrays))


def take_up_map(path: Path, say: Callable[[str], None]) -> SavedMap:
    """As `read_map`, and a line that tells what was read."""
    saved = read_map(path)
    say(f"map: {saved.told} from {path}")
    return saved


def leave_map(path: Path, saved: SavedMap | None, say: Callable[[str], None]) -> None:
    """As `write_map`, and a line that tells it. What is on file stays there when nothing is worth keeping."""
    if saved is None:
        say(f"map: too little was seen to be kept, {path} is not written")
        return
    write_map(path, saved)
    say(f"map: {saved.told} to {path}")


def read_map(path: Path) -> SavedMap:
    """Raises StationError when the file cannot be read, is none of ours, of another version, or damaged."""
    try:
        arrays = _arrays(path)
        _check(arrays)
        return SavedMap(
            camera=_camera(arrays["camera"].tolist()),
            lens=(float(arrays["lens"][0]), float(arrays["lens"][1])),
            scales=arrays["scales"],
            columns={name: array for name, array in arrays.items() if name not in OF_THE_WHOLE},
            source=str(path),
        )
    except OSError as error:
        raise StationError(f"{path} cannot be read ({error.strerror or error}).", usage=True) from error
    except zipfile.BadZipFile as error:
        raise _unreadable(path, f"it was cut short or changed, or is something else: {error}") from error
    except DAMAGES as error:
        raise _unreadable(path, str(error).strip("'")) from error
    except Exception as error:
        if type(error).__module__ not in ("zlib", "lzma", "_lzma"):
            raise
        raise _unreadable(path, str(error)) from error


def _unreadable(path: Path, why: str) -> StationError:
    text = (
        f"{path} is no map of SLAM's, or a damaged one ({why}). Give --map another file, or one that is not there yet."
    )
    return StationError(text, usage=True)


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays, with the right types and shapes."""
    with zipfile.ZipFile(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > MOST_BYTES:
            raise ValueError(f"it holds more than {MOST_BYTES >> 20} MiB")
        names = set(archive.namelist())
        if "kind.npy" not in names or str(_array(archive, "kind")) != KIND:
            raise ValueError("it says nothing of a map")
        version = _array(archive, "version")
        if version.shape != () or not np.issubdtype(version.dtype, np.integer):
            raise ValueError("it does not tell its version")
        if int(version) != VERSION:
            raise StationError(
                f"{path} is of version {int(version)}, and this program reads {VERSION}: another version of it wrote"
                " the file. Use that one, or map anew into another file.",
                usage=True,
            )
        arrays = {name: _array(archive, name) for name in SHAPES}
    counts: dict[str, int] = {}
    for name, (kind, shape) in SHAPES.items():
        array = arrays[name]
        wrong = f"{name} is {array.dtype} {array.shape}"
        if array.dtype != np.dtype(kind) or array.ndim != len(shape):
            raise ValueError(wrong)
        for length, expected in zip(array.shape, shape, strict=True):
            if isinstance(expected, str):
                if length > MOST[expected]:
                    raise ValueError(f"more than {MOST[expected]} {expected}")
                expected = counts.setdefault(expected, length)
            if length != expected:
                raise ValueError(wrong)
    return arrays


def _array(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """One array, whose header claims neither more nor less than there is."""
    data = io.BytesIO(archive.read(f"{name}.npy"))
    if np.lib.format.read_magic(data) != (1, 0):
        raise ValueError(f"{name} is of an unknown format")
    shape, _, dtype = np.lib.format.read_array_header_1_0(data)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != data.getbuffer().nbytes - data.tell():
        raise ValueError(f"{name} is not what it claims to be")
    data.seek(0)
    return np.array(np.lib.format.read_array(data, allow_pickle=False), order="C")


def _camera(numbers: list[float]) -> SlamCamera:
    width, height, *rest = numbers
    if not (width.is_integer() and height.is_integer() and max(width, height) <= 8192):
        raise ValueError("no camera")
    fx, fy, cx, cy, *distortion = rest
    used = 5 if distortion[4] else 4 if any(distortion) else 0
    if max(fx, fy, *map(abs, distortion)) > MOST_PX:
        raise ValueError("no camera")
    return SlamCamera(
        width_px=int(width), height_px=int(height), fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(distortion[:used])
    )


def _check(arrays: dict[str, np.ndarray]) -> None:
    """Raises ValueError for numbers and indices that make no map."""
    for name, (kind, _) in SHAPES.items():
        if issubclass(kind, np.floating) and not np.isfinite(arrays[name]).all():
            raise ValueError(f"{name} is not finite")
    keyframes, points = len(arrays["poses"]), len(arrays["xyz"])
    counts, octaves, scales = arrays["feature_counts"], arrays["octave"], arrays["scales"]
    zoom, radial = arrays["lens"]
    poses, normals = arrays["poses"], arrays["normals"]
    turns = poses[:, :3, :3]
    _demand(keyframes > 0 and points > 0 and len(scales) > 0, "there is nothing in it")
    _demand(0.5 <= zoom <= 2.0 and abs(radial) <= 1.0, "its lens is out of range")
    _demand(bool((scales >= 1.0).all() and (scales < MOST_PX).all()), "its pyramid is none")
    _demand(np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max() < ORTHONORMAL, "poses that do not only turn")
    _demand(bool((np.linalg.det(turns) > 0).all() and (poses[:, 3] == (0, 0, 0, 1)).all()), "poses that are none")
    _demand(max(np.abs(poses[:, :3, 3]).max(), np.abs(arrays["xyz"]).max()) <= FARTHEST, "places out of range")
    _demand(bool((arrays["sizes"] > 1 / FARTHEST).all() and (arrays["sizes"] < FARTHEST).all()), "sizes out of range")
    _demand(int(counts.min()) >= 0 and int(counts.sum(dtype=np.int64)) == len(octaves), "its features do not add up")
    _demand(int(octaves.max(initial=0)) < len(scales), "octaves out of range")
    _demand(float(np.abs(arrays["xy_px"]).max(initial=0.0)) <= MOST_PX, "keypoints out of range")
    _demand(float(np.abs(normals).max()) <= 1.01, "normals out of range")
    _demand(bool((arrays["nearest"] >= 0).all() and (arrays["farthest"] <= FARTHEST).all()), "distances out of range")
    components, seen = arrays["component"], arrays["point_of"]
    _demand(np.array_equal(np.unique(components), np.arange(components.max() + 1)), "its maps are not numbered")
    for name, of, most in (
        ("point_component", arrays["point_component"], components.max()),
        ("point_of", seen, points - 1),
    ):
        least = -1 if name == "point_of" else 0
        _demand(int(of.min(initial=0)) >= least and int(of.max(initial=0)) <= most, f"{name}: indices out of range")
    keyframe_of = np.repeat(np.arange(keyframes), counts)[seen >= 0]
    seen = seen[seen >= 0]
    same = np.array_equal(components[keyframe_of], arrays["point_component"][seen])
    _demand(same, "a keyframe sees a point of another map")
    _demand(len(np.unique(keyframe_of * points + seen)) == len(seen), "a keyframe sees a point twice")


def _demand(holds: bool, otherwise: str) -> None:
    if not holds:
        raise ValueError(otherwise)
