"""A Thymio II over D-Bus and asebamedulla, as the thesis drives it (listing A.1), without ever waiting for the bus.

Wheel targets are written when they change and when the write before was answered, so the bus sets the pace and the
newest target wins. Sensors are asked for in turn, one question under way at a time.
"""

from __future__ import annotations

import functools
import itertools
import logging
import time
from collections.abc import Callable, Iterator

from robot_agent.robots.aseba import AsebaBus
from robot_agent.robots.thymio_node import (
    ACCELERATION,
    BATTERY,
    BUTTON,
    GROUND,
    LEFT_SPEED,
    LEFT_TARGET,
    LIGHT,
    PROXIMITY,
    RIGHT_SPEED,
    RIGHT_TARGET,
    ThymioNode,
)

log = logging.getLogger(__name__)

SLOW_SENSORS = (
    *(GROUND, BUTTON, ACCELERATION, LEFT_TARGET),
    *(GROUND, BUTTON, LEFT_SPEED, RIGHT_SPEED, RIGHT_TARGET),
)
"""Read one per turn between two readings of the proximity sensors. What stops the robot comes up more often. The
targets are read because asebamedulla answers a write whether it reached the robot or not."""
POLL_S = 0.02
BATTERY_EVERY_S = 5.0


class ThymioRobot(ThymioNode):
    """Implements Robot. Raises AgentError when the node is not found within some seconds, or the trim is out of range.

    `bus`, `node`: see AsebaBus; `trim`: see ThymioNode.
    """

    kind = "thymio"
    if_silent = " (after it was unplugged, start asebamedulla again: it does not find it by itself)"

    def __init__(
        self,
        *,
        bus: str = "session",
        node: str = "thymio-II",
        trim: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(trim=trim, clock=clock)
        self._written: tuple[int, int] | None = None
        self._lit: tuple[int, int, int] | None = None
        self._writing = self._asking = False
        self._variables: frozenset[str] = frozenset()
        self._turn: Iterator[str] = itertools.cycle(())
        self._battery_due_s = float("-inf")
        self._bus = AsebaBus(bus=bus, node=node, listener=self)
        self._bus.call_every(POLL_S, self._ask)
        self._bus.start()
        self._wait_until_found("Plug it in, switch it on, and start asebamedulla.")

    # -- any thread ------------------------------------------------------------------------------------------------

    def _write_soon(self) -> None:
        self._bus.call_soon(self._write)

    def _read_back(self) -> None:
        def right(left: list[int]) -> None:
            self._bus.get(RIGHT_TARGET, functools.partial(self.targets_read_back, left), lambda why: None)

        def ask() -> None:
            if not self.why_absent:
                self._bus.get(LEFT_TARGET, right, lambda why: None)

        self._bus.call_soon(ask)

    def _disconnect(self) -> None:
        self._bus.close()

    # -- the bus's thread ------------------------------------------------------------------------------------------

    def node_found(self, variables: frozenset[str]) -> None:
        """See NodeListener."""
        self._variables = variables
        self._turn = itertools.cycle([name for name in SLOW_SENSORS if name in variables] or [PROXIMITY])
        self._asking = self._writing = False
        self._written = self._lit = None
        self.has_come()
        self._write()

    def node_lost(self, why: str) -> None:
        """See NodeListener."""
        self.has_gone(why)
        self._writing = self._asking = False
        self._written = self._lit = None

    def _write(self) -> None:
        if self._writing or self.why_absent:
            return
        wanted, colour = self.wanted()
        if wanted != self._written:
            left, right = wanted
            self._write_all({LEFT_TARGET: [left], RIGHT_TARGET: [right]}, functools.partial(self._wrote, wanted))
        elif colour != self._lit and LIGHT in self._variables:
            self._write_all({LIGHT: list(colour)}, functools.partial(self._lit_up, colour))

    def _wrote(self, targets: tuple[int, int]) -> None:
        self._written = targets

    def _lit_up(self, colour: tuple[int, int, int]) -> None:
        self._lit = colour

    def _write_all(self, values: dict[str, list[int]], on_done: Callable[[], None]) -> None:
        """Write these variables, then what is wanted by the time that all are answered."""
        self._writing = True
        waiting = set(values)

        def done(name: str) -> None:
            waiting.discard(name)
            if not waiting:
                self._writing = False
                on_done()
                self._write()

        def failed(why: str) -> None:
            log.warning("the robot did not take %s: %s", ", ".join(values), why)
            self._writing, self._written, self._lit = False, None, None

        for name, written in values.items():
            self._bus.set(name, written, functools.partial(done, name), failed)

    def _ask(self) -> None:
        """Read the proximity sensors, then one of the slower ones; the next round begins when both have answered."""
        if self.why_absent or self._asking:
            return
        self._asking = True
        self._write()  # a write that failed is tried again
        self._bus.get(PROXIMITY, self._ask_slow_sensor, self._not_answered)

    def _ask_slow_sensor(self, proximity: list[int]) -> None:
        self.keep(PROXIMITY, proximity)
        name, written = self._next_sensor(), self._written

        def take(values: list[int]) -> None:
            self._asking = False
            self.keep(name, values)
            if written is not None and written == self._written:
                self._check_target(name, values, written)

        self._bus.get(name, take, self._not_answered)

    def _check_target(self, name: str, values: list[int], written: tuple[int, int]) -> None:
        """A write may get lost on its way (over the radio, say): then it is written anew."""
        expected = {LEFT_TARGET: written[0], RIGHT_TARGET: written[1]}.get(name)
        if expected is not None and not self._writing and values != [expected]:
            self._written = None
            self._write()

    def _next_sensor(self) -> str:
        now_s = self._clock()
        if BATTERY in self._variables and now_s >= self._battery_due_s:
            self._battery_due_s = now_s + BATTERY_EVERY_S
            return BATTERY
        return next(self._turn)

    def _not_answered(self, why: str) -> None:
        self._asking = False
