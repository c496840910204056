"""What makes following hard: a busy background, things that move in it, and pictures that look like the target.

The look-alikes are made from the target's own picture: mirrored, its quarters exchanged, or the same one in another
size. Three stand on the leader itself, right beside and above its picture, so that they are in view all the time and
move as the target does; larger ones go round the room on boards. None ever comes before the target, nor near a robot.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from robot_agent.sim.courses import ROOM_HALF_SIZE_M, ClosedCourse
from robot_agent.sim.poses import Pose

LANES_M = (0.17, 0.38)
"""How far from the walls the boards go round, inner edge to inner edge; the leader keeps to 0.8 m."""
BOARDS = 6
_CORNER_M = 0.5
_SLOWEST_M_S, _FASTEST_M_S = 0.10, 0.45


@dataclass(frozen=True, kw_only=True)
class LookAlike:
    """A square picture on the leader, in its coordinates; it looks backwards as the target does. `image`: the name of
    its picture."""

    image: str
    side_m: float
    ahead_m: float
    left_m: float
    centre_height_m: float


@dataclass(frozen=True, kw_only=True)
class Board:
    """An upright board that goes round the room, its face along its way. `pose`: its middle, by scenario time."""

    image: str
    width_m: float
    height_m: float
    pose: Callable[[float], Pose]


@dataclass(frozen=True, kw_only=True)
class Clutter:
    look_alikes: tuple[LookAlike, ...]
    boards: tuple[Board, ...]


def draw_clutter(rng: np.random.Generator, *, side_m: float, centre_height_m: float, behind_m: float) -> Clutter:
    """For a target of this size that the leader carries so far behind its axle. Sizes and places vary a little."""
    beside_m = side_m + float(rng.uniform(0.03, 0.05))
    ahead_m = -behind_m + 0.01  # never between the target and who looks at it
    way = float(rng.choice((-1.0, 1.0)))
    smaller_m = side_m * float(rng.uniform(0.55, 0.7))
    look_alikes = (
        LookAlike(
            image="mirrored", side_m=side_m, ahead_m=ahead_m, left_m=way * beside_m, centre_height_m=centre_height_m
        ),
        LookAlike(
            image="exchanged", side_m=side_m, ahead_m=ahead_m, left_m=-way * beside_m, centre_height_m=centre_height_m
        ),
        LookAlike(
            image="picture",
            side_m=smaller_m,
            ahead_m=ahead_m,
            left_m=0.0,
            centre_height_m=centre_height_m + (side_m + smaller_m) / 2 + 0.01,
        ),
    )
    images = ("mirrored", "exchanged", "picture", "board", "board", "board")
    return Clutter(look_alikes=look_alikes, boards=tuple(_draw_board(rng, n, images[n]) for n in range(BOARDS)))


def _draw_board(rng: np.random.Generator, number: int, image: str) -> Board:
    lane = number % len(LANES_M)
    course = _round_the_room(ROOM_HALF_SIZE_M - LANES_M[lane])
    speed_m_s = float(rng.uniform(_SLOWEST_M_S, _FASTEST_M_S))
    # One lane goes one way: boards behind one another never meet, and those of the two lanes pass.
    start_m = course.length_m * (number // len(LANES_M) + float(rng.uniform(0.0, 0.6))) / (BOARDS / len(LANES_M))
    side_m = float(rng.uniform(0.25, 0.5))
    height_m = side_m if image != "board" else float(rng.uniform(0.5, 1.2))

    def pose(time_s: float) -> Pose:
        travelled_m = speed_m_s * time_s
        return course.at(start_m + travelled_m) if lane == 0 else course.at(start_m - travelled_m)

    return Board(image=image, width_m=side_m, height_m=height_m, pose=pose)


def _round_the_room(half_m: float) -> ClosedCourse:
    """A square with rounded corners, counter-clockwise."""
    corner = np.linspace(0.0, math.pi / 2, 24)
    middle_m = half_m - _CORNER_M
    x, y = [], []
    for quarter in range(4):
        angle = corner + quarter * math.pi / 2
        towards = quarter * math.pi / 2 + math.pi / 4
        x.append(math.copysign(middle_m, math.cos(towards)) + _CORNER_M * np.cos(angle))
        y.append(math.copysign(middle_m, math.sin(towards)) + _CORNER_M * np.sin(angle))
    around = [np.concatenate(part) for part in (x, y)]
    return ClosedCourse(*(np.append(part, part[0]) for part in around))


def mirrored(picture: np.ndarray) -> np.ndarray:
    """Left and right exchanged."""
    return np.ascontiguousarray(picture[:, ::-1])


def exchanged(picture: np.ndarray) -> np.ndarray:
    """The same four quarters, each where the one opposite was; shape (even, even)."""
    rows, columns = picture.shape
    return np.roll(picture, (rows // 2, columns // 2), axis=(0, 1))
