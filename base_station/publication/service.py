"""A station made public on this machine: a private folder, the publisher, and the two desks that take wishes.

For a running station or for a replay: who takes part says what robot there is, which names can be chosen, and what to
do with orders.
"""

from __future__ import annotations

import difflib
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import zmq

from base_station.errors import StationError
from base_station.orders import LANDMARK, Order
from base_station.publication.desk import Desk
from base_station.publication.publisher import Publisher
from base_station.publication.schema import Addresses, Wish
from base_station.publication.states import Choices, RobotView, StateMaker
from base_station.station import Step
from base_station.trackers.base import Tracker

LONGEST_FOLDER = 80
"""A socket's path may have 107 letters."""
NO_ORDERS = "this is a replay: it takes no orders"


class OrderTaker(Protocol):
    """Whom orders go to, from any thread; a `Station` is one."""

    def post(self, order: Order) -> None: ...
    def emergency(self, action: str) -> str: ...


class Publication:
    """Use as a context manager around the loop; call `step` and `wait` in its thread.

    `orders`: None takes none. `forget`: a landmark, by its name; raises ValueError. `tick`: called five times a second,
    not in the loop's thread.
    """

    def __init__(
        self,
        robot: RobotView,
        choices: Callable[[], Choices],
        *,
        orders: OrderTaker | None = None,
        tracker: Callable[[], Tracker | None] = lambda: None,
        outcome: Callable[[], str] = lambda: "",
        forget: Callable[[str], None] | None = None,
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        self._choices, self._orders, self._forget, self._tick = choices, orders, forget, tick
        self._tracker = tracker
        self._maker = StateMaker(robot, choices, outcome=outcome, takes_orders=orders is not None)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.addresses = Addresses(_private_folder())
        self._publisher: Publisher | None = None
        self._desks: list[Desk] = []

    def __enter__(self) -> Publication:
        self._publisher = Publisher(self._context, self.addresses, self._maker, self._tracker)
        self._desks = [
            Desk(self._context, self.addresses.emergency, self._serve_emergency),
            Desk(self._context, self.addresses.orders, self._serve, tick=self._tick),
        ]
        return self

    def __exit__(self, *_: object) -> None:
        for desk in self._desks:
            desk.close()
        if self._publisher is not None:
            self._publisher.close()
        self._context.destroy(linger=0)
        shutil.rmtree(self.addresses.folder, ignore_errors=True)

    def step(self, step: Step) -> None:
        """A frame was dealt with, just now."""
        assert self._publisher is not None
        self._publisher.step(step)

    def wait(self) -> None:
        """No frame came."""
        assert self._publisher is not None
        self._publisher.wait()

    def hold(self) -> None:
        """A replay is at its end: call this some times a second, so long as it is to be seen."""
        assert self._publisher is not None
        self._publisher.hold()

    def _serve_emergency(self, wish: Wish) -> str:
        if self._orders is None:
            return NO_ORDERS
        if wish.order is None or wish.order.kind not in ("stop", "release"):
            return "only stop and release are taken here"
        return _emergency(self._orders, wish.order.kind)

    def _serve(self, wish: Wish) -> str:
        if self._orders is None:
            return NO_ORDERS
        if wish.forget:
            if self._forget is None:
                return "this station keeps no landmarks"
            self._forget(wish.forget)
        elif wish.order is None:
            return "neither an order nor a landmark to forget"
        elif wish.order.kind in ("stop", "release"):
            return _emergency(self._orders, wish.order.kind)
        else:
            wrong = unknown_name(wish.order, self._choices())
            if wrong:
                return wrong
            self._orders.post(wish.order)
        return ""


def _emergency(orders: OrderTaker, action: str) -> str:
    """A robot that does not take the stop, for want of a control port perhaps, is at least no longer driven."""
    wrong = orders.emergency(action)
    if wrong and action == "stop":
        orders.post(Order(kind="behaviour", name="idle"))
        wrong += ". The station goes on with the behaviour idle, which lets the wheels stand."
    return wrong


def unknown_name(order: Order, choices: Choices) -> str:
    """Why this name cannot be ordered; empty when it can. Only names that are offered can: a name may also be a file to
    run, and whoever reaches the console is not to choose that."""
    landmarks = tuple(LANDMARK + name for name in choices.landmarks)
    known = {
        "tracker": choices.trackers + landmarks,
        "shadow": ("", *choices.trackers, *landmarks),
        "behaviour": choices.behaviours,
    }.get(order.kind)
    if known is None or order.name in known:
        return ""
    near = difflib.get_close_matches(order.name, known, n=1)
    hint = f"; did you mean {near[0]}?" if near else ""
    return f"there is no {order.kind} {order.name[:80]!r} to choose{hint}"


def _private_folder() -> Path:
    """For its owner alone (0700), and with a short name."""
    for parent in (None, "/tmp"):
        folder = Path(tempfile.mkdtemp(prefix="zservo-", dir=parent))
        if len(str(folder)) <= LONGEST_FOLDER:
            return folder
        folder.rmdir()
    raise StationError(f"The console's sockets need a folder with a short name; {folder} is too long. Set TMPDIR.")
