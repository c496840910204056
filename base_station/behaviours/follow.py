"""Follow: keep the target straight ahead and at the learned distance, by image-based visual servoing.

The features are s = (bearing, log r/r*), with r the range to the target and r* the learned one, as in ViSP's examples
for mobile robots; the scene's scale need not be known, one nominal distance sets the gain. Each feature has a
proportional and an integral part: against a leader that drives on, a proportional law alone stays behind by a constant.

With a pan-tilt the camera is turned first: it is light and fast, and keeps the target in the middle of the picture. The
body turns after it until the camera looks straight ahead again. So the bearing that the body sees is pan + bearing,
while the range still follows from zoom and the bearing in the picture. Driving forward only helps as far as the body
faces the target: the forward speed is multiplied by the cosine (Aicardi et al. 1995, steering of unicycles).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from base_station.behaviours.base import Drive, Head
from base_station.behaviours.search import PanSearch
from base_station.types import TrackerResult, TrackingState
from protocol import STOP, Command


@dataclass(frozen=True, kw_only=True)
class FollowSettings:
    """Gains. The defaults hold for 30 frames per second and up to two frames of delay."""

    turn_gain_per_s: float = 8.0
    """Rate of turn per radian of bearing."""
    turn_integral_per_s: float = 3.0
    """How fast a constant bearing error is integrated away (1 / time constant)."""
    forward_gain_per_s: float = 2.0
    """Forward speed, in nominal distances per second, per unit of log range error."""
    forward_integral_per_s: float = 1.0
    """The same for a constant range error."""
    integrate_within: float = 0.12
    """Only errors smaller than this (radians, log range) are integrated: on a long approach the integral would wind up
    and the robot overshoot."""
    nominal_distance_m: float = 0.4
    """Scale of the forward gain; a guess of the learned distance within a factor of two does."""
    forward_limit_m_s: float = 0.16
    turn_limit_rad_s: float = 2.5
    pan_gain: float = 0.8
    """Share of the bearing in a frame that the pan makes up for at once. 1 would centre the target with the next frame
    if the servo's angle were known exactly; below 2, wrongly scaled servos still converge."""
    longest_gap_s: float = 0.2
    """Frames further apart than this integrate as if they were this far apart."""


class Follow:
    """With a tracker that gives no zoom it only turns. While the target is not seen the robot stands, and with a `head`
    looks for it."""

    def __init__(self, drive: Drive, settings: FollowSettings | None = None, *, head: Head | None = None) -> None:
        self._drive, self._settings = drive, settings or FollowSettings()
        self._gaze = _Gaze(head, self._settings.pan_gain) if head is not None else None
        self._turn = _Integrator(self._settings.integrate_within)
        self._forward = _Integrator(self._settings.integrate_within)
        self._last_s: float | None = None

    def command(self, result: TrackerResult | None, time_s: float) -> Command:
        """See Behaviour.command."""
        step_s = 0.0 if self._last_s is None else max(0.0, min(time_s - self._last_s, self._settings.longest_gap_s))
        self._last_s = time_s
        if result is None or result.state is not TrackingState.TRACKING or result.bearing_rad is None:
            if self._gaze is not None and result is not None:
                self._gaze.search(time_s)
            return STOP
        settings = self._settings
        body_bearing_rad = result.bearing_rad if self._gaze is None else self._gaze.centre(result.bearing_rad)
        turn_rad_s = settings.turn_gain_per_s * self._turn.add(
            body_bearing_rad,
            settings.turn_integral_per_s,
            step_s,
            settings.turn_limit_rad_s / settings.turn_gain_per_s,
        )
        forward_m_s = 0.0
        if result.zoom is not None:
            gain_m_s = settings.forward_gain_per_s * settings.nominal_distance_m
            forward_m_s = gain_m_s * self._forward.add(
                log_range_error(result.zoom, result.bearing_rad),
                settings.forward_integral_per_s,
                step_s,
                min(settings.forward_limit_m_s, self._drive.fastest_m_s) / gain_m_s,
            )
            if self._gaze is not None:
                forward_m_s *= max(0.0, math.cos(body_bearing_rad))
        return self._drive.command(forward_m_s, turn_rad_s)


def log_range_error(zoom: float, bearing_rad: float) -> float:
    """log(r / r*): positive when the target is farther than it was learned.

    Zoom is the inverse ratio of depths along the optical axis; a target aside is farther than its depth, by the cosine.
    """
    return -math.log(zoom * math.cos(bearing_rad))


class _Gaze:
    """Keeps the camera on the target, and looks for one that is lost."""

    def __init__(self, head: Head, gain: float) -> None:
        self._head, self._gain = head, gain
        self._seen: tuple[float, float] | None = None
        """The last goal of the pan, and the side of the picture on which the target was last (positive: left)."""
        self._lost_s = 0.0
        self._search: PanSearch | None = None

    def centre(self, bearing_rad: float) -> float:
        """Turn towards what is seen at this bearing from the optical axis; its bearing from the body."""
        pan_rad = self._head.pan_rad
        goal_rad = pan_rad + self._gain * bearing_rad
        self._head.look(goal_rad)
        self._seen, self._search = (goal_rad, bearing_rad), None
        return pan_rad + bearing_rad

    def search(self, time_s: float) -> None:
        """The target is not seen. Before it ever was there is nothing to look for."""
        if self._seen is None:
            return
        if self._search is None:
            goal_rad, side = self._seen
            self._search = PanSearch(self._head.limits, begin_rad=goal_rad, left_first=side >= 0)
            self._lost_s = time_s
        self._head.look(self._search.pan_rad(time_s - self._lost_s))


class _Integrator:
    """Proportional plus integral with a bounded sum. Large errors, and what exceeds the bound, are not integrated."""

    def __init__(self, within: float) -> None:
        self._within = within
        self._integral = 0.0

    def add(self, error: float, rate_per_s: float, step_s: float, bound: float) -> float:
        grown = self._integral + rate_per_s * error * step_s
        if abs(error) < self._within and (abs(error + grown) < bound or abs(grown) < abs(self._integral)):
            self._integral = grown
        return max(-bound, min(bound, error + self._integral))
