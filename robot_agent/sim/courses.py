"""Paths and time curves of the simulated actors: pure functions of time, once drawn from a seeded generator.

The leader carries its picture at its rear. A follower that keeps its distance sees the picture at an angle that grows
with the curvature of the leader's path, so courses are drawn, driven once by an ideal pursuer, and thrown away when
the picture would turn too far or either robot come near a wall.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_agent.sim.poses import Pose, wrapped

ROOM_HALF_SIZE_M = 3.0
WALL_CLEARANCE_M = 0.8
MIN_RADIUS_M = 0.75
LAP_RADIUS_M, LAP_EXTENT_M = 0.45, 1.7
MAX_FACING_RAD = math.radians(33.0)
"""Largest angle between the picture's normal and the ideal pursuer's line of sight."""

_TABLE_POINTS = 2880
_RAMP_START_S, _RAMP_S, _FADE_S = 1.0, 2.0, 3.0
SWINGS_END_S, TURN_RAD_S = 20.0, math.radians(30.0)


class ClosedCourse:
    """A smooth closed path, walked by its arc length."""

    def __init__(self, x_m: np.ndarray, y_m: np.ndarray) -> None:
        """`x_m`, `y_m`: float64 (n,), n points along the loop, the last one equal to the first."""
        step = np.hypot(np.diff(x_m), np.diff(y_m))
        self._x_m, self._y_m = x_m, y_m
        self._s_m = np.concatenate(([0.0], np.cumsum(step)))
        self._middle_s_m = (self._s_m[1:] + self._s_m[:-1]) / 2
        self._heading_rad = np.unwrap(np.arctan2(np.diff(y_m), np.diff(x_m)))
        self.length_m = float(self._s_m[-1])

    def at(self, distance_m: float) -> Pose:
        """The pose after so many metres along the course; the heading is the direction of travel."""
        s = distance_m % self.length_m
        first, last = self._middle_s_m[0], self._middle_s_m[-1]
        if first <= s <= last:
            heading = float(np.interp(s, self._middle_s_m, self._heading_rad))
        else:
            heading = self._heading_at_seam(s + self.length_m if s < first else s)
        return Pose(
            x_m=float(np.interp(s, self._s_m, self._x_m)),
            y_m=float(np.interp(s, self._s_m, self._y_m)),
            heading_rad=heading,
        )

    def _heading_at_seam(self, s_m: float) -> float:
        last_m = float(self._middle_s_m[-1])
        gap_m = self.length_m + float(self._middle_s_m[0]) - last_m
        turn = wrapped(float(self._heading_rad[0] - self._heading_rad[-1]))
        return float(self._heading_rad[-1]) + turn * (s_m - last_m) / gap_m

    @property
    def min_radius_m(self) -> float:
        """The tightest bend's radius."""
        turn = np.abs(np.diff(self._heading_rad)) / np.diff(self._middle_s_m)
        return float(1.0 / turn.max())

    @property
    def turns_left(self) -> bool:
        """Whether the loop runs counter-clockwise."""
        return bool(self._heading_rad[-1] > self._heading_rad[0])

    @property
    def extent_m(self) -> float:
        """The largest |x| or |y| on the course."""
        return float(max(np.abs(self._x_m).max(), np.abs(self._y_m).max()))


@dataclass(frozen=True, kw_only=True)
class Pursuit:
    """How an ideal pursuer, always at the same distance behind the picture and pointing at it, would fare."""

    max_facing_rad: float
    """Largest angle between the leader's heading and the line of sight."""
    extent_m: float
    """Largest |x| or |y| of the pursuer."""


def pursue(course: ClosedCourse, *, distance_m: float, picture_behind_m: float, step_m: float = 0.01) -> Pursuit:
    """Drag the pursuer over one and a half laps."""
    picture = course.at(0.0).moved(ahead_m=-picture_behind_m)
    follower = picture.moved(ahead_m=-distance_m)
    x, y = follower.x_m, follower.y_m
    facing, extent = 0.0, max(abs(x), abs(y))
    for s in np.arange(step_m, 1.5 * course.length_m, step_m):
        picture = course.at(float(s)).moved(ahead_m=-picture_behind_m)
        sight = math.atan2(picture.y_m - y, picture.x_m - x)
        x, y = picture.x_m - distance_m * math.cos(sight), picture.y_m - distance_m * math.sin(sight)
        facing = max(facing, abs(wrapped(picture.heading_rad - sight)))
        extent = max(extent, abs(x), abs(y))
    return Pursuit(max_facing_rad=facing, extent_m=extent)


