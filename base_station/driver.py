"""Drives by a behaviour: makes it anew for each connection, and asks it for the command of each frame."""

from __future__ import annotations

import logging
import queue

from base_station.behaviours.base import Behaviour, Drive, Journey, Outcome, Steered
from base_station.behaviours.registry import BehaviourContext, make_behaviour
from base_station.behaviours.route import Route
from base_station.errors import StationError
from base_station.geometry import FlatPose
from base_station.head import Angles, PanHead
from base_station.link import Link
from base_station.orders import Order
from base_station.types import Frame, TrackerResult, TrackingState
from protocol import Command, RobotLimits

log = logging.getLogger(__name__)

SIGHT_OF = {TrackingState.TRACKING: "tracking", TrackingState.LOST: "lost"}
"""What the lights are told (one of the protocol's SIGHTS)."""
LOCKSTEP_LOOK_S = 0.5
"""In lockstep, where the robot's time stands until the command comes, the camera's goal may take so long to arrive."""
NO_PAN_TILT = (
    "This robot's camera cannot be turned: leave out --pan, or start its agent with --pan-tilt servoblaster "
    "(--pan-tilt sim for the simulated robot)."
)


class Driver:
    """`behaviour`: by its name. `keys`: that a person presses. `pan`: the behaviour may turn the camera."""

    def __init__(self, link: Link, behaviour: str, keys: queue.SimpleQueue[str], *, pan: bool) -> None:
        self._link, self._keys, self._pan = link, keys, pan
        self.behaviour = behaviour
        """Its name."""
        self.outcome: Outcome | None = None
        """How the behaviour's journey ended; None while it goes on, or when the behaviour is no journey."""
        self._at_work: Behaviour | None = None
        self._head: PanHead | None = None
        self._connection = ""
        self._driven: FlatPose | None = None
        """Where the robot is in the present frame, by its wheels."""

    @property
    def laps(self) -> int | None:
        """Driven to their end; None when the behaviour drives none."""
        return self._at_work.laps if isinstance(self._at_work, Route) else None

    def renew(self, frame: Frame) -> None:
        """A new behaviour for each connection: the robot may have other limits now, and the past says nothing.

        Raises StationError when this robot or scene does not allow it.
        """
        if self._at_work is not None and frame.connection == self._connection:
            return
        self._connection = frame.connection
        self.let_go_of_head()
        if self._pan:
            self._head = self._take_head()
        try:
            self._at_work = self._make(self.behaviour, frame)
        except ValueError as error:
            raise StationError(f"--behaviour {self.behaviour}: {error}.", usage=True) from error

    def change(self, behaviour: str, frame: Frame) -> None:
        """Go by another one. Raises ValueError, and goes on as before, when this robot or scene does not allow it."""
        self._at_work = self._make(behaviour, frame)
        self.behaviour = behaviour

    def steer(self, order: Order, frame: Frame) -> None:
        """Hand on where a person wants to go; a behaviour that is not steered takes no notice."""
        if isinstance(self._at_work, Steered):
            self._at_work.steer(order.forward, order.left, frame.time_s)

    def command(self, result: TrackerResult | None, frame: Frame, angles: Angles | None) -> Command:
        """`result`: None before a target was learned. `angles`: where the camera looks; None when it is fixed."""
        assert self._at_work is not None, "no frame of this connection came to `renew`"
        if self._head is not None and angles is not None:
            self._head.pan_rad = angles[0]
        self._driven = self._link.driven(frame)
        command = self._at_work.command(result, frame.time_s)
        if self._head is not None and self._link.hello is not None and self._link.hello.rhythm == "lockstep":
            self._head.settle(LOCKSTEP_LOOK_S)
        return command

    def sight(self, result: TrackerResult) -> str:
        """What the robot's lights are to tell; a station that does not drive by what it sees is idle."""
        if self.behaviour not in ("follow", "goto"):
            return "idle"
        return SIGHT_OF.get(result.state, "idle")

    def note_outcome(self) -> None:
        """Say once how a journey ended."""
        outcome = self._at_work.outcome if isinstance(self._at_work, Journey) else None
        if outcome is not None and outcome != self.outcome:
            log.info("%s", outcome.text)
        self.outcome = outcome

    def let_go_of_head(self) -> None:
        """Turn the camera no more; it is taken again with the next connection."""
        if self._head is not None:
            self._head.close()
            self._head = None

    def _make(self, name: str, frame: Frame) -> Behaviour:
        hello = self._link.hello
        context = BehaviourContext(
            drive=Drive(hello.limits if hello is not None else RobotLimits()),
            keys=self._keys,
            camera=frame.camera,
            head=self._head,
            course=hello.scenario.course if hello is not None and hello.scenario is not None else (),
            where=lambda: self._driven,
        )
        return make_behaviour(name, context)

    def _take_head(self) -> PanHead:
        hello = self._link.hello
        if hello is None or hello.pan_tilt is None:
            raise StationError(NO_PAN_TILT, usage=True)
        return PanHead(hello.pan_tilt, self._link.control_line())
