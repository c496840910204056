"""Route: laps along waypoints, by the pose that the wheels tell.

Pure pursuit (Coulter, CMU-RI-TR-92-01): the robot steers on the arc that leads to the point of the course a fixed way
ahead of it. A lap is over when the course has been passed once. The pose is dead reckoning, so the robot drifts off the
course slowly; it looks at nothing, and only the agent's own safety keeps it off obstacles.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from base_station.behaviours.base import Drive, Outcome
from base_station.geometry import FlatPose
from base_station.types import TrackerResult
from protocol import STOP, Command


@dataclass(frozen=True, kw_only=True)
class RouteSettings:
    laps: int = 3
    speed_m_s: float = 0.12
    start_s: float = 2.0
    """The speed is taken up so gently, and a camera's first pictures are of a robot that hardly moves."""
    lookahead_m: float = 0.25
    turn_limit_rad_s: float = 0.5
    """In narrower bends the robot drives slower: pictures that turn faster blur."""
    search_m: float = 0.5
    """The nearest point of the course is looked for so far ahead of the last one."""
    furthest_m: float = 0.6
    """Off the course by more: the robot was carried, or is stuck; it stands."""


class Course:
    """A closed polygon, by the way along it."""

    def __init__(self, waypoints: Sequence[tuple[float, float]]) -> None:
        """Raises ValueError unless there are three waypoints or more, each apart from the next."""
        ends = [*waypoints[1:], *waypoints[:1]]
        self._sides = [(a, b, math.dist(a, b)) for a, b in zip(waypoints, ends, strict=True)]
        if len(waypoints) < 3 or min(side[2] for side in self._sides) < 1e-6:
            raise ValueError("a course needs three waypoints or more, none of them twice in a row")
        self.length_m = sum(side[2] for side in self._sides)

    def at(self, way_m: float) -> tuple[float, float]:
        """The point after so many metres, round and round."""
        left_m = way_m % self.length_m
        for (ax, ay), (bx, by), length_m in self._sides:
            if left_m <= length_m:
                share = left_m / length_m
                return ax + share * (bx - ax), ay + share * (by - ay)
            left_m -= length_m
        return self._sides[0][0]

    def nearest(self, pose: FlatPose, from_m: float, within_m: float) -> float:
        """The way to the point nearest to the pose, of those up to `within_m` after `from_m`; to a centimetre."""
        ways = [from_m + k / 100 for k in range(round(within_m * 100) + 1)]
        return min(ways, key=lambda way_m: math.dist(self.at(way_m), (pose.x_m, pose.y_m)))


class Route:
    """Drives the laps, then stands. A journey, see `base.Journey`. `where` tells the pose in the present frame, from
    where the course begins; None where nothing is known: the robot stands."""

    def __init__(
        self,
        drive: Drive,
        course: Sequence[tuple[float, float]],
        where: Callable[[], FlatPose | None],
        settings: RouteSettings | None = None,
    ) -> None:
        """Raises ValueError for a course that is none."""
        self._drive, self._course, self._where = drive, Course(course), where
        self._settings = settings or RouteSettings()
        self._way_m = 0.0
        self._start_s: float | None = None
        self._outcome: Outcome | None = None

    @property
    def outcome(self) -> Outcome | None:
        """How the journey ended; None while it goes on."""
        return self._outcome

    @property
    def laps(self) -> int:
        """Driven to their end."""
        return int((self._way_m + 0.02) / self._course.length_m)

    def command(self, result: TrackerResult | None, time_s: float) -> Command:
        """See Behaviour.command."""
        pose = self._where()
        if result is None or pose is None or self._outcome is not None:
            return STOP
        settings = self._settings
        self._start_s = time_s if self._start_s is None else self._start_s
        self._way_m = self._course.nearest(pose, self._way_m, settings.search_m)
        if self.laps >= settings.laps:
            text = f"there: {settings.laps} laps of {self._course.length_m:.1f} m driven"
            self._outcome = Outcome(there=True, text=text)
            return STOP
        off_m = math.dist(self._course.at(self._way_m), (pose.x_m, pose.y_m))
        if off_m > settings.furthest_m:
            self._outcome = Outcome(there=False, text=f"stopped: {off_m:.1f} m off the course")
            return STOP
        pace = min(1.0, (time_s - self._start_s) / settings.start_s)
        return self._steer(pose, self._course.at(self._way_m + settings.lookahead_m), pace * settings.speed_m_s)

    def _steer(self, pose: FlatPose, goal: tuple[float, float], speed_m_s: float) -> Command:
        """On the arc that touches the heading and leads through the goal; towards one behind, turn first."""
        ahead_m, left_m = pose.sees(*goal)
        limit = self._settings.turn_limit_rad_s
        if ahead_m <= 0.0:
            return self._drive.command(0.0, math.copysign(limit, left_m))
        curvature = 2 * left_m / (ahead_m**2 + left_m**2)
        speed_m_s = min(speed_m_s, limit / max(abs(curvature), 1e-9))
        return self._drive.command(speed_m_s, speed_m_s * curvature)