def draw_course(rng: np.random.Generator, *, distance_m: float, picture_behind_m: float) -> ClosedCourse:
    """A course that a follower at `distance_m` can keep up with, seeing the picture all the way round."""
    allowed_m = ROOM_HALF_SIZE_M - WALL_CLEARANCE_M
    while True:
        course = _draw_loop(rng)
        if course.min_radius_m < MIN_RADIUS_M or course.extent_m > allowed_m:
            continue
        pursuit = pursue(course, distance_m=distance_m, picture_behind_m=picture_behind_m)
        if pursuit.max_facing_rad <= MAX_FACING_RAD and pursuit.extent_m <= allowed_m:
            return course


def draw_lap(rng: np.random.Generator) -> ClosedCourse:
    """A lap of 6 to 7.5 m for a robot that drives by itself, with room for furniture on both sides."""
    while True:
        course = _draw_loop(rng)
        if 6.0 <= course.length_m <= 7.5 and course.min_radius_m >= LAP_RADIUS_M and course.extent_m <= LAP_EXTENT_M:
            return course


def _draw_loop(rng: np.random.Generator) -> ClosedCourse:
    angle = np.linspace(0.0, 2.0 * np.pi, _TABLE_POINTS + 1)
    radius = np.ones_like(angle)
    for harmonic in (2, 3, 4):
        strength = rng.uniform(-0.16, 0.16) / (harmonic - 1)
        radius += strength * np.cos(harmonic * angle + rng.uniform(0.0, 2.0 * np.pi))
    radius *= rng.uniform(1.05, 1.5)
    start, way_round = rng.uniform(0.0, 2.0 * np.pi), rng.choice((-1.0, 1.0))
    x, y = radius * np.cos(way_round * angle + start), radius * np.sin(way_round * angle + start)
    return ClosedCourse(x + rng.uniform(-0.4, 0.4), y + rng.uniform(-0.4, 0.4))


@dataclass(frozen=True, kw_only=True)
class Pace:
    """Distance driven as a function of time: stands, speeds up, then swells gently between half and full speed."""

    top_m_s: float
    swell_period_s: float
    swell_phase_rad: float

    def distance_m(self, time_s: float) -> float:
        """Metres since the start; never decreases and never faster than `top_m_s`."""
        t, w = _ramped(time_s), 2.0 * math.pi / self.swell_period_s
        swell = (math.cos(self.swell_phase_rad) - math.cos(w * t + self.swell_phase_rad)) / w
        return self.top_m_s * (0.75 * t + 0.25 * swell)


def draw_pace(rng: np.random.Generator, top_m_s: float = 0.08) -> Pace:
    """A pace with a swell of 12 to 20 s."""
    return Pace(
        top_m_s=top_m_s,
        swell_period_s=float(rng.uniform(12.0, 20.0)),
        swell_phase_rad=float(rng.uniform(0.0, 2.0 * np.pi)),
    )


def _ramped(time_s: float) -> float:
    """Time that stands still at first and then picks up its rate smoothly, from 0 to 1."""
    since = time_s - _RAMP_START_S
    if since <= 0.0:
        return 0.0
    return since * since / (2.0 * _RAMP_S) if since < _RAMP_S else since - _RAMP_S / 2.0


