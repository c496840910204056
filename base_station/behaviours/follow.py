"""Follow: keep the target straight ahead and at the learned distance, by image-based visual servoing.

The features are s = (bearing, log r/r*), with r the range to the target and r* the learned one, as in ViSP's examples
for mobile robots; the scene's scale need not be known, one nominal distance sets the gain. Each feature has a
proportional and an integral part: against a leader that drives on, a proportional law alone stays behind by a constant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from base_station.behaviours.base import Drive
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
    longest_gap_s: float = 0.2
    """Frames further apart than this integrate as if they were this far apart."""


class Follow:
    """With a tracker that gives no zoom it only turns. While the target is not seen the robot stands."""

    def __init__(self, drive: Drive, settings: FollowSettings | None = None) -> None:
        self._drive, self._settings = drive, settings or FollowSettings()
        self._turn = _Integrator(self._settings.integrate_within)
        self._forward = _Integrator(self._settings.integrate_within)
        self._last_s: float | None = None

    def command(self, result: TrackerResult | None, time_s: float) -> Command:
        """See Behaviour.command."""
        step_s = 0.0 if self._last_s is None else max(0.0, min(time_s - self._last_s, self._settings.longest_gap_s))
        self._last_s = time_s
        if result is None or result.state is not TrackingState.TRACKING or result.bearing_rad is None:
            return STOP
        settings = self._settings
        turn_rad_s = settings.turn_gain_per_s * self._turn.add(
            result.bearing_rad,
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
        return self._drive.command(forward_m_s, turn_rad_s)


def log_range_error(zoom: float, bearing_rad: float) -> float:
    """log(r / r*): positive when the target is farther than it was learned.

    Zoom is the inverse ratio of depths along the optical axis; a target aside is farther than its depth, by the cosine.
    """
    return -math.log(zoom * math.cos(bearing_rad))


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
