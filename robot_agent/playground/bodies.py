"""Where asebaplayground's robots are, over D-Bus: read and set. A call takes some tenths of a millisecond, or as long
as the playground draws just then."""

from __future__ import annotations

from robot_agent.errors import AgentError
from robot_agent.playground.description import from_playground, to_playground
from robot_agent.playground.programs import PLAYGROUND_SERVICE
from robot_agent.robots.aseba import BusCalls
from robot_agent.sim.poses import Pose

_WORLD = "ch.epfl.mobots.EnkiWorld"
_OBJECT = "ch.epfl.mobots.EnkiPhysicalObject"
_PROPERTIES = "org.freedesktop.DBus.Properties"


class Body:
    """One robot of the playground."""

    def __init__(self, bus: BusCalls, path: str) -> None:
        self._bus, self._path = bus, path

    def pose(self) -> Pose:
        """Where it is. Raises AgentError when the playground does not answer."""
        values = self._bus.call(PLAYGROUND_SERVICE, self._path, f"{_PROPERTIES}.GetAll", "s", _OBJECT)
        return from_playground(float(values["x"]), float(values["y"]), float(values["angle"]))

    def place(self, pose: Pose) -> None:
        """Put it there. Raises AgentError when the playground does not answer."""
        for name, value in zip(("x", "y", "angle"), to_playground(pose), strict=True):
            number = self._bus.double(value)
            self._bus.call(PLAYGROUND_SERVICE, self._path, f"{_PROPERTIES}.Set", "ssv", _OBJECT, name, number)


def find_bodies(bus: BusCalls, starts: list[Pose]) -> list[Body]:
    """The robots that stand at these poses, in this order: the playground itself does not tell them apart by name.

    Raises AgentError when there are not as many.
    """
    keys = bus.call(PLAYGROUND_SERVICE, "/world", f"{_WORLD}.PhysicalObjectsByType", "s", "Thymio2")
    paths = [str(bus.call(PLAYGROUND_SERVICE, "/world", f"{_WORLD}.PhysicalObject", "s", key)) for key in keys]
    bodies = [Body(bus, path) for path in paths]
    if len(bodies) != len(starts):
        raise AgentError(f"The playground has {len(bodies)} robots instead of {len(starts)}.")
    poses = [body.pose() for body in bodies]
    found = []
    for start in starts:
        nearest = min(
            range(len(bodies)), key=lambda k: (poses[k].x_m - start.x_m) ** 2 + (poses[k].y_m - start.y_m) ** 2
        )
        found.append(bodies[nearest])
    return found
