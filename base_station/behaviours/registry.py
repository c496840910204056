"""The behaviours by name: one line each."""

from __future__ import annotations

import difflib
import queue
from collections.abc import Callable
from dataclasses import dataclass

from base_station.behaviours.base import Behaviour, Drive, Head
from base_station.behaviours.follow import Follow
from base_station.behaviours.goto import Goto
from base_station.behaviours.route import Route
from base_station.behaviours.scripted import Idle, Pattern
from base_station.behaviours.teleop import Teleop
from base_station.geometry import FlatPose, PinholeCamera


@dataclass(frozen=True)
class BehaviourContext:
    """What a behaviour may be made from."""

    drive: Drive
    keys: queue.SimpleQueue[str]
    camera: PinholeCamera
    head: Head | None = None
    """The camera's pan-tilt, when it is to be used."""
    course: tuple[tuple[float, float], ...] = ()
    """Waypoints of a lap, in m, from where the robot was when the connection began."""
    where: Callable[[], FlatPose | None] = lambda: None
    """Where the robot is in the present frame, by its wheels."""


BEHAVIOURS: dict[str, Callable[[BehaviourContext], Behaviour]] = {
    "follow": lambda context: Follow(context.drive, head=context.head),
    "goto": lambda context: Goto(context.drive, context.camera),
    "idle": lambda context: Idle(),
    "route": lambda context: Route(context.drive, context.course, context.where),
    "pattern": lambda context: Pattern(),
    "teleop": lambda context: Teleop(context.drive, context.keys),
}


def check_behaviour(name: str) -> None:
    """Raises ValueError, naming the valid ones, when there is no such behaviour."""
    if name not in BEHAVIOURS:
        close = difflib.get_close_matches(name, BEHAVIOURS, n=1)
        hint = f" Perhaps you meant {close[0]}." if close else ""
        raise ValueError(f"There is no behaviour {name!r}; there are {', '.join(BEHAVIOURS)}.{hint}")


def make_behaviour(name: str, context: BehaviourContext) -> Behaviour:
    """Raises ValueError for an unknown name."""
    check_behaviour(name)
    return BEHAVIOURS[name](context)
