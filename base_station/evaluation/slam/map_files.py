"""A SLAM map for other programs: COLMAP's text model and PLY.

Keyframes and points only: what each keyframe saw of which point is not in these files. COLMAP counts pixels from the
picture's corner, so its principal point is half a pixel more than ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from base_station.errors import StationError
from base_station.evaluation.slam.trajectory import Trajectory, quaternions
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.sim3 import inverse

POINT_COLOR, KEYFRAME_COLOR = (90, 90, 90), (220, 60, 40)
"""Red, green, blue."""


def write_colmap(
    folder: Path, camera: SlamCamera, keyframes: Trajectory, names: Sequence[str], points: np.ndarray
) -> None:
    """cameras.txt, images.txt and points3D.txt in `folder`, which is made. `names`: the keyframes' picture files.

    Raises StationError when they cannot be written.
    """
    model, numbers = _colmap_camera(camera)
    size = f"{camera.width_px} {camera.height_px}"
    cameras = [f"1 {model} {size} " + " ".join(f"{number:.9g}" for number in numbers)]
    cam_from_world = inverse(keyframes.world_from_cam)
    turns, at = quaternions(cam_from_world[:, :3, :3])[:, [3, 0, 1, 2]], cam_from_world[:, :3, 3]
    images = []
    for number, (turn, place, name) in enumerate(zip(turns, at, names, strict=True), 1):
        images += [f"{number} " + " ".join(f"{value:.12g}" for value in (*turn, *place)) + f" 1 {name}", ""]
    gray = " ".join(map(str, POINT_COLOR))
    cloud = [f"{number} {x:.9g} {y:.9g} {z:.9g} {gray} 0" for number, (x, y, z) in enumerate(points, 1)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, lines in (("cameras.txt", cameras), ("images.txt", images), ("points3D.txt", cloud)):
            (folder / name).write_text("\n".join([_HEADERS[name], *lines]) + "\n", encoding="utf-8")
    except OSError as error:
        raise StationError(f"{folder} cannot be written ({error.strerror}).") from error


_HEADERS = {
    "cameras.txt": "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]",
    "images.txt": "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of POINTS2D[] as (X Y POINT3D_ID)",
    "points3D.txt": "# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX)",
}


def _colmap_camera(camera: SlamCamera) -> tuple[str, tuple[float, ...]]:
    pinhole = (camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5)
    if not any(camera.distortion):
        return "PINHOLE", pinhole
    if len(camera.distortion) == 4 or camera.distortion[4] == 0:
        return "OPENCV", (*pinhole, *camera.distortion[:4])
    return "FULL_OPENCV", (*pinhole, *camera.distortion, 0.0, 0.0, 0.0)


def write_ply(path: Path, points: np.ndarray, keyframes: Trajectory) -> None:
    """Points, and the keyframes' places in another colour, as one cloud. Raises StationError."""
    vertices = [(place, POINT_COLOR) for place in points] + [(place, KEYFRAME_COLOR) for place in keyframes.positions]
    header = [
        "ply", "format ascii 1.0", "comment points of a map, and keyframes in red", f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {color}" for color in ("red", "green", "blue")),
        "end_header",
    ]  # fmt: skip
    lines = [f"{x:.6g} {y:.6g} {z:.6g} {red} {green} {blue}" for (x, y, z), (red, green, blue) in vertices]
    try:
        path.write_text("\n".join([*header, *lines]) + "\n", encoding="ascii")
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error
