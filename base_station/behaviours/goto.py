"""Goto: return to where the target was learned, stand there, and say so.

Let r be the range to the target against the learned one, phi the angle of view, b the bearing. Driving at v gives

    d(-ln r)/dt = (v / r) cos b,    d(phi)/dt = (v / r) sin b

so in the plane X = -ln r, Y = phi the robot is a unicycle whose heading is the bearing, and no metre need be known. To
come back is to park it in the origin. Its heading must stay small, or the camera loses the target; what cannot be
made good on the way there is made good on a way back and forth: the line Y = 0 is followed forwards and backwards until
Y is small where X is. At last it turns to the bearing that the target had. A tracker that tells no angle leaves Y at
zero: then range and bearing are restored (of a place: depth and heading).

Position-based visual servoing (Chaumette and Hutchinson 2006, part I) in log-polar coordinates, those of Aicardi et al.
1995 but for the logarithm, which makes the two equations above a plain unicycle's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from base_station.behaviours.base import Drive, Outcome
from base_station.geometry import PinholeCamera
from base_station.types import TrackerResult, TrackingState
from protocol import STOP, Command


@dataclass(frozen=True, kw_only=True)
class GotoSettings:
    """Gains, limits and tolerances. X is the logarithm of range, see above."""

    turn_gain_per_s: float = 6.0
    """Rate of turn per radian of bearing error."""
    forward_gain_m_s: float = 0.6
    """Forward speed per unit of X."""
    forward_limit_m_s: float = 0.12
    turn_limit_rad_s: float = 1.2
    line_gain: float = 5.0
    """Bearing per radian of view angle, while driving: the view angle falls by this power of the range."""
    edge_margin_rad: float = math.radians(2.5)
    """The target's edges are kept so far inside of the view."""
    angle_filter_s: float = 0.3
    """Time constant of the view angle's low-pass; it is noisy where the view is frontal."""
    range_tolerance: float = 0.006
    """Of X."""
    angle_tolerance_rad: float = math.radians(1.2)
    """Of the view angle."""
    bearing_tolerance_rad: float = math.radians(0.4)
    settle_s: float = 0.5
    """Within all tolerances for so long: there."""
    leave_factor: float = 4.0
    """Away again, when a tolerance is exceeded by this factor (the robot was carried off, or the target moved)."""
    nearby: float = 0.05
    """Of X: near enough to judge whether the view angle calls for another way back and forth."""
    shortest_back_up: float = 0.25
    longest_back_up: float = 0.6
    """Of X: 0.6 is 1.8 times the range."""
    confirm_s: float = 0.15
    """After having been lost, the target must be seen for so long before the robot drives to it."""
    patience_s: float = 0.7
    """Not seen for so long: begin to search."""
    search_rad_s: float = 0.5
    search_turns: float = 1.2
    """Whole turns on the spot, then it gives up."""
    longest_gap_s: float = 0.2
    """Frames further apart than this count as if they were this far apart."""


