"""Where a pan-tilt looks as a function of time: each axis runs to its goal at one speed, and stays.

Pure: it reads no clock. A goal is remembered with its time and the place it was set from, so that the place at any time
since then is a formula; nothing needs to be stepped.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from protocol import PanTiltLimits

PI_PAN = PanTiltLimits(
    pan_rad=(-math.radians(90.0), math.radians(90.0)),
    tilt_rad=(-math.radians(55.0), math.radians(55.0)),
    slew_rad_s=math.radians(300.0),
)
"""The thesis's Pi-Pan: pan 180, tilt 110 degrees. The slew rate is one that a micro servo can follow with a camera."""
SERVO_LAG_S = 0.03
"""A servo comes so much later than its pulses say: one period of them, and its own response."""
KEPT = 256
"""Goals remembered: some seconds, at one per frame."""


@dataclass(frozen=True)
class _Leg:
    """From `begin` at `time_s` towards `goal`; both are pan and tilt."""

    time_s: float
    begin: tuple[float, float]
    goal: tuple[float, float]

    def at(self, time_s: float, slew_rad_s: float) -> tuple[float, float]:
        reach = max(0.0, time_s - self.time_s) * slew_rad_s
        pan, tilt = (
            begin + math.copysign(min(reach, abs(goal - begin)), goal - begin)
            for begin, goal in zip(self.begin, self.goal, strict=True)
        )
        return pan, tilt


class Slew:
    """Pan and tilt within limits. At first it looks straight ahead. Locks nothing: its owner does."""

    def __init__(self, limits: PanTiltLimits) -> None:
        self.limits = limits
        self._legs = deque([_Leg(-math.inf, (0.0, 0.0), (0.0, 0.0))], maxlen=KEPT)

    def look(self, now_s: float, pan_rad: float, tilt_rad: float) -> None:
        """Set the goal, cut to the limits. Raises ValueError when an angle or the time is not finite."""
        if not (math.isfinite(pan_rad) and math.isfinite(tilt_rad) and math.isfinite(now_s)):
            raise ValueError(f"cannot look to pan {pan_rad}, tilt {tilt_rad} at {now_s}")
        goal = self.limits.clamped(pan_rad, tilt_rad)
        if goal != self._legs[-1].goal:
            self._legs.append(_Leg(now_s, self.at(now_s), goal))

    def at(self, time_s: float) -> tuple[float, float]:
        """Pan and tilt (rad) at this time, of the near past or later (as if no goal were set until then)."""
        leg = next((leg for leg in reversed(self._legs) if leg.time_s <= time_s), None)
        if leg is None:  # longer ago than is remembered
            return self._legs[0].begin
        return leg.at(time_s, self.limits.slew_rad_s)

    def arrival_s(self) -> float:
        """When both axes are, or were, at their goals; -inf before any goal was set."""
        leg = self._legs[-1]
        way = max(abs(goal - begin) for begin, goal in zip(leg.begin, leg.goal, strict=True))
        return leg.time_s + way / self.limits.slew_rad_s
