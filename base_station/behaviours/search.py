"""Looking for a lost target with the pan alone: wait where it was last seen, sweep slowly to both sides once, centre.

Pure: the pan as a function of the time since the loss.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from protocol import PanTiltLimits


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    hold_s: float = 1.0
    """Most targets come back where they went: a shadow, a person who walked by."""
    rate_rad_s: float = math.radians(25.0)
    """Slow enough for a picture without blur, and for a tracker that looks at each place more than once."""
    reach_rad: float = math.radians(70.0)
    """To either side, within the pan-tilt's limits."""


class PanSearch:
    """One search, begun at the loss from `begin_rad`, first to the side on which the target was last seen."""

    def __init__(
        self, limits: PanTiltLimits, *, begin_rad: float, left_first: bool, settings: SearchSettings | None = None
    ) -> None:
        self._settings = settings or SearchSettings()
        right, left = limits.pan_rad
        ends = [min(left, self._settings.reach_rad), max(right, -self._settings.reach_rad)]
        self._stations: list[float] = [begin_rad, *(ends if left_first else reversed(ends)), 0.0]

    def pan_rad(self, lost_for_s: float) -> float:
        """Where to look so long after the loss; at the end, and for ever after, straight ahead."""
        way = max(0.0, lost_for_s - self._settings.hold_s) * self._settings.rate_rad_s
        for begin, end in zip(self._stations, self._stations[1:], strict=False):
            if way < abs(end - begin):
                return begin + math.copysign(way, end - begin)
            way -= abs(end - begin)
        return self._stations[-1]
