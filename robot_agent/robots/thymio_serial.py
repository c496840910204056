"""A Thymio II on a serial port (its cable, or the dongle of the wireless one), or on a TCP port, without D-Bus.

The package thymiodirect speaks Aseba's protocol; this module gives it a connection that survives bad weather. One
message asks for all sensors at once. Aseba confirms no write: a write counts as answered when the robot has answered a
question that was asked after it, and is repeated when that answer shows other targets. A robot that does not answer, or
a port that breaks, is looked for again until it is back.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

from robot_agent.errors import AgentError
from robot_agent.robots.aseba_wire import READ_S, Wire, WireError, check_packages, open_wire
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

SENSORS = (PROXIMITY, GROUND, ACCELERATION, BUTTON, LEFT_SPEED, RIGHT_SPEED, BATTERY)
POLL_S = 0.02
LIST_EVERY_S = 0.5
"""A robot that is not there yet is called this often."""
SILENT_S = 1.0
"""A robot that has not answered for so long is away."""
GREET_S = 4.0
"""A robot that has not told all about itself for so long is asked anew."""
LOOK_AGAIN_S = 0.25


class SerialThymioRobot(ThymioNode):
    """Implements Robot. Raises AgentError when the port cannot be opened or the node is not found within some seconds.

    `device`: see open_wire; `node`: the robot's name; `trim`: see ThymioNode.
    """

    kind = "thymio-serial"

    def __init__(
        self,
        *,
        device: str | None = None,
        node: str = "thymio-II",
        trim: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(trim=trim, clock=clock)
        self._thymiodirect = _load()  # first: what brings it brings pyserial too
        check_packages(device)
        self._device, self._name = device, node
        self._session: _Session | None = None
        self._closing = False
        self._loop = asyncio.new_event_loop()
        self._loop.set_exception_handler(_forgive)
        self._thread = threading.Thread(target=self._run, name="aseba", daemon=True)
        self._thread.start()
        self._wait_until_found("Plug it in and switch it on; --device names its port.")

    # -- any thread ------------------------------------------------------------------------------------------------

    def _write_soon(self) -> None:
        self._soon(lambda session: session.write())

    def _read_back(self) -> None:
        self._soon(lambda session: session.read_back())

    def _soon(self, task: Callable[[_Session], None]) -> None:
        def once() -> None:
            if self._session is not None:
                task(self._session)

        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(once)

    def _disconnect(self) -> None:
        self._closing = True
        self._thread.join(timeout=2.0 * SILENT_S)

    # -- the thread ------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        while not self._closing:
            try:
                await self._meet()
            except WireError as error:
                self.has_gone(str(error))
            except Exception as error:  # whatever thymiodirect makes of garbage: begin again
                self.has_gone(f"the connection failed ({type(error).__name__}: {error})")
            await asyncio.sleep(0.0 if self._closing else LOOK_AGAIN_S)

    async def _meet(self) -> None:
        """Open the port and talk to the robot, until it goes or the driver is closed. Raises WireError."""
        wire = open_wire(self._device, self._is_sound)
        connection = self._thymiodirect.Connection(wire, loop=self._loop)
        try:
            self._session = _Session(self, connection, wire, self._name)
            while not self._closing:
                self._session.go_on()
                await asyncio.sleep(POLL_S)
        finally:
            self._session = None
            connection.shutdown()
            wire.close()
            connection.input_thread.join(timeout=2.0 * READ_S)  # it may still hand a message to the loop
            for task in asyncio.all_tasks() - {asyncio.current_task()}:
                task.cancel()  # thymiodirect's own would stop the loop

    def _is_sound(self, kind: int, source: int, payload: bytes) -> bool:
        """Whether thymiodirect can read this message: garbage would end its reader with a traceback."""
        try:
            self._thymiodirect.connection.Message(kind, source, payload).decode()
        except Exception:  # it checks nothing, so anything may be raised
            return False
        return True


class _Session:
    """One connection to the robot, in the driver's thread. `connection`: thymiodirect's."""

    def __init__(self, robot: SerialThymioRobot, connection: Any, wire: Wire, name: str) -> None:
        self._robot, self._connection, self._wire, self._name = robot, connection, wire, name
        self._node_id: int | None = None
        self._others: set[str] = set()
        self._span = (0, 0)
        self._variables: dict[str, int] = {}
        self._asked, self._answered = 0, 0
        self._writing_since: int | None = None
        self._written: tuple[int, int] | None = None
        self._lit: tuple[int, int, int] | None = None
        self._read_back_from: int | None = None
        self._called_s = float("-inf")
        self._heard_s = time.monotonic()
        connection.on_connection_changed = self._changed
        connection.on_variables_received = self._received

    def go_on(self) -> None:
        """Call for the robot, or ask it for its sensors. Raises WireError when it is not there any more."""
        if self._wire.why_lost:
            raise WireError(self._wire.why_lost)
        now_s = time.monotonic()
        if self._node_id is None:
            self._call(now_s)
        elif now_s - self._heard_s > SILENT_S:
            raise WireError(f"the robot on {self._wire.name} does not answer any more")
        elif self._answered == self._asked:
            self._ask()

    def _call(self, now_s: float) -> None:
        if now_s - self._heard_s > GREET_S:
            seen = ", ".join(sorted(self._others)) or "none"
            raise WireError(f"no node {self._name!r} answers on {self._wire.name} (there is {seen}; --node)")
        if now_s - self._called_s >= LIST_EVERY_S:
            self._called_s = now_s
            self._connection.handshake()

    async def _changed(self, node_id: int, is_there: bool) -> None:
        node = self._connection.remote_nodes.get(node_id)
        if not is_there or node is None:
            return
        if node.name != self._name:
            self._others.add(str(node.name)[:40])
        elif self._node_id is None and {PROXIMITY, LEFT_TARGET, RIGHT_TARGET} <= node.var_offset.keys():
            self._greet(node_id, node)

    def _greet(self, node_id: int, node: Any) -> None:
        """The robot with all its variables: whatever it was doing, it stands first."""
        sensors = [name for name in (*SENSORS, LEFT_TARGET, RIGHT_TARGET) if name in node.var_offset]
        first = min(node.var_offset[name] for name in sensors)
        past_last = max(node.var_offset[name] + node.var_size[name] for name in sensors)
        self._node_id, self._span = node_id, (first, past_last - first)
        self._variables = dict.fromkeys(sensors + [LIGHT] * (LIGHT in node.var_offset), 0)
        self._heard_s = time.monotonic()
        log.info("robot: node %s found on %s", self._name, self._wire.name)
        self._robot.has_come()
        self.write()

    def _ask(self) -> None:
        self._asked += 1
        self._connection.get_variables(self._node_id, *self._span)

    async def _received(self, node_id: int) -> None:
        if node_id != self._node_id:
            return
        self._answered, self._heard_s = self._asked, time.monotonic()
        values = {
            name: [_signed(word) for word in self._connection.get_var_array(node_id, name)]
            for name in self._variables
            if name != LIGHT
        }
        for name in SENSORS:
            if name in values:
                self._robot.keep(name, values[name])
        self._take_answer(values[LEFT_TARGET], values[RIGHT_TARGET])
        self.write()

    def _take_answer(self, left: list[int], right: list[int]) -> None:
        """The targets that the robot has, as an answer to the newest question."""
        if self._writing_since is None or self._answered > self._writing_since:
            self._writing_since = None
            if self._written != (left[0], right[0]):
                self._written = None  # it was lost on its way, or something else on the robot drives too
        if self._read_back_from is not None and self._answered >= self._read_back_from:
            self._read_back_from = None
            self._robot.targets_read_back(left, right)

    def write(self) -> None:
        """Write what is wanted, unless the write before is not answered yet: then the answer comes back here."""
        if self._node_id is None or self._writing_since is not None:
            return
        wanted, colour = self._robot.wanted()
        if wanted != self._written:
            for name, value in zip((LEFT_TARGET, RIGHT_TARGET), wanted, strict=True):
                self._connection.set_var_array(self._node_id, name, [value])
            self._written, self._writing_since = wanted, self._asked
        if colour != self._lit and LIGHT in self._variables:
            self._connection.set_var_array(self._node_id, LIGHT, list(colour))
            self._lit = colour

    def read_back(self) -> None:
        """Tell the robot's driver the targets of the next answer to a question that is still to be asked."""
        if self._read_back_from is None:
            self._read_back_from = self._asked + 1


def _signed(word: int) -> int:
    """Aseba's values are 16 bits in two's complement; thymiodirect gives them unsigned."""
    return (word ^ 0x8000) - 0x8000 if 0 <= word <= 0xFFFF else 0


def _forgive(_loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """A message that thymiodirect could not handle is dropped; silence is what counts."""
    log.debug("thymiodirect: %s", context.get("exception") or context.get("message"))


def _load() -> Any:
    try:
        import thymiodirect
    except ImportError as error:
        raise AgentError(
            "A Thymio without D-Bus needs the package thymiodirect: pip install 'zservo[thymio-serial]'."
        ) from error
    return thymiodirect
