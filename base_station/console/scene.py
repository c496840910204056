"""The map in three dimensions: points, keyframes, and the camera. Its objects are made once, and moved."""

from __future__ import annotations

from typing import Any

import numpy as np

from base_station.console.feed import Feed
from base_station.publication.schema import Map, State

FPS = 6
POINT, KEYFRAME, CAMERA = "#b9c4cf", "#e08a1e", "#3b8ff0"
SIDES = ((-1, -0.75), (1, -0.75), (1, 0.75), (-1, 0.75))
"""Corners of the camera's picture, x and y at depth 1.6."""
EXTENT = 3.0
"""Half the scene; a map of any unit is scaled to that."""


class Scene:
    """Hidden until a map comes; then built."""

    def __init__(self, ui: Any, feed: Feed) -> None:
        self._ui, self._feed, self._number = ui, feed, 0
        self._scene: Any = None
        with ui.element("div").classes("panel map hide") as self._panel:
            with ui.element("div").classes("title"):
                ui.label("Map")
                self._counts = ui.label()
            self._place = ui.element("div").classes("place")

    def show(self, state: State) -> None:
        """Bring in what has changed."""
        shown = state.tracker == "slam" and self._feed.map is not None
        if ("hide" in self._panel.classes) == shown:
            self._panel.classes(toggle="hide")
        if not shown or self._number == self._feed.map_number:
            return
        self._number = self._feed.map_number
        if self._scene is None:
            self._build()
        assert self._feed.map is not None
        self._draw(self._feed.map)

    def _build(self) -> None:
        with self._place:
            self._scene = self._ui.scene(width=700, height=300, grid=(10, 10), fps=FPS, background_color="#12171c")
        self._scene.style("width: 100%; height: 100%").classes("scene")
        with self._scene as scene:
            self._points = scene.point_cloud([[0, 0, 0]], point_size=0.06).material(POINT)
            self._keyframes = scene.point_cloud([[0, 0, 0]], point_size=0.18).material(KEYFRAME)
            with scene.group() as self._camera:
                corners = [[x * 0.25, y * 0.25, 0.4] for x, y in SIDES]
                for i, corner in enumerate(corners):
                    scene.line([0, 0, 0], corner).material(CAMERA)
                    scene.line(corner, corners[(i + 1) % 4]).material(CAMERA)
        scene.move_camera(x=0, y=-7.5, z=4.5, look_at_x=0, look_at_y=-1.5, look_at_z=0, duration=0)

    def _draw(self, world: Map) -> None:
        points, keyframes = rows_of(world.points), rows_of(world.keyframes)
        self._counts.set_text(f"{world.keyframe_count} keyframes, {world.point_count} points")
        pose = np.reshape(world.camera or (), (-1, 4)) if len(world.camera or ()) == 16 else None
        middle, scale = fitted(points, keyframes if pose is None else np.vstack([keyframes, pose[:3, 3]]))
        for cloud, rows in ((self._points, points), (self._keyframes, keyframes)):
            cloud.set_points(np.round(to_scene((rows - middle) * scale), 3).tolist())
        self._camera.visible(pose is not None)
        if pose is not None:
            self._camera.move(*to_scene((pose[:3, 3] - middle)[None] * scale)[0].tolist())
            self._camera.rotate_R((AXES @ pose[:3, :3]).tolist())


AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From the map's axes (x right, y down, z ahead) to the scene's (x right, y ahead, z up)."""


def to_scene(rows: np.ndarray) -> np.ndarray:
    """(n, 3) from the map's axes to the scene's."""
    return rows @ AXES.T


def fitted(points: np.ndarray, cameras: np.ndarray) -> tuple[np.ndarray, float]:
    """Middle (3,) and scale that bring most of the points (n, 3), and all cameras (m, 3), into the scene."""
    ends = [np.percentile(points, (10, 90), axis=0)] if len(points) else []
    if len(cameras):
        ends.append(np.stack([cameras.min(0), cameras.max(0)]))
    if not ends:
        return np.zeros(3), 1.0
    low, high = np.min([end[0] for end in ends], 0), np.max([end[1] for end in ends], 0)
    half = float((high - low).max()) / 2
    return (low + high) / 2, EXTENT / half if half > 1e-9 else 1.0


def rows_of(data: bytes) -> np.ndarray:
    """(n, 3) of float32 numbers, little endian; what is no whole row is left out."""
    numbers = np.frombuffer(data[: len(data) // 12 * 12], "<f4").astype(float)
    return numbers.reshape(-1, 3)
