"""A furnished room around a closed course: boxes and tables on the floor, pictures on the walls, each with a face of
its own, so that no two places look alike. Drawn from a seeded generator; nothing here knows the physics engine."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_agent.sim.courses import ROOM_HALF_SIZE_M, ClosedCourse
from robot_agent.sim.poses import Pose

CLEARANCE_M = 0.30
"""Between the course and what stands on the floor."""
_BY_THE_WALLS, _ANYWHERE, _PICTURES = 14, 6, 16
_TRIES = 60
_SLAB_M, _LEG_M = 0.02, 0.03
_PLACES_PER_M = 20


@dataclass(frozen=True, kw_only=True)
class Block:
    """An upright box. `pose`: of its middle, from above; `size_m`: along its heading, across, and up; `bottom_m`: how
    high it begins. `printed`: its faces carry a picture."""

    pose: Pose
    size_m: tuple[float, float, float]
    bottom_m: float = 0.0
    printed: bool = True


def furnish(rng: np.random.Generator, course: ClosedCourse) -> tuple[Block, ...]:
    """Furniture that leaves the course free."""
    count = math.ceil(course.length_m * _PLACES_PER_M)
    way = np.array([(p.x_m, p.y_m) for p in (course.at(course.length_m * k / count) for k in range(count))])
    taken: list[tuple[float, float, float]] = []
    blocks: list[Block] = []
    for number in range(_BY_THE_WALLS + _ANYWHERE):
        for _ in range(_TRIES):
            pose = _by_a_wall(rng) if number < _BY_THE_WALLS else _anywhere(rng)
            length, width = float(rng.uniform(0.25, 0.6)), float(rng.uniform(0.2, 0.4))
            radius = math.hypot(length, width) / 2
            free = np.hypot(*(way - (pose.x_m, pose.y_m)).T).min() > radius + CLEARANCE_M
            if free and all(math.dist((pose.x_m, pose.y_m), (x, y)) > radius + r for x, y, r in taken):
                taken.append((pose.x_m, pose.y_m, radius))
                height = float(rng.uniform(0.2, 0.75))
                blocks += _table(pose, length, width, height) if rng.random() < 0.25 else [
                    Block(pose=pose, size_m=(length, width, height))
                ]  # fmt: skip
                break
    return (*blocks, *(_picture(rng, number) for number in range(_PICTURES)))


def _by_a_wall(rng: np.random.Generator) -> Pose:
    along, off = float(rng.uniform(-2.5, 2.5)), ROOM_HALF_SIZE_M - float(rng.uniform(0.35, 0.7))
    quarter = int(rng.integers(4)) * math.pi / 2
    middle = Pose(x_m=0.0, y_m=0.0, heading_rad=quarter).moved(ahead_m=off, left_m=along)
    return middle.moved(turned_rad=math.pi / 2 + float(rng.uniform(-0.3, 0.3)))


def _anywhere(rng: np.random.Generator) -> Pose:
    x, y, heading = rng.uniform((-2.4, -2.4, -math.pi), (2.4, 2.4, math.pi))
    return Pose(x_m=float(x), y_m=float(y), heading_rad=float(heading))


def _table(pose: Pose, length: float, width: float, height: float) -> list[Block]:
    top = Block(pose=pose, size_m=(length, width, _SLAB_M), bottom_m=height)
    ends = [(a * (length - _LEG_M) / 2, b * (width - _LEG_M) / 2) for a in (-1, 1) for b in (-1, 1)]
    legs = [
        Block(pose=pose.moved(ahead_m=a, left_m=b), size_m=(_LEG_M, _LEG_M, height), printed=False) for a, b in ends
    ]
    return [top, *legs]


def _picture(rng: np.random.Generator, number: int) -> Block:
    """On each wall in turn, in one of equal parts of it."""
    parts = _PICTURES // 4
    along = (number // 4 + float(rng.uniform(0.25, 0.75))) / parts * 5.2 - 2.6
    wall = Pose(x_m=0.0, y_m=0.0, heading_rad=number % 4 * math.pi / 2)
    size = (_SLAB_M, float(rng.uniform(0.35, 0.7)), float(rng.uniform(0.3, 0.6)))
    middle = wall.moved(ahead_m=ROOM_HALF_SIZE_M - _SLAB_M / 2, left_m=along)
    return Block(pose=middle, size_m=size, bottom_m=float(rng.uniform(0.1, 0.7)))
