"""The station's loop: newest frame in, tracker, behaviour, command out.

For each frame that the loop takes exactly one command goes back, as the thesis's peers expect. The second tracker
(the shadow) sees the same frames after the command has left, so it costs the robot nothing. What the operator orders
meanwhile takes effect at the beginning of a frame.
"""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

from base_station.behaviours.base import Outcome
from base_station.driver import Driver
from base_station.errors import StationError
from base_station.link import Link
from base_station.orders import Order
from base_station.sockets import LinkLost
from base_station.trackers.base import Tracker
from base_station.trackers.own import close_tracker
from base_station.types import Box, Frame, TrackerResult
from base_station.watcher import Kit, Watcher
from base_station.workshop import Workshop
from protocol import STOP, Command, ProtocolError, Request

log = logging.getLogger(__name__)

WAIT_S = 0.1
PATIENCE_S = 10.0
CLOSING_S = 3.0
"""So long it takes at the most to let go of the trackers; what is not closed then ends with the program."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """All that happened with one frame; what display, results and summary are made from."""

    frame: Frame
    result: TrackerResult
    shadow: TrackerResult | None
    command: Command
    pan_rad: float | None = None
    """Where the camera looked, left of the robot's heading, as far as the robot knows; None when it is fixed."""
    learned: bool
    """The target was learned in this frame."""
    tracker_s: float
    """What the tracker took for this frame (learning not included)."""
    frame_to_command_s: float | None
    """Last byte of the frame received to command handed to the socket; None when the command could not be sent."""
    tracker: str
    """Name of the one that steers."""
    behaviour: str
    shadow_tracker: str | None = None
    orders: tuple[Order, ...] = ()
    """Those that took effect with this frame, in this order."""
    notices: tuple[str, ...] = ()
    """What could not be done as it was ordered, for a person."""


@dataclass(frozen=True, kw_only=True)
class StationSettings:
    behaviour: str = "follow"
    pan: bool = False
    """The behaviour may turn the camera."""
    target: Box | None = None
    """Learned in the first frame; None: what the simulated operator says, else the whole view."""
    target_rows: int | None = None
    """Of the target's box learn no more than so many rows, those in the middle."""
    duration_s: float | None = None
    """End after this much of the frames' time; None: until told."""
    max_frames: int | None = None
    until_there: bool = False
    """End when the behaviour's journey is over (see `behaviours.base.Journey`)."""
    rows: bool = False
    """Ask the robot for the rows only that the trackers want."""


