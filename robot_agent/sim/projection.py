"""Where a square picture appears in the camera: its outline, the box a user would draw, its direction.

Camera coordinates are OpenCV's: x right, y down, z along the optical axis; pixel centres lie at integers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from protocol import Intrinsics

HORIZONTAL_FOV_RAD = math.radians(62.2)
USER_BOX_SHARE = 0.94
"""A careful user stays a little inside the picture's outline."""

_MIN_FACING_COSINE = math.cos(math.radians(80.0))


def pinhole(width: int, height: int) -> Intrinsics:
    """The simulated lens: 62.2 degrees across the width, square pixels, no distortion."""
    focal_px = width / 2.0 / math.tan(HORIZONTAL_FOV_RAD / 2.0)
    return Intrinsics(fx=focal_px, fy=focal_px, cx=(width - 1) / 2.0, cy=(height - 1) / 2.0)


@dataclass(frozen=True, kw_only=True)
class PictureView:
    """A picture as the camera has it: `centre` float64 (3,) and `corners` float64 (4, 3), in camera coordinates (m),
    corners in order round the outline; `normal` float64 (3,), unit length, out of the printed face."""

    centre: np.ndarray
    corners: np.ndarray
    normal: np.ndarray

    @property
    def bearing_rad(self) -> float:
        """Horizontal direction of the centre from the optical axis, left positive."""
        return math.atan2(-self.centre[0], self.centre[2])

    @property
    def range_m(self) -> float:
        """Distance of the centre from the camera."""
        return float(np.linalg.norm(self.centre))

    def outline_px(self, intrinsics: Intrinsics) -> np.ndarray | None:
        """The corners in the image, float64 (4, 2); None when one lies behind the camera."""
        if self.corners[:, 2].min() <= 1e-3:
            return None
        ideal = self.corners[:, :2] / self.corners[:, 2:]
        return ideal * (intrinsics.fx, intrinsics.fy) + (intrinsics.cx, intrinsics.cy)

    def is_framed(self, intrinsics: Intrinsics, width: int, height: int) -> bool:
        """Whether the printed face is turned to the camera and its whole outline lies in the image."""
        outline = self.outline_px(intrinsics)
        if outline is None or float(-self.normal @ self.centre) < _MIN_FACING_COSINE * self.range_m:
            return False
        low, high = outline.min(axis=0), outline.max(axis=0)
        return bool((low >= -0.5).all() and high[0] <= width - 0.5 and high[1] <= height - 0.5)


def user_box(view: PictureView, intrinsics: Intrinsics) -> tuple[float, float, float, float]:
    """x, y, width, height (whole px) of the box a careful user drags. The picture must be in front of the camera."""
    outline = view.outline_px(intrinsics)
    if outline is None:
        raise ValueError("the picture is behind the camera")
    low, high = outline.min(axis=0), outline.max(axis=0)
    middle, size = (low + high) / 2.0, np.round((high - low) * USER_BOX_SHARE)
    # A box of w columns from x on covers x-0.5 .. x+w-0.5.
    x, y = np.round(middle - (size - 1.0) / 2.0)
    return float(x), float(y), float(size[0]), float(size[1])
