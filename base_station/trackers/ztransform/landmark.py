"""A landmark: what is kept of a learned target or place, so that it is recognised, and tracked, much later.

It is a small picture (72 x 72 cells) of the box and half as much around it, 48 cells across the box, which is as finely
as the tracker reads; where the box was and in which camera; and a map made from it once, which refines what the look-up
found. All of it takes under 8 KiB.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH, X, Y, sample_patch
from base_station.trackers.ztransform.outline import lens_of, place_placement
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.types import Box, Frame

CELLS, BOX_CELLS = 72, 48
"""Of the small picture, and of the box in it."""
MARGIN = CELLS / BOX_CELLS
LONGEST_NAME = 64


@dataclass(frozen=True, kw_only=True)
class Landmark:
    """`camera`: the one it was learned in. `box`: None is a place, the whole view."""

    name: str
    camera: PinholeCamera
    box: Box | None
    picture: np.ndarray
    """uint8 (72, 72). Of a place: on the cylinder about the camera."""
    step_map: np.ndarray
    """float16 (5, numbers), see `regression`."""
    learned_depth_m: float | None = None
    """How far away it was along the optical axis, where that is known."""

    def placement(self, camera: PinholeCamera) -> np.ndarray:
        """Where it was learned, as seen by this camera; see `kernels`."""
        here = place_placement(self.camera) if self.box is None else box_placement(self.box)
        return seen_by(here, self.camera, camera)

    def frame(self, camera: PinholeCamera) -> tuple[Frame, Box | None]:
        """The frame, made from the small picture, and the box in it that any tracker can learn it from again.

        For a camera of any size and focal length. What lies around the small picture continues its border.
        """
        placement = self.placement(camera)
        x, y = np.meshgrid(np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32))
        image = self.picture_at(x, y, camera)
        frame = Frame(image=np.clip(np.round(image), 0, 255).astype(np.uint8), number=0, time_s=0.0, camera=camera)
        return frame, None if self.box is None else Box.around(*(float(placement[i]) for i in (X, Y, WIDTH, HEIGHT)))

    def picture_at(self, x: np.ndarray, y: np.ndarray, camera: PinholeCamera) -> np.ndarray:
        """What the small picture shows at these pixels of this camera, float32; shapes (rows, columns)."""
        placement = self.placement(camera)
        if self.box is None:
            azimuth = np.arctan((x - camera.cx) / camera.fx)
            x, y = camera.cx + camera.fx * azimuth, camera.cy + (y - camera.cy) * np.cos(azimuth)
        column = (x - placement[X]) / placement[WIDTH] * BOX_CELLS + (CELLS - 1) / 2
        row = (y - placement[Y]) / placement[HEIGHT] * BOX_CELLS + (CELLS - 1) / 2
        image = cv2.remap(
            self.picture.astype(np.float32),
            column.astype(np.float32),
            row.astype(np.float32),
            cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return np.asarray(image, np.float32)


def box_placement(box: Box) -> np.ndarray:
    """See `kernels`."""
    return np.array([*box.center_px, box.width, box.height, 0.0])


def seen_by(placement: np.ndarray, camera: PinholeCamera, other: PinholeCamera) -> np.ndarray:
    """The placement of the same thing in another camera that looks the same way."""
    scale_x, scale_y = other.fx / camera.fx, other.fy / camera.fy
    return np.array(
        [
            other.cx + (placement[X] - camera.cx) * scale_x,
            other.cy + (placement[Y] - camera.cy) * scale_y,
            placement[WIDTH] * scale_x,
            placement[HEIGHT] * scale_y,
            placement[4],
        ]
    )


def small_picture(pyramid: Pyramid, placement: np.ndarray, camera: PinholeCamera, *, curved: bool) -> np.ndarray:
    """uint8 (72, 72): the placement and half as much around it. Outside of the frame it repeats the frame's border."""
    wide = placement.copy()
    wide[[WIDTH, HEIGHT]] *= MARGIN
    patch, seen = np.empty((CELLS, CELLS), np.float32), np.empty((CELLS, CELLS), np.uint8)
    image, scale, reads = pyramid.for_cell(max(wide[WIDTH], wide[HEIGHT]) / CELLS)
    sample_patch(image, scale, wide, lens_of(camera, curved=curved), reads, patch, seen)
    return np.clip(np.round(patch), 0, 255).astype(np.uint8)


def check_name(name: str) -> None:
    """Raises ValueError, in words, for a name that is empty, too long, or could not be typed again."""
    if not name or len(name) > LONGEST_NAME or not name.isprintable() or name != name.strip():
        raise ValueError(f"{name!r} is no name for a landmark: 1 to {LONGEST_NAME} printable characters")
