"""Goto: parks at the learned pose, keeps the target in view on the way, says when it is there, and gives up in time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from base_station.behaviours.base import Drive, Journey
from base_station.behaviours.goto import Goto, GotoSettings
from base_station.geometry import PinholeCamera
from base_station.types import Box, TrackerResult, TrackingState
from protocol import STOP, Command, RobotLimits

LIMITS = RobotLimits(speed_scale=4.0)
CAMERA = PinholeCamera.with_fov(640, 480)
PERIOD_S, LEARNED_M, SIDE_M = 1 / 30, 0.5, 0.2
HALF_VIEW_RAD = math.atan2(CAMERA.width / 2, CAMERA.fx)


@dataclass
class Room:
    """A robot before a square target in the origin that is looked at along +x; two frames of delay."""

    x_m: float
    y_m: float
    heading_rad: float
    learned_bearing_rad: float = 0.0
    noise: np.random.Generator | None = None
    tells_angle: bool = True
    pending: list[Command] = field(default_factory=lambda: [STOP, STOP])
    widest_rad: float = 0.0

    @property
    def range_m(self) -> float:
        return math.hypot(self.x_m, self.y_m)

    @property
    def sight_rad(self) -> float:
        return math.atan2(-self.y_m, -self.x_m)

    @property
    def bearing_rad(self) -> float:
        return math.remainder(self.sight_rad - self.heading_rad, 2 * math.pi)

    def look(self) -> TrackerResult:
        """LOST when the target's middle is out of view."""
        if abs(self.bearing_rad) > HALF_VIEW_RAD:
            return TrackerResult(state=TrackingState.LOST, reason="out of view")
        half_rad = math.atan(SIDE_M / 2 / self.range_m)
        self.widest_rad = max(self.widest_rad, abs(self.bearing_rad) + half_rad)
        noise = self.noise.normal(size=3) if self.noise is not None else np.zeros(3)
        bearing = self.bearing_rad + 0.001 * noise[0]
        zoom = LEARNED_M * math.cos(self.learned_bearing_rad) / (self.range_m * math.cos(bearing))
        x, x0 = (CAMERA.cx - CAMERA.fx * math.tan(b) for b in (bearing, self.learned_bearing_rad))
        side_px = CAMERA.fx * SIDE_M / (self.range_m * math.cos(bearing))
        return TrackerResult(
            state=TrackingState.TRACKING,
            bearing_rad=bearing,
            zoom=zoom * math.exp(0.003 * noise[1]),
            shift_px=x - x0,
            view_angle_rad=self.sight_rad + 0.015 * noise[2] if self.tells_angle else None,
            box=Box.around(x, CAMERA.cy, side_px, side_px),
            confidence=1.0,
        )

    def drive(self, command: Command) -> None:
        self.pending.append(command)
        wheels = self.pending.pop(0)
        left, right = (side * LIMITS.metres_per_unit_s * LIMITS.speed_scale for side in (wheels.left, wheels.right))
        forward_m, turn_rad = (left + right) / 2 * PERIOD_S, (right - left) / LIMITS.wheel_base_m * PERIOD_S
        self.heading_rad += turn_rad / 2
        self.x_m += forward_m * math.cos(self.heading_rad)
        self.y_m += forward_m * math.sin(self.heading_rad)
        self.heading_rad += turn_rad / 2


def on_arc(range_m: float, arc_deg: float, turn_deg: float = 0.0, **more) -> Room:
    """So far away, so far round the circle about the target, turned so far off it."""
    arc = math.radians(arc_deg)
    return Room(-range_m * math.cos(arc), -range_m * math.sin(arc), arc + math.radians(turn_deg), **more)


def go(room: Room, seconds: float, goto: Goto | None = None) -> Goto:
    goto = goto or Goto(Drive(LIMITS), CAMERA)
    for frame in range(round(seconds / PERIOD_S)):
        room.drive(goto.command(room.look(), frame * PERIOD_S))
    return goto


