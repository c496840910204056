"""The scenes that can be asked for by name, and how one seed stages them.

A scenario is a recipe; a stage is what comes out of it for one seed: where things stand and how they move as functions
of the scenario's time, which starts when the operator appears. Nothing here knows the physics engine.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robot_agent.errors import AgentError
from robot_agent.sim import courses
from robot_agent.sim.calibration_board import Held, draw_showing
from robot_agent.sim.clutter import Clutter, draw_clutter
from robot_agent.sim.furnishing import Block, furnish
from robot_agent.sim.poses import Pose

LEADER_PICTURE_BEHIND_M = 0.036
"""The leader's picture stands so far behind its wheel axle."""
FOLLOW_DISTANCE_M = 0.40
POSTER_GOAL_M, POSTER_START_M = 0.50, 1.00
POSTER_HOLD_S = 2.0
POSTER_TURN_RAD = math.radians(20.0)
ARC_RAD = math.radians(20.0)
PLAIN_ESCAPE_S = 20.0
WAYPOINTS_APART_M = 0.10

_POSTER_OFF_WALL_M = 0.004


@dataclass(frozen=True, kw_only=True)
class Picture:
    """The square target. `wall_pose`: where it hangs, heading into the wall; None when the leader carries it."""

    side_m: float
    centre_height_m: float
    wall_pose: Pose | None = None


@dataclass(frozen=True, kw_only=True)
class Screen:
    """A plain upright partition; its heading runs along it."""

    pose: Pose
    length_m: float
    height_m: float = 0.6
    thickness_m: float = 0.02


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One seed of a scenario. Functions take scenario time in seconds."""

    robot_start: Pose
    held: Callable[[float], Pose | None] = lambda time_s: None
    """Where the robot is held, wheels idle; None while it is free."""
    set_down: Pose | None = None
    """Where it is put when the holding ends; None leaves it where it was held."""
    leader: Callable[[float], Pose] | None = None
    """The leader's pose (middle of its axle); None without a leader."""
    picture: Picture | None = None
    screen: Screen | None = None
    light: Callable[[float], float] = courses.steady_light
    """Brightness, 0..1."""
    textured: bool = True
    furniture: tuple[Block, ...] = ()
    course: tuple[tuple[float, float], ...] = ()
    """Waypoints (ahead, left) of a closed lap, in m from where the robot starts: for a robot that drives by itself."""
    clutter: Clutter | None = None
    """A busier room, things that move in it and pictures like the target; None without."""
    board: Callable[[float], Held] | None = None
    """How somebody holds a calibration board before the camera; None without."""


def build_stage(name: str, seed: int) -> Stage:
    """Stage scenario `name` (see SCENARIOS) with the course's random stream `seed`. Raises AgentError for another
    name, listing the valid ones."""
    if name not in SCENARIOS:
        raise AgentError(f"There is no scenario {name!r}; choose one of {', '.join(SCENARIOS)}.")
    return SCENARIOS[name](np.random.default_rng(seed))


def _poster(rng: np.random.Generator) -> Stage:
    wall = Pose(x_m=courses.ROOM_HALF_SIZE_M - _POSTER_OFF_WALL_M, y_m=float(rng.uniform(-1.2, 1.2)), heading_rad=0.0)
    goal = wall.moved(ahead_m=-POSTER_GOAL_M)
    turn_rad = POSTER_TURN_RAD * float(rng.choice((-1.0, 1.0)))
    return Stage(
        robot_start=goal,
        held=lambda time_s: goal if time_s < POSTER_HOLD_S else None,
        set_down=wall.moved(ahead_m=-POSTER_START_M, turned_rad=turn_rad),
        picture=Picture(side_m=0.22, centre_height_m=0.12, wall_pose=wall),
    )


def _arc(rng: np.random.Generator) -> Stage:
    """As `poster`, but set down aside: on a circle about the picture, facing it."""
    poster = _poster(rng)
    assert poster.picture is not None and poster.picture.wall_pose is not None
    arc_rad = ARC_RAD * float(rng.choice((-1.0, 1.0)))
    sight = dataclasses.replace(poster.picture.wall_pose, heading_rad=poster.robot_start.heading_rad + arc_rad)
    return dataclasses.replace(poster, set_down=sight.moved(ahead_m=-POSTER_START_M))


def _leader(rng: np.random.Generator, light: Callable[[float], float] = courses.steady_light) -> Stage:
    course = courses.draw_course(rng, distance_m=FOLLOW_DISTANCE_M, picture_behind_m=LEADER_PICTURE_BEHIND_M)
    pace = courses.draw_pace(rng)
    return Stage(
        robot_start=_follower_start(course),
        leader=lambda time_s: course.at(pace.distance_m(time_s)),
        picture=_leader_picture(),
        light=light,
    )


def _cluttered(rng: np.random.Generator, light: Callable[[float], float] = courses.steady_light) -> Stage:
    """As `leader` (or `lights`), in a busy room among moving things and pictures like the target."""
    stage = _leader(rng, light)
    assert stage.picture is not None
    clutter = draw_clutter(
        rng,
        side_m=stage.picture.side_m,
        centre_height_m=stage.picture.centre_height_m,
        behind_m=LEADER_PICTURE_BEHIND_M,
    )
    return dataclasses.replace(stage, clutter=clutter)


