"""Measures of the Thymio II and how its proximity sensors answer. The origin lies on the floor below the middle of the
wheel axle, x forward, y left."""

from __future__ import annotations

import math

from protocol import RobotLimits

LIMITS = RobotLimits()
WHEEL_RADIUS_M = 0.022
MASS_KG = 0.270
BODY_BACK_M, BODY_FRONT_M, BODY_HALF_WIDTH_M = -0.030, 0.082, 0.055
BODY_BOTTOM_M, BODY_TOP_M = 0.006, 0.053
CAMERA_HEIGHT_M = 0.10
WHEEL_RESPONSE_S = 0.05
"""Time constant of the wheels' speed."""
RADIANS_PER_UNIT_S = LIMITS.metres_per_unit_s / WHEEL_RADIUS_M
"""Wheel rotation at one motor unit."""

SENSOR_HEIGHT_M = 0.035
SENSOR_RANGE_M = 0.12
CONTACT_VALUE = 4500

_SHOULDER_M = 0.050
"""Where the straight side ends and the front's arc begins."""
_BULGE_M = BODY_FRONT_M - _SHOULDER_M
_ARC_RADIUS_M = (BODY_HALF_WIDTH_M**2 + _BULGE_M**2) / (2.0 * _BULGE_M)
_ARC_CENTRE_M = BODY_FRONT_M - _ARC_RADIUS_M


def outline() -> list[tuple[float, float]]:
    """The body seen from above: corners (x, y) of a convex polygon, counter-clockwise."""
    limit = math.asin(BODY_HALF_WIDTH_M / _ARC_RADIUS_M)
    arc = [_on_arc(limit * k / 6) for k in range(-6, 7)]
    return [(BODY_BACK_M, -BODY_HALF_WIDTH_M), *arc, (BODY_BACK_M, BODY_HALF_WIDTH_M)]


def sensors() -> list[tuple[float, float, float]]:
    """(x, y, direction) of the proximity sensors in m and rad: five in front left to right, two rear left to right."""
    front = [(*_on_arc(math.radians(degrees)), math.radians(degrees)) for degrees in (40, 20, 0, -20, -40)]
    return [*front, (BODY_BACK_M, 0.03, math.pi), (BODY_BACK_M, -0.03, math.pi)]


def proximity_value(distance_m: float) -> int:
    """What a sensor says of an obstacle so far away: 4500 at contact, falling to 0 at 12 cm and beyond."""
    share = min(max(distance_m / SENSOR_RANGE_M, 0.0), 1.0)
    return round(CONTACT_VALUE * (1.0 - share**1.5))


def _on_arc(angle_rad: float) -> tuple[float, float]:
    return _ARC_CENTRE_M + _ARC_RADIUS_M * math.cos(angle_rad), _ARC_RADIUS_M * math.sin(angle_rad)