@pytest.mark.parametrize("seed", [None, 0], ids=["exact", "noisy"])
@pytest.mark.parametrize(
    ("range_m", "arc_deg", "turn_deg"),
    [(1.0, 20, 0), (1.0, -20, 0), (1.0, 0, 20), (0.8, 30, -10), (0.5, 12, 0), (0.35, -10, 3), (1.4, -35, 8)],
)
def test_it_comes_back_to_the_full_pose(range_m, arc_deg, turn_deg, seed):
    room = on_arc(range_m, arc_deg, turn_deg, noise=None if seed is None else np.random.default_rng(seed))
    goto = go(room, 45)
    assert goto.outcome is not None and goto.outcome.there, (room.x_m, room.y_m)
    assert room.range_m == pytest.approx(LEARNED_M, abs=0.006)
    assert abs(room.y_m) < 0.02
    assert abs(math.degrees(room.heading_rad)) < 2
    if abs(turn_deg) + math.degrees(math.atan(SIDE_M / 2 / range_m)) < 25:
        assert room.widest_rad < HALF_VIEW_RAD, "the target stays in view"


def test_the_learned_bearing_is_restored_too():
    room = on_arc(0.9, 8, learned_bearing_rad=math.radians(7))
    goto = go(room, 40)
    assert goto.outcome is not None and goto.outcome.there
    assert math.degrees(room.bearing_rad) == pytest.approx(7, abs=0.5)
    assert room.range_m == pytest.approx(LEARNED_M, abs=0.006)


def test_without_an_angle_range_and_bearing_are_restored():
    room = on_arc(1.0, 20, 10, tells_angle=False)
    goto = go(room, 20)
    assert goto.outcome is not None and goto.outcome.there
    assert room.range_m == pytest.approx(LEARNED_M, abs=0.006)
    assert abs(math.degrees(room.bearing_rad)) < 0.5


def test_at_the_learned_pose_it_stands_and_says_so():
    room = on_arc(LEARNED_M, 0)
    goto = go(room, 1)
    assert isinstance(goto, Journey)
    assert goto.outcome is not None and goto.outcome.there and "there" in goto.outcome.text
    assert (room.x_m, room.y_m) == (-LEARNED_M, 0)


def test_carried_away_it_comes_back():
    room = on_arc(LEARNED_M, 0)
    goto = go(room, 1)
    room.x_m -= 0.4
    assert goto.command(room.look(), 1.1) != STOP
    assert goto.outcome is None
    go(room, 20, goto)
    assert goto.outcome is not None and goto.outcome.there
    assert room.range_m == pytest.approx(LEARNED_M, abs=0.006)


@pytest.mark.parametrize("turned_deg", [120, -100])
def test_it_searches_for_what_it_does_not_see(turned_deg):
    room = on_arc(0.8, 0, turned_deg)
    goto = go(room, 45)
    assert goto.outcome is not None and goto.outcome.there
    assert abs(math.degrees(room.heading_rad) % 360) == pytest.approx(0, abs=2) or (
        math.degrees(room.heading_rad) % 360 > 358
    )


def test_it_gives_up_after_a_whole_turn_and_tells_why():
    settings, goto = GotoSettings(), Goto(Drive(LIMITS), CAMERA)
    lost = TrackerResult(state=TrackingState.LOST, reason="it is dark")
    commands = []
    while goto.outcome is None:
        commands.append(goto.command(lost, len(commands) * PERIOD_S))
        assert len(commands) < 1000
    assert not goto.outcome.there and "it is dark" in goto.outcome.text
    turned_s = settings.search_turns * 2 * math.pi / settings.search_rad_s
    assert len(commands) * PERIOD_S == pytest.approx(turned_s + settings.patience_s, abs=0.3)
    assert commands[0] == commands[-1] == STOP
    assert all(command.left == -command.right for command in commands), "on the spot"
    assert goto.command(lost, 1e4) == STOP


def test_nothing_learned_is_no_reason_to_move():
    assert Goto(Drive(LIMITS), CAMERA).command(None, 0.0) == STOP