class Goto:
    """Drives back to the learned pose. `outcome` is None on the way; see `base.Journey`."""

    def __init__(self, drive: Drive, camera: PinholeCamera, settings: GotoSettings | None = None) -> None:
        self._drive, self._camera, self._settings = drive, camera, settings or GotoSettings()
        self._last_s: float | None = None
        self._unseen_s, self._seen_s, self._within_s = 0.0, 0.0, 0.0
        self._searched_rad, self._side = 0.0, 1.0
        self._angle_rad: float | None = None
        self._goal_x = 0.0
        self._outcome: Outcome | None = None
        self._was_lost = True

    @property
    def outcome(self) -> Outcome | None:
        """How the journey ended, as of the last command; None while it goes on."""
        return self._outcome

    def command(self, result: TrackerResult | None, time_s: float) -> Command:
        """See Behaviour.command."""
        step_s = 0.0 if self._last_s is None else max(0.0, min(time_s - self._last_s, self._settings.longest_gap_s))
        self._last_s = time_s
        if result is None:
            return STOP
        if result.state is not TrackingState.TRACKING or result.bearing_rad is None:
            return self._search(result.reason, step_s)
        return self._approach(result, result.bearing_rad, step_s)

    def _search(self, reason: str, step_s: float) -> Command:
        """Wait a moment, then turn on the spot, to the side where the target was last."""
        settings = self._settings
        self._seen_s, self._within_s, self._was_lost = 0.0, 0.0, True
        self._angle_rad = None
        self._unseen_s += step_s
        if self._unseen_s < settings.patience_s:
            return STOP
        if self._searched_rad >= settings.search_turns * 2 * math.pi:
            self._outcome = Outcome(there=False, text=f"gave up after a whole turn: {reason}")
            return STOP
        self._outcome = None
        self._searched_rad += settings.search_rad_s * step_s
        return self._drive.command(0.0, self._side * settings.search_rad_s)

    def _approach(self, result: TrackerResult, bearing_rad: float, step_s: float) -> Command:
        settings = self._settings
        self._side = 1.0 if bearing_rad >= 0 else -1.0
        self._seen_s += step_s
        if self._was_lost and self._seen_s < settings.confirm_s:
            return STOP
        if self._was_lost:
            self._goal_x = 0.0
        self._was_lost, self._unseen_s, self._searched_rad = False, 0.0, 0.0
        learned_rad = _learned_bearing_rad(result, bearing_rad, self._camera)
        x = 0.0
        if result.zoom is not None:
            x = math.log(result.zoom * math.cos(bearing_rad) / math.cos(learned_rad))
        angle_rad = self._smooth(result.view_angle_rad, step_s)
        if self._is_there(x, angle_rad, bearing_rad - learned_rad, step_s):
            return STOP
        self._choose_way(x, angle_rad, self._room_rad(result, bearing_rad))
        return self._steer(result, x, angle_rad, bearing_rad, learned_rad)

    def _steer(
        self, result: TrackerResult, x: float, angle_rad: float, bearing_rad: float, learned_rad: float
    ) -> Command:
        """Follow the line Y = 0 towards the goal on it; at the end turn to the learned bearing."""
        settings = self._settings
        way = self._goal_x - x
        room_rad = self._room_rad(result, bearing_rad)
        if result.view_angle_rad is None or (self._goal_x == 0.0 and abs(x) <= settings.range_tolerance):
            wanted_rad = max(-room_rad, min(room_rad, learned_rad))
        else:
            aside = settings.line_gain * angle_rad * min(1.0, abs(way) / settings.nearby)
            wanted_rad = max(-room_rad, min(room_rad, -math.copysign(1.0, way) * aside))
        off_rad = bearing_rad - wanted_rad
        forward_m_s = max(-settings.forward_limit_m_s, min(settings.forward_limit_m_s, settings.forward_gain_m_s * way))
        forward_m_s *= max(0.0, 1.0 - abs(off_rad) / 0.3)  # turn first
        turn_rad_s = max(-settings.turn_limit_rad_s, min(settings.turn_limit_rad_s, settings.turn_gain_per_s * off_rad))
        return self._drive.command(forward_m_s, turn_rad_s)

    def _choose_way(self, x: float, angle_rad: float, room_rad: float) -> None:
        """Back up when the range is right and the view angle is not; forwards again when far enough."""
        settings = self._settings
        if self._goal_x < 0.0 and x <= self._goal_x + 0.02:
            self._goal_x = 0.0
        elif self._goal_x == 0.0 and abs(x) < settings.nearby and abs(angle_rad) > settings.angle_tolerance_rad:
            needed = 0.5 * abs(angle_rad) / math.tan(max(room_rad, 0.05)) + settings.shortest_back_up
            self._goal_x = -min(settings.longest_back_up, needed)

    def _is_there(self, x: float, angle_rad: float, off_rad: float, step_s: float) -> bool:
        settings = self._settings
        was_there = self._outcome is not None and self._outcome.there
        factor = settings.leave_factor if was_there else 1.0
        within = (
            abs(x) <= factor * settings.range_tolerance
            and abs(angle_rad) <= factor * settings.angle_tolerance_rad
            and abs(off_rad) <= factor * settings.bearing_tolerance_rad
        )
        self._within_s = self._within_s + step_s if within else 0.0
        if not within:
            self._outcome = None
        elif was_there or self._within_s >= settings.settle_s:
            self._outcome = Outcome(there=True, text="there: where the target was learned")
            return True
        return False

    def _smooth(self, angle_rad: float | None, step_s: float) -> float:
        """First-order low-pass; 0 without a measurement."""
        if angle_rad is None:
            self._angle_rad = None
            return 0.0
        if self._angle_rad is None:
            self._angle_rad = angle_rad
        share = step_s / (self._settings.angle_filter_s + step_s)
        self._angle_rad += share * (angle_rad - self._angle_rad)
        return self._angle_rad

    def _room_rad(self, result: TrackerResult, bearing_rad: float) -> float:
        """How far from the optical axis the target's middle may be without its edges leaving the view."""
        half_view_rad = math.atan2(self._camera.width / 2, self._camera.fx)
        half_target_rad = 0.0
        if result.box is not None:
            left = self._camera.bearing_rad(result.box.x)
            right = self._camera.bearing_rad(result.box.x + result.box.width)
            half_target_rad = max(left - bearing_rad, bearing_rad - right)
        return max(half_view_rad - half_target_rad - self._settings.edge_margin_rad, 0.03)


def _learned_bearing_rad(result: TrackerResult, bearing_rad: float, camera: PinholeCamera) -> float:
    """Where the target was when it was learned: the shift leads back there. Straight ahead when no shift is told."""
    if result.shift_px is None:
        return 0.0
    return camera.bearing_rad(camera.cx - camera.fx * math.tan(bearing_rad) - result.shift_px)