def _plain(rng: np.random.Generator) -> Stage:
    """The leader rounds the end of a screen and stops behind it, where no follower of its speed can see it."""
    while True:
        course = courses.draw_course(rng, distance_m=FOLLOW_DISTANCE_M, picture_behind_m=LEADER_PICTURE_BEHIND_M)
        pace = courses.draw_pace(rng)
        begin = course.at(pace.distance_m(PLAIN_ESCAPE_S))
        dash = courses.Dash(side=-1.0 if course.turns_left else 1.0)
        screen = Screen(
            pose=begin.moved(ahead_m=dash.straight_m - _SCREEN_LENGTH_M / 2, left_m=dash.side * dash.radius_m),
            length_m=_SCREEN_LENGTH_M,
        )
        if _screen_fits(course, pace, dash, screen):
            break
    return Stage(
        robot_start=_follower_start(course),
        leader=functools.partial(_drive_then_dash, course, pace, dash),
        picture=_leader_picture(),
        screen=screen,
        textured=False,
    )


_SCREEN_LENGTH_M = 1.0
_SCREEN_CLEARANCE_M = 0.25


def _screen_fits(course: courses.ClosedCourse, pace: courses.Pace, dash: courses.Dash, screen: Screen) -> bool:
    """Whether the way to the screen stays beside it and the way round it keeps off the walls."""
    begin = course.at(pace.distance_m(PLAIN_ESCAPE_S))
    c, s = math.cos(begin.heading_rad), math.sin(begin.heading_rad)
    for distance_m in np.arange(-FOLLOW_DISTANCE_M, pace.distance_m(PLAIN_ESCAPE_S), 0.05):
        pose = course.at(float(distance_m))
        dx, dy = pose.x_m - screen.pose.x_m, pose.y_m - screen.pose.y_m
        if dash.side * (c * dy - s * dx) > -_SCREEN_CLEARANCE_M:
            return False
    limit_m = courses.ROOM_HALF_SIZE_M - courses.WALL_CLEARANCE_M / 2
    way = [dash.pose(begin, time_s) for time_s in np.arange(0.0, 8.0, 0.2)]
    return all(max(abs(pose.x_m), abs(pose.y_m)) < limit_m for pose in way)


def _drive_then_dash(course: courses.ClosedCourse, pace: courses.Pace, dash: courses.Dash, time_s: float) -> Pose:
    if time_s <= PLAIN_ESCAPE_S:
        return course.at(pace.distance_m(time_s))
    return dash.pose(course.at(pace.distance_m(PLAIN_ESCAPE_S)), time_s - PLAIN_ESCAPE_S)


def _turn(rng: np.random.Generator) -> Stage:
    x_m, y_m = rng.uniform(-1.0, 1.0, 2)
    start = Pose(x_m=float(x_m), y_m=float(y_m), heading_rad=float(rng.uniform(-math.pi, math.pi)))
    table = courses.draw_turntable(rng)
    return Stage(robot_start=start, held=lambda time_s: start.moved(turned_rad=table.angle_rad(time_s)))


def _loop(rng: np.random.Generator) -> Stage:
    """A furnished room, and a lap through it that the robot is to drive."""
    course = courses.draw_lap(rng)
    start = course.at(0.0)
    count = round(course.length_m / WAYPOINTS_APART_M)
    places = [course.at(course.length_m * k / count) for k in range(count)]
    c, s = math.cos(start.heading_rad), math.sin(start.heading_rad)
    from_start = [(place.x_m - start.x_m, place.y_m - start.y_m) for place in places]
    return Stage(
        robot_start=start,
        furniture=furnish(rng, course),
        course=tuple((c * dx + s * dy, c * dy - s * dx) for dx, dy in from_start),
    )


def _calibration(rng: np.random.Generator) -> Stage:
    """A calibration board that somebody shows to the standing robot, again and again in other ways."""
    start = Pose(x_m=0.0, y_m=0.0, heading_rad=0.0)
    return Stage(robot_start=start, held=lambda time_s: start, board=draw_showing(rng).at)


def _follower_start(course: courses.ClosedCourse) -> Pose:
    return course.at(0.0).moved(ahead_m=-LEADER_PICTURE_BEHIND_M - FOLLOW_DISTANCE_M)


def _leader_picture() -> Picture:
    return Picture(side_m=0.15, centre_height_m=0.10)


SCENARIOS: dict[str, Callable[[np.random.Generator], Stage]] = {
    "poster": _poster,
    "arc": _arc,
    "leader": _leader,
    "lights": functools.partial(_leader, light=courses.changing_light),
    "clutter": _cluttered,
    "clutter-lights": functools.partial(_cluttered, light=courses.changing_light),
    "plain": _plain,
    "turn": _turn,
    "loop": _loop,
    "calibration": _calibration,
}
"""poster: go back to a picture on the wall. arc: the same from aside. leader: follow a robot. lights: the same while
the light changes. clutter, clutter-lights: both among pictures like the target and before a background that moves.
plain: the same in a featureless room, until the leader escapes. turn: watch a place from a turntable, which in the end
turns round. loop: drive laps through a furnished room. calibration: see a ChArUco board in many poses."""
