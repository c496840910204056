"""The camera that explains the views: a pinhole with radial and tangential distortion (OpenCV's calibrateCamera).

Views that fit much worse than the others (a bent board, a picture taken in motion) are left out, one after another.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.calibration.detection import BoardView
from base_station.errors import StationError
from protocol import Intrinsics
from protocol.camera_file import CameraFile

LEAST_VIEWS = 5
KEPT_SHARE = 0.7
"""At the least so many of the views are kept."""
OUTLIER = 2.5
"""A view is left out whose error is more than so many times the median one."""
FINE_RMS_PX = 0.1
"""No view is bad that fits this well."""
POOR_RMS_PX = 1.0
UNSURE = 0.01
"""Of a focal length, and for the axis of the picture's longer side: a standard deviation that is worth a warning."""
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """`deviations`: the standard deviation of each of NAMES that was estimated. `errors_px`: of each view that was
    kept, the RMS distance of its corners from where the camera should see them; `left_out`: the others' numbers,
    from 0."""

    file: CameraFile
    deviations: dict[str, float]
    rms_px: float
    errors_px: tuple[float, ...]
    kept: tuple[int, ...]
    left_out: tuple[int, ...]
    fov_rad: tuple[float, float]
    """Across and down the middle of the picture, distortion included."""

    def warnings(self) -> list[str]:
        """What makes this result doubtful, in words."""
        found = []
        if self.rms_px > POOR_RMS_PX:
            found.append(f"the views do not fit well ({self.rms_px:.2f} px): is the board flat, was it measured?")
        own = self.file.intrinsics
        for name, value in (("fx", own.fx), ("fy", own.fy)):
            if self.deviations[name] > UNSURE * value:
                found.append(f"{name} is known to {self.deviations[name] / value:.1%} only: tilt the board more")
        if max(self.deviations["cx"], self.deviations["cy"]) > UNSURE * max(self.file.size or (0, 0)):
            found.append("where the axis meets the picture (cx, cy) is hardly known: tilt the board more to all sides")
        return found


def calibrate(views: Sequence[BoardView], *, k3: bool = False) -> Calibration:
    """`k3`: estimate the third radial coefficient too, which wide lenses need and others are better without.

    Raises StationError when there are too few views, or they explain no camera.
    """
    if len(views) < LEAST_VIEWS:
        raise StationError(f"There are {len(views)} views of the board; {LEAST_VIEWS} are the least, 20 are good.")
    sizes = {view.size_px for view in views}
    if len(sizes) > 1:
        text = ", ".join(f"{width}x{height}" for width, height in sorted(sizes))
        raise StationError(f"The pictures have several sizes ({text}): take those of one.")
    kept = list(range(len(views)))
    while True:
        found = _solve([views[number] for number in kept], k3)
        errors = found[-1]
        worst = int(errors.argmax())
        tolerable = max(OUTLIER * float(np.median(errors)), FINE_RMS_PX)
        fewest = max(LEAST_VIEWS, math.ceil(KEPT_SHARE * len(views)))
        if errors[worst] <= tolerable or len(kept) <= fewest:
            break
        del kept[worst]
    rms, matrix, distortion, deviations, errors = found
    size = views[0].size_px
    intrinsics = Intrinsics(
        fx=float(matrix[0, 0]),
        fy=float(matrix[1, 1]),
        cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]),
        distortion=tuple(distortion.tolist()),
    )
    return Calibration(
        file=CameraFile(intrinsics=intrinsics, size=size),
        deviations=dict(zip(NAMES if k3 else NAMES[:-1], deviations.tolist(), strict=False)),
        rms_px=rms,
        errors_px=tuple(errors.tolist()),
        kept=tuple(kept),
        left_out=tuple(sorted(set(range(len(views))) - set(kept))),
        fov_rad=_field_of_view(matrix, distortion, size),
    )


def _solve(views: Sequence[BoardView], k3: bool) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """RMS error, matrix (3, 3), coefficients, deviations of them all, error of each view."""
    flags = 0 if k3 else cv2.CALIB_FIX_K3
    boards, points = [view.board_m for view in views], [view.points_px for view in views]
    try:
        rms, matrix, distortion, _, _, deviations, _, errors = cv2.calibrateCameraExtended(
            boards, points, views[0].size_px, np.eye(3), np.zeros(5), flags=flags
        )
    except cv2.error as error:
        raise StationError("These views explain no camera: take more, with the board tilted to all sides.") from error
    numbers = np.asarray(distortion, float).ravel()[: 5 if k3 else 4]
    if not (math.isfinite(rms) and np.isfinite(matrix).all() and np.isfinite(numbers).all()):
        raise StationError("These views explain no camera: take more, with the board tilted to all sides.")
    return float(rms), np.asarray(matrix), numbers, np.asarray(deviations).ravel()[:9], np.asarray(errors).ravel()


def _field_of_view(matrix: np.ndarray, distortion: np.ndarray, size: tuple[int, int]) -> tuple[float, float]:
    """Between the outer edges of the outermost pixels, along the row and the column of the principal point."""
    width, height = size
    cx, cy = matrix[0, 2], matrix[1, 2]
    edges = np.array([[(-0.5, cy)], [(width - 0.5, cy)], [(cx, -0.5)], [(cx, height - 0.5)]])
    rays = cv2.undistortPoints(edges, matrix, distortion)[:, 0]
    left, right, top, bottom = np.arctan([rays[0, 0], rays[1, 0], rays[2, 1], rays[3, 1]])
    return float(right - left), float(bottom - top)
