"""The map in three dimensions: points, keyframes and the camera, drawn by `static/world.js`. Made once, then moved."""

from __future__ import annotations

import base64
import functools
import types
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from base_station.console.feed import Feed
from base_station.publication.schema import Map, State

FPS = 6
WORLD = Path(__file__).parent / "static" / "world.js"
EXTENT = 3.0
"""Half the scene; a map of any unit is scaled to that."""
FIELD_DEG = 46.0
VIEW = {"x": 0.0, "y": -8.6, "z": 5.2, "look_at_x": 0.0, "look_at_y": 0.7, "look_at_z": 0.3}
"""From behind and above. A field of view that is no wider keeps the far end from shrinking to nothing."""
MOST_OFF, MOST_LARGER = 0.25, 1.3
"""The scene is fitted anew when the map's middle has moved by more (in extents), or its size changed by this factor."""


@dataclass(frozen=True)
class Fit:
    """What of the map is the scene's middle, x, y and z, and how long its unit is there."""

    middle: tuple[float, float, float]
    scale: float


class Scene:
    """Hidden while the tracker makes no map; built when one first does."""

    def __init__(self, ui: Any, feed: Feed) -> None:
        self._ui, self._feed, self._number = ui, feed, 0
        self._scene: Any = None
        self._world: Any = None
        self._drawn: Map | None = None
        self._fit: Fit | None = None
        with ui.element("div").classes("panel map hide") as self._panel:
            with ui.element("div").classes("title"):
                ui.label("Map")
                with ui.element("div").classes("legend"):
                    self._keyframes = ui.label().classes("keyframes")
                    self._points = ui.label().classes("points")
                    self._camera = ui.label().classes("camera")
            self._place = ui.element("div").classes("place").props("id=map")

    def show(self, state: State) -> None:
        """Bring in what has changed."""
        world = self._feed.map
        shown = world is not None and world.tracker == state.tracker
        if ("hide" in self._panel.classes) == shown:
            self._panel.classes(toggle="hide")
        if world is None or not shown or self._number == self._feed.map_number:
            return
        self._number = self._feed.map_number
        if self._scene is None:
            self._build()
        self._draw(world)

    def _build(self) -> None:
        ui = self._ui
        camera = ui.scene.perspective_camera(fov=FIELD_DEG)
        with self._place:
            self._scene = ui.scene(grid=False, camera=camera, fps=FPS, background_color="#12171c")
        self._scene.style("width: 100%; height: 100%").classes("scene")
        with self._scene:
            self._world = world_kind(ui)()
        self._scene.move_camera(**VIEW, duration=0)

    def _draw(self, world: Map) -> None:
        points, keyframes, pose = rows_of(world.points), rows_of(world.keyframes), pose_of(world)
        self._keyframes.set_text(f"{world.keyframe_count} keyframes")
        self._points.set_text(f"{world.point_count} points")
        self._camera.set_text(
            "camera" if pose is not None else "camera: not placed" if len(keyframes) else "no map yet"
        )
        cameras = keyframes if pose is None else np.vstack([keyframes, pose[:3, 3]])
        self._fit = kept_fit(self._fit, fitted(points, cameras))
        told = [
            text_of(points),
            text_of(keyframes),
            None if pose is None else pose.ravel().tolist(),
            {"middle": self._fit.middle, "scale": self._fit.scale},
            float(np.median(keyframes[:, 1])) if len(keyframes) else 0.0,
        ]
        self._world.args = told  # for a browser that has to build it anew
        old = self._drawn
        same = old is not None and (world.points == old.points, world.keyframes == old.keyframes)
        self._drawn = world
        changed = [None if same and same[i] else told[i] for i in range(2)]
        self._world.run_method("show", *changed, *told[2:])


@functools.cache
def world_kind(ui: Any) -> Any:
    """The class of objects that `world.js` draws. NiceGUI serves that file from the moment the class is made."""
    return types.new_class("World", (ui.scene.group,), {"component": WORLD})


def fitted(points: np.ndarray, cameras: np.ndarray) -> Fit:
    """What brings most of the points (n, 3), and all cameras (m, 3), into the scene."""
    ends = [np.percentile(points, (10, 90), axis=0)] if len(points) else []
    if len(cameras):
        ends.append(np.stack([cameras.min(0), cameras.max(0)]))
    if not ends:
        return Fit((0.0, 0.0, 0.0), 1.0)
    low, high = np.min([end[0] for end in ends], 0), np.max([end[1] for end in ends], 0)
    half = float((high - low).max()) / 2
    x, y, z = ((low + high) / 2).tolist()
    return Fit((x, y, z), EXTENT / half if half > 1e-9 else 1.0)


def kept_fit(old: Fit | None, new: Fit) -> Fit:
    """The old one as long as it does: a scene that is fitted anew with each map never stands still."""
    if old is None:
        return new
    off = float(np.abs(np.subtract(new.middle, old.middle)).max()) * new.scale / EXTENT
    larger = max(new.scale / old.scale, old.scale / new.scale)
    return old if off < MOST_OFF and larger < MOST_LARGER else new


def rows_of(data: bytes) -> np.ndarray:
    """(n, 3) of float32 numbers, little endian; what is no whole row, or not finite, is left out."""
    rows = np.frombuffer(data[: len(data) // 12 * 12], "<f4").reshape(-1, 3)
    return rows[np.isfinite(rows).all(1)]


def pose_of(world: Map) -> np.ndarray | None:
    """world_from_cam, 4x4; None when it is not known."""
    pose = np.array(world.camera or (), float)
    return pose.reshape(4, 4) if pose.size == 16 and np.isfinite(pose).all() else None


def text_of(rows: np.ndarray) -> str:
    """As `world.js` reads it."""
    return base64.b64encode(rows.astype("<f4").tobytes()).decode()