@dataclass(frozen=True, kw_only=True)
class Dash:
    """A getaway: straight on, a half circle to one side, straight back, and stop. Coordinates are those of the pose
    where it begins."""

    side: float
    """+1 to the left, -1 to the right."""
    speed_m_s: float = 0.40
    start_speed_m_s: float = 0.06
    acceleration_m_s2: float = 1.0
    straight_m: float = 0.10
    radius_m: float = 0.30
    back_m: float = 0.45

    @property
    def length_m(self) -> float:
        """Metres from the beginning to the stop."""
        return self.straight_m + math.pi * self.radius_m + self.back_m

    def pose(self, begin: Pose, time_s: float) -> Pose:
        """The pose `time_s` after the beginning."""
        s = min(self._distance_m(time_s), self.length_m)
        on_arc = min(max(s - self.straight_m, 0.0), math.pi * self.radius_m)
        angle = on_arc / self.radius_m
        bend = begin.moved(
            ahead_m=min(s, self.straight_m) + self.radius_m * math.sin(angle),
            left_m=self.side * self.radius_m * (1.0 - math.cos(angle)),
            turned_rad=self.side * angle,
        )
        return bend.moved(ahead_m=max(0.0, s - self.straight_m - math.pi * self.radius_m))

    def _distance_m(self, time_s: float) -> float:
        speeding_s = (self.speed_m_s - self.start_speed_m_s) / self.acceleration_m_s2
        t = min(time_s, speeding_s)
        return self.start_speed_m_s * t + self.acceleration_m_s2 * t * t / 2 + self.speed_m_s * (time_s - t)


@dataclass(frozen=True, kw_only=True)
class Turntable:
    """A smooth to and fro about the start: two swings of different periods, faded in after a second and out at 20 s.
    Then one whole turn."""

    amplitude_rad: tuple[float, float]
    period_s: tuple[float, float]
    phase_rad: tuple[float, float]
    whole_turn: float = 1.0
    """+1 to the left, -1 to the right."""

    def angle_rad(self, time_s: float) -> float:
        """Rotation to the left since the start."""
        fade = min(max(min(time_s - _RAMP_START_S, SWINGS_END_S - time_s) / _FADE_S, 0.0), 1.0)
        swings = zip(self.amplitude_rad, self.period_s, self.phase_rad, strict=True)
        angle = sum(a * math.sin(2.0 * math.pi * time_s / p + f) for a, p, f in swings)
        return angle * fade * fade * (3.0 - 2.0 * fade) + self.whole_turn * _turned_rad(time_s - SWINGS_END_S)


def _turned_rad(time_s: float) -> float:
    """A whole turn at TURN_RAD_S, with a second of speeding up and one of slowing down."""
    t = min(max(time_s, 0.0), 2 * math.pi / TURN_RAD_S + 1.0)
    left_s = 2 * math.pi / TURN_RAD_S + 1.0 - t
    if t < 1.0:
        return TURN_RAD_S * t * t / 2
    return TURN_RAD_S * (t - 0.5) if left_s > 1.0 else 2 * math.pi - TURN_RAD_S * left_s * left_s / 2


def draw_turntable(rng: np.random.Generator) -> Turntable:
    """Swings within 25 degrees of the start and slower than 30 degrees a second."""
    return Turntable(
        amplitude_rad=(math.radians(rng.uniform(16.0, 19.0)), math.radians(rng.uniform(4.0, 6.0))),
        period_s=(float(rng.uniform(8.0, 10.0)), float(rng.uniform(3.2, 4.2))),
        phase_rad=(float(rng.uniform(0, 2 * np.pi)), float(rng.uniform(0, 2 * np.pi))),
        whole_turn=float(rng.choice((-1.0, 1.0))),
    )


def steady_light(time_s: float) -> float:
    """Daylight that does not change."""
    del time_s
    return 1.0


def changing_light(time_s: float) -> float:
    """Brightness from 1 down to a third and back, by steps and by ramps, in cycles of 20 s from the 5th second on."""
    if time_s < 5.0:
        return 1.0
    dark, phase_s = 1.0 / 3.0, (time_s - 5.0) % 20.0
    if phase_s < 5.0:
        return dark
    if phase_s < 10.0:
        return dark + (1.0 - dark) * (phase_s - 5.0) / 5.0
    if phase_s < 12.5:
        return 1.0
    if phase_s < 15.0:
        return 0.6
    return 1.0 - (1.0 - dark) * (phase_s - 15.0) / 5.0
