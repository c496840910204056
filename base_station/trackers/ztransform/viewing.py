"""At which angle a flat target is seen, from what the angle does to the target's outline.

Let psi be the turn of the target's plane against the image plane (clockwise from above positive), a the target's
azimuth to the right of the optical axis, f the focal length and w0 the learned width. The view of the plane has

    keystone          q = (w0 / f) zoom sin(psi)             one side is nearer, hence taller
    width / height    A = cos(psi) - tan(a) sin(psi)         against the learned ratio

and the line of sight meets the plane at -(psi + a) from its normal. q tells the sign, and all there is to know near the
frontal view, where A is flat; aslant A is the more exact one. The tracker has both already, so the angle costs a few
Newton steps on their weighted sum of squares. (Two trackers on the target's halves would give the depth Z0 / sy of
each: that is q again, at more than twice the cost.)
"""

from __future__ import annotations

import math

from numba import njit

from base_station.trackers.ztransform.kernels import HEIGHT, KEYSTONE, WIDTH, X

KEYSTONE_SIGMA, ASPECT_SIGMA = 0.006, 0.004
"""How exact the tracker is in each, for their weights; only the ratio counts."""
STEEPEST_RAD = math.radians(75.0)
STEPS = 6


@njit(cache=True, error_model="numpy")
def view_angle_rad(placement, learned, lens):
    """How far the line of sight has turned since the target was learned, see `TrackerResult.view_angle_rad`.

    `placement`, `learned`: see `kernels`; `lens`: of a flat view. The learned view is taken as square to the target.
    Exact for an upright flat target whose plane is turned by less than 75 degrees against the image.
    """
    x, width, height, keystone = placement[X], placement[WIDTH], placement[HEIGHT], placement[KEYSTONE]
    x0, width0, height0 = learned[X], learned[WIDTH], learned[HEIGHT]
    focal_px, middle_px = lens[1], lens[2]
    strength = width0 / focal_px * height / height0
    tan_azimuth = (x - middle_px) / focal_px
    aspect = width / height * height0 / width0
    psi = math.asin(min(max(keystone / strength, -0.9), 0.9))
    for _ in range(STEPS):
        sine, cosine = math.sin(psi), math.cos(psi)
        off_q, slope_q = (strength * sine - keystone) / KEYSTONE_SIGMA, strength * cosine / KEYSTONE_SIGMA
        off_a = (cosine - tan_azimuth * sine - aspect) / ASPECT_SIGMA
        slope_a = (-sine - tan_azimuth * cosine) / ASPECT_SIGMA
        step = (off_q * slope_q + off_a * slope_a) / (slope_q**2 + slope_a**2)
        psi = min(max(psi - step, -STEEPEST_RAD), STEEPEST_RAD)
        if abs(step) < 1e-5:
            break
    return math.atan((x0 - middle_px) / focal_px) - psi - math.atan(tan_azimuth)