class Station:
    """Runs one robot. `on_step` is called after each frame's command has gone out, `on_wait` while no frame comes.

    `make` gives the tracker of a name that is ordered while the station runs (ValueError when it cannot), `remember`
    keeps what a frame shows as a landmark (the same); neither is asked for in the loop's thread. Owns its trackers.
    """

    def __init__(
        self,
        link: Link,
        kit: Kit,
        settings: StationSettings | None = None,
        *,
        shadow: Kit | None = None,
        keys: queue.SimpleQueue[str] | None = None,
        make: Callable[[str], Kit] | None = None,
        remember: Callable[[str, Frame, Box | None], bool] | None = None,
        on_step: Callable[[Step], None] = lambda step: None,
        on_wait: Callable[[], None] = lambda: None,
    ) -> None:
        self._link = link
        self.settings = settings or StationSettings()
        self._workshop: Workshop[Kit | str | None] = Workshop()
        self._watcher = Watcher(kit, shadow=shadow, target_rows=self.settings.target_rows, retire=self._retire)
        self._keys = keys or queue.SimpleQueue()
        self._driver = Driver(link, self.settings.behaviour, self._keys, pan=self.settings.pan)
        self._make, self._remember = make, remember
        self._on_step, self._on_wait = on_step, on_wait
        self._orders: queue.SimpleQueue[Order] = queue.SimpleQueue()
        self._works: list[tuple[Order, Future[Kit | str | None]]] = []
        self._stopping = False
        self._first_order: Order | None = Order.learn(self.settings.target)
        """To learn what the settings say, or the simulated operator; not given yet."""
        self._complaint = ""
        self._notices: list[str] = []
        self._first_s: float | None = None
        self._frames = 0

    @property
    def outcome(self) -> Outcome | None:
        """How the behaviour's journey ended; None while it goes on, or when the behaviour is no journey."""
        return self._driver.outcome

    @property
    def laps(self) -> int | None:
        """Driven to their end; None when the behaviour drives none."""
        return self._driver.laps

    @property
    def tracker(self) -> Tracker:
        """The one that steers now."""
        return self._watcher.tracker

    @property
    def names(self) -> tuple[str, str]:
        """Of the tracker and the behaviour, now."""
        return self._watcher.name, self._driver.behaviour

    @property
    def trackers(self) -> list[Tracker]:
        """The one that steers now, and its shadow."""
        return self._watcher.trackers

    def stop(self) -> None:
        """End the loop after the present frame; signal handlers may call it."""
        self._stopping = True

    def learn_now(self) -> None:
        """Learn the target anew in the next frame."""
        self.post(Order.learn(self._watcher.target))

    def post(self, order: Order) -> None:
        """Carry this out at the beginning of the next frame. From any thread. `stop` and `release` are only noted here:
        `emergency` tells the robot."""
        self._orders.put(order)

    def emergency(self, action: str) -> str:
        """ "stop" or "release" the robot's emergency stop, now; from any thread. Returns what went wrong, in words."""
        self.post(Order(kind=action))
        try:
            reply = self._link.ask(Request(action=action, text="by the operator"))
        except (LinkLost, ProtocolError) as error:
            said = f"the robot did not confirm the emergency {action}: {error}"
        else:
            if reply is None:
                said = f"this robot has no control port: no emergency {action}, commands only"
            else:
                said = "" if reply.ok else f"the robot refused the emergency {action}: {reply.error}"
        if said:
            log.error("%s", said)
        return said

    def run(self) -> None:
        """Until `stop`, the duration, or the end of a recording. Sends a stop at the end. Raises StationError."""
        last_frame_s = time.monotonic()
        try:
            while not self._stopping:
                received = self._link.next_frame(WAIT_S)
                if received is not None:
                    last_frame_s = time.monotonic()
                    self._on_step(self._step(*received))
                elif self._link.ended:
                    return
                else:
                    self._wait(time.monotonic() - last_frame_s)
        finally:
            self._link.send(STOP)
            self._driver.let_go_of_head()

    def close(self) -> None:
        """Close the trackers, also one that is still in the making, if that does not take too long. After `run`."""
        for _, work in self._works:
            if not work.cancel():
                work.add_done_callback(self._unwanted)
        self._watcher.close()
        self._workshop.close(CLOSING_S)

    def _unwanted(self, work: Future[Kit | str | None]) -> None:
        """Made, but too late."""
        if work.exception() is None and isinstance(kit := work.result(), Kit):
            close_tracker(kit.tracker)

    def _wait(self, without_frames_s: float) -> None:
        """No frame came. A run of limited length does not wait for ever for a robot that went."""
        self._on_wait()
        self._forget_driving()
        duration_s = self.settings.duration_s
        if duration_s is not None and without_frames_s > max(duration_s, PATIENCE_S):
            raise StationError(f"No frame for {without_frames_s:.0f} s ({self._link.state}): the run ends here.")

    def _forget_driving(self) -> None:
        """A key pressed while the robot was away must not move it when it is back."""
        while not self._keys.empty():
            self._keys.get_nowait()
        for order in self._taken():
            if order.kind != "drive":
                self.post(order)

    def _taken(self) -> list[Order]:
        """The orders that came until now."""
        return [self._orders.get_nowait() for _ in range(self._orders.qsize())]

    def _step(self, frame: Frame, arrival_s: float) -> Step:
        self._count(frame)
        self._notices = []
        self._driver.renew(frame)
        orders = [order for order in self._due(frame) if self._carry_out(order, frame)] + self._made()
        seen = self._watcher.look(frame)
        self._complain()
        angles = self._link.camera_angles(frame)
        command = self._driver.command(seen.result if self._watcher.learned else None, frame, angles)
        if self.settings.rows:  # before the command: in lockstep the next frame may come at once
            self._link.want_rows(self._watcher.wanted_rows(), frame.connection)
        sent_s = self._link.send(command, frame.connection)
        self._link.show(self._driver.sight(seen.result), frame.connection)
        self._driver.note_outcome()
        if self.settings.until_there and self._driver.outcome is not None:
            self._stopping = True
        return Step(
            frame=frame,
            result=seen.result,
            shadow=self._watcher.look_in_shadow(frame, seen),
            command=command,
            pan_rad=angles[0] if angles is not None else None,
            learned=seen.learned,
            tracker_s=seen.tracker_s,
            frame_to_command_s=None if sent_s is None else sent_s - arrival_s,
            tracker=self._watcher.name,
            shadow_tracker=self._watcher.shadow_name,
            behaviour=self._driver.behaviour,
            orders=tuple(orders),
            notices=tuple(self._notices),
        )

    # -- orders ----------------------------------------------------------------------------------------------------

    def _due(self, frame: Frame) -> list[Order]:
        """What is to be carried out with this frame."""
        first = self._learn_at_first(frame)
        return ([first] if first is not None else []) + self._taken()

    def _learn_at_first(self, frame: Frame) -> Order | None:
        """Once: to learn the user's box, else what the simulated operator says and when, else the whole view."""
        event = next((event for event in self._link.events if event.kind == "learn"), None)
        order = self._first_order
        if order is not None and self.settings.target is None and event is not None:
            if frame.number < event.frame:
                return None
            order = Order(kind="learn", box=event.box)
        self._first_order = None
        return order

    def _carry_out(self, order: Order, frame: Frame) -> bool:
        """Whether it takes effect with this frame. What cannot be done is said, and changes nothing."""
        if order.kind == "learn":
            self._first_order = None  # whatever was to be learned at first, the operator wants this
            self._watcher.choose(order.target)
        elif order.kind in ("tracker", "shadow"):
            return self._exchange(order)
        elif order.kind == "behaviour":
            return self._change_behaviour(order.name, frame)
        elif order.kind == "drive":
            self._driver.steer(order, frame)
        elif order.kind == "remember":
            self._work(order, lambda: self._keep(order.name, frame, order.target))
        return True

    def _change_behaviour(self, name: str, frame: Frame) -> bool:
        try:
            self._driver.change(name, frame)
        except ValueError as error:
            self._notice(f"cannot go on with {name}: {error}")
            return False
        return True

    def _exchange(self, order: Order) -> bool:
        """Let the tracker be made; the order takes effect when it is there (`_made`)."""
        if order.kind == "shadow" and not order.name:
            self._watcher.exchange_shadow(None)
            return True
        if self._make is None:
            self._notice("this station cannot change its trackers")
            return False
        make = self._make
        self._work(order, lambda: make(order.name))
        self._notice(f"{order.name} is being made", logging.INFO)
        return False

    def _work(self, order: Order, task: Callable[[], Kit | str]) -> None:
        self._works.append((order, self._workshop.submit(task)))

    def _made(self) -> list[Order]:
        """The trackers that are ready now go to work; returns what they were ordered by."""
        ready = [(order, work) for order, work in self._works if work.done()]
        self._works = [(order, work) for order, work in self._works if not work.done()]
        return [order for order, work in ready if self._take_up(order, work)]

    def _take_up(self, order: Order, work: Future[Kit | str | None]) -> bool:
        try:
            made = work.result()
        except Exception as error:  # a tracker of the user's own may fail in any way
            self._notice(f"cannot {order.kind} {order.name}: {error}")
            return False
        if isinstance(made, str):
            self._notice(made, logging.INFO)
            return False
        assert made is not None, "only a tracker's end gives nothing, and nothing waits for that"
        if order.kind == "tracker":
            self._watcher.exchange(made)
        else:
            self._watcher.exchange_shadow(made)
        return True

    def _keep(self, name: str, frame: Frame, target: Box | None) -> str:
        """What came of it, in words."""
        if self._remember is None:
            raise ValueError("this station keeps no landmarks")
        told = "; the one of this name before is replaced" if self._remember(name, frame, target) else ""
        return f"{name} is remembered as it looks now{told}"

    def _retire(self, tracker: Tracker) -> None:
        self._workshop.submit(lambda: close_tracker(tracker))

    def _notice(self, text: str, level: int = logging.WARNING) -> None:
        self._notices.append(text)
        log.log(level, "%s", text)

    def _complain(self) -> None:
        """Say once why a target cannot be learned."""
        complaint = self._watcher.complaint
        if complaint and complaint != self._complaint:
            self._notice(f"cannot learn this target: {complaint}")
        self._complaint = complaint

    def _count(self, frame: Frame) -> None:
        self._frames += 1
        if self._first_s is None:
            self._first_s = frame.time_s
        over = self.settings.duration_s is not None and frame.time_s - self._first_s >= self.settings.duration_s
        if over or self._frames == self.settings.max_frames:
            self._stopping = True
