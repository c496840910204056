"""The SLAM camera: a pinhole with radial-tangential distortion. Keypoints are undistorted once; all else is pinhole.

The model is OpenCV's (Brown-Conrady): k1, k2, k3 radial, p1, p2 tangential. Pixel centres are at integer coordinates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numba import njit

from base_station.geometry import DEFAULT_FOV_RAD, PinholeCamera

COEFFICIENTS = (0, 4, 5)
"""How many distortion coefficients there may be: none, k1 k2 p1 p2, or k3 as the fifth."""
SMALLEST_SIDE_PX = 64
ASSUMED_SIGMA = 0.1
"""`focal_sigma` and `radial_sigma` of a field of view that was only assumed."""
NEWTON_STEPS = 12
"""Three or four do, but at the border of a lens that distorts much."""
LEAST_DETERMINANT = 1e-2
"""Of how far the picture is drawn out about a point: below, the lens folds it over, and Newton's step is a leap."""
CLOSE = 1e-9
"""A step, in focal lengths, after which there is no other."""


@dataclass(frozen=True, kw_only=True)
class SlamCamera:
    """Size of the picture, focal lengths and principal point in px, `distortion` (k1, k2, p1, p2[, k3]).

    Raises ValueError for what cannot be a camera: a picture below 64 px, a focal length that is not positive, a
    principal point outside of the picture, numbers that are not finite, a wrong count of coefficients.
    """

    width_px: int
    height_px: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    focal_sigma: float = 0.01
    """Standard deviation of the focal lengths, as a share of them: how far the calibration is to be trusted..."""
    radial_sigma: float = 0.02
    """...and of k1. When one is 0, the calibration is exact, and is left alone."""

    def __post_init__(self) -> None:
        if min(self.width_px, self.height_px) < SMALLEST_SIDE_PX:
            raise ValueError(
                f"a camera of {self.width_px}x{self.height_px} px: SLAM needs {SMALLEST_SIDE_PX} px at the least"
            )
        if not all(map(math.isfinite, (self.fx, self.fy, self.cx, self.cy, *self.distortion))):
            raise ValueError("a camera's numbers must be finite")
        if min(self.fx, self.fy) <= 0:
            raise ValueError(f"focal lengths must be positive: fx {self.fx}, fy {self.fy}")
        if not (0 <= self.cx < self.width_px and 0 <= self.cy < self.height_px):
            raise ValueError(f"the principal point ({self.cx}, {self.cy}) lies outside of the picture")
        if not (0 <= self.focal_sigma < 1 and 0 <= self.radial_sigma < 1):
            raise ValueError(f"focal_sigma {self.focal_sigma} and radial_sigma {self.radial_sigma} must be from 0 to 1")
        if len(self.distortion) not in COEFFICIENTS:
            raise ValueError(f"distortion has {len(self.distortion)} numbers; it is k1 k2 p1 p2, and k3 where known")

    @classmethod
    def with_fov(cls, width_px: int, height_px: int, fov_rad: float = DEFAULT_FOV_RAD) -> SlamCamera:
        """A camera that is not calibrated: square pixels, the axis through the middle, this horizontal field of view.

        The default field of view, 62.2 degrees, is the Raspberry Pi camera 2's.
        """
        camera = cls.of(PinholeCamera.with_fov(width_px, height_px, fov_rad))
        return replace(camera, focal_sigma=ASSUMED_SIGMA, radial_sigma=ASSUMED_SIGMA)

    @classmethod
    def of(cls, camera: PinholeCamera) -> SlamCamera:
        """The same camera as the station's frames carry it."""
        return cls(
            width_px=camera.width,
            height_px=camera.height,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
            distortion=camera.distortion,
        )

    @cached_property
    def matrix(self) -> np.ndarray:
        """3x3 calibration matrix."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def intrinsics(self) -> np.ndarray:
        """(fx, fy, cx, cy) float64, as the compiled kernels take it."""
        return np.array([self.fx, self.fy, self.cx, self.cy])

    @cached_property
    def bounds_px(self) -> np.ndarray:
        """(left, top, right, bottom) of the undistorted picture: beyond, no keypoint can lie."""
        right, bottom = self.width_px - 1.0, self.height_px - 1.0
        if not self.distorts:
            return np.array([0.0, 0.0, right, bottom])
        steps = np.linspace(0.0, 1.0, 9)
        border = [(x * right, y * bottom) for x in steps for y in steps if x in (0.0, 1.0) or y in (0.0, 1.0)]
        seen = self.undistort(np.array(border, np.float32))
        return np.concatenate([seen.min(axis=0), seen.max(axis=0)]).astype(np.float64)

    @property
    def distorts(self) -> bool:
        return any(self.distortion)

    def rays(self, undistorted_px: np.ndarray) -> np.ndarray:
        """What lies a unit before the camera (n, 3) where a picture without distortion has these places (n, 2)."""
        return np.column_stack(
            [(undistorted_px - self.intrinsics[2:]) / self.intrinsics[:2], np.ones(len(undistorted_px))]
        )

    def project(self, in_cam: np.ndarray) -> np.ndarray:
        """Where a picture without distortion shows points (n, 3) of the camera's coordinates, (n, 2); NaN behind it."""
        with np.errstate(divide="ignore", invalid="ignore"):
            seen_px = in_cam[:, :2] / in_cam[:, 2:] * self.intrinsics[:2] + self.intrinsics[2:]
        seen_px[in_cam[:, 2] <= 0] = np.nan
        return np.asarray(seen_px)

    def undistort(self, points_px: np.ndarray) -> np.ndarray:
        """Where points (n, 2) of the picture would lie without distortion, float32 px."""
        points_px = np.ascontiguousarray(points_px, np.float32)
        if not self.distorts or not len(points_px):
            return points_px
        return _undistort(points_px, self.intrinsics, np.array((*self.distortion, 0.0))[:5])

    def distort(self, points_px: np.ndarray) -> np.ndarray:
        """The way back: where the picture shows what an ideal pinhole sees at these points (n, 2), float64 px."""
        points_px = np.asarray(points_px, np.float64)
        if not self.distorts or not len(points_px):
            return points_px
        rays = np.ones((len(points_px), 3))
        rays[:, :2] = (points_px - (self.cx, self.cy)) / (self.fx, self.fy)
        seen, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.matrix, np.array(self.distortion))
        return seen[:, 0]


@njit(cache=True, nogil=True)
def _undistort(points_px, intrinsics, coefficients):
    """By Newton's method on `SlamCamera.distort`, for each point from where the picture shows it."""
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    k1, k2, p1, p2, k3 = coefficients[0], coefficients[1], coefficients[2], coefficients[3], coefficients[4]
    ideal = np.empty((len(points_px), 2), np.float32)
    for i in range(len(points_px)):
        seen_x, seen_y = (points_px[i, 0] - cx) / fx, (points_px[i, 1] - cy) / fy
        x, y = seen_x, seen_y
        for _ in range(NEWTON_STEPS):
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = 2.0 * (k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3))
            off_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - seen_x
            off_y = y * radial + 2.0 * p2 * x * y + p1 * (r2 + 2.0 * y * y) - seen_y
            xx = radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
            yy = radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
            xy = slope * x * y + 2.0 * p1 * x + 2.0 * p2 * y
            determinant = xx * yy - xy * xy
            if determinant > LEAST_DETERMINANT:
                off_x, off_y = (yy * off_x - xy * off_y) / determinant, (xx * off_y - xy * off_x) / determinant
            x, y = x - off_x, y - off_y
            if abs(off_x) < CLOSE and abs(off_y) < CLOSE:
                break
        ideal[i, 0], ideal[i, 1] = fx * x + cx, fy * y + cy
    return ideal
