"""The Aseba network on D-Bus: variables of one node, read and written asynchronously.

asebamedulla puts the robots on the bus (thesis, section 3.2.1 and listing A.1). A call takes as long as the robot takes
to answer, some 30 ms, so nothing here waits: a GLib main loop runs in a thread of its own, calls go out from it and
answers come back in it. This is the only module that knows dbus and gi; who may wait (for asebaplayground's answers,
say, which come at once) makes calls through BusCalls.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from robot_agent.errors import AgentError

log = logging.getLogger(__name__)

SERVICE, OBJECT_PATH = "ch.epfl.mobots.Aseba", "/"
INTERFACE = "ch.epfl.mobots.AsebaNetwork"
CALL_TIMEOUT_S = 1.0
LOOK_AGAIN_MS = 250
MAX_VALUES = 256


class NodeListener(Protocol):
    """Told in the bus's thread about the node's coming and going."""

    def node_found(self, variables: frozenset[str]) -> None: ...

    def node_lost(self, why: str) -> None:
        """It is not there (or not yet), for this reason, in words; told again when the reason is another."""


class AsebaBus:
    """One node of the Aseba network, looked for by name from `start` until it is there, and again after it went.

    `bus`: "session", "system" or a bus's address. Raises AgentError when dbus-python or PyGObject is missing, or there
    is no such bus.
    """

    def __init__(self, *, bus: str, node: str, listener: NodeListener) -> None:
        self._dbus, self._glib = _load()
        self._node, self._listener = node, listener
        self._why_absent = ""
        self._bus = _open(self._dbus, bus, self._dbus.mainloop.glib.DBusGMainLoop())
        self._present = False
        self._generation = 0
        self._network: Any = None
        self._loop = self._glib.MainLoop()
        self._thread = threading.Thread(target=self._loop.run, name="aseba", daemon=True)

    def start(self) -> None:
        """Begin to look for the node."""
        self._watch = self._bus.watch_name_owner(SERVICE, self._owner_changed)
        self._thread.start()

    # -- any thread ------------------------------------------------------------------------------------------------

    def call_soon(self, task: Callable[[], None]) -> None:
        """Run `task` in the bus's thread."""

        def once() -> bool:
            task()
            return False

        self._glib.idle_add(once)

    def call_every(self, period_s: float, task: Callable[[], None]) -> None:
        """Run `task` in the bus's thread, again and again."""

        def again() -> bool:
            task()
            return True

        self._glib.timeout_add(max(1, round(period_s * 1000)), again)

    def close(self) -> None:
        """End the thread. Answers that are under way are dropped."""
        self._loop.quit()
        self._thread.join(timeout=2.0)
        self._bus.close()

    # -- the bus's thread ------------------------------------------------------------------------------------------

    def get(self, variable: str, on_values: Callable[[list[int]], None], on_error: Callable[[str], None]) -> None:
        """Ask for a variable's values."""
        generation = self._generation

        def answered(values: Sequence[int]) -> None:
            if generation == self._generation:
                on_values([int(value) for value in values[:MAX_VALUES]])

        self._call(self._network.GetVariable, variable, answered=answered, on_error=on_error)

    def set(
        self, variable: str, values: Sequence[int], on_done: Callable[[], None], on_error: Callable[[str], None]
    ) -> None:
        """Write a variable."""
        generation = self._generation

        def answered() -> None:
            if generation == self._generation:
                on_done()

        array = self._dbus.Array(values, signature="n")
        self._call(self._network.SetVariable, variable, array, answered=answered, on_error=on_error)

    def _call(self, method: Any, *arguments: Any, answered: Any, on_error: Callable[[str], None]) -> None:
        generation = self._generation

        def failed(error: Any) -> None:
            if generation == self._generation:
                text = error.get_dbus_message() if hasattr(error, "get_dbus_message") else str(error)
                on_error(str(text))

        method(self._node, *arguments, reply_handler=answered, error_handler=failed, timeout=CALL_TIMEOUT_S)

    def _owner_changed(self, owner: str) -> None:
        if not owner:
            self._lose(f"asebamedulla is not on the bus (nobody owns {SERVICE})")
            return
        proxy = self._bus.get_object(SERVICE, OBJECT_PATH, introspect=False)
        self._network = self._dbus.Interface(proxy, dbus_interface=INTERFACE)
        self._look_for_node()

    def _look_for_node(self) -> bool:
        """Ask for the node; called again until it is there, and now and then after, to notice that it went."""
        if self._network is not None:
            self._network.GetNodesList(
                reply_handler=self._listed, error_handler=self._not_listed, timeout=CALL_TIMEOUT_S
            )
        return False

    def _listed(self, nodes: Sequence[str]) -> None:
        names = [str(name) for name in nodes]
        if self._node not in names:
            self._lose(f"asebamedulla sees no node {self._node!r} (it sees {', '.join(names) or 'none'}; --node)")
        elif not self._present:
            self._network.GetVariablesList(
                self._node, reply_handler=self._found, error_handler=self._not_listed, timeout=CALL_TIMEOUT_S
            )
            return
        self._glib.timeout_add(LOOK_AGAIN_MS, self._look_for_node)

    def _not_listed(self, error: Any) -> None:
        self._lose(f"asebamedulla does not answer ({error})")
        if self._network is not None:
            self._glib.timeout_add(LOOK_AGAIN_MS, self._look_for_node)

    def _found(self, variables: Sequence[str]) -> None:
        self._present, self._why_absent = True, ""
        self._generation += 1
        log.info("robot: node %s found", self._node)
        self._listener.node_found(frozenset(str(name) for name in variables))
        self._glib.timeout_add(LOOK_AGAIN_MS, self._look_for_node)

    def _lose(self, why: str) -> None:
        if "nobody owns" in why:
            self._network = None
        self._present = False
        self._generation += 1
        if why != self._why_absent:
            self._why_absent = why
            self._listener.node_lost(why)


class BusCalls:
    """Calls that wait for their answer, on a connection of its own. May be used from one thread at a time.

    `bus`: as for AsebaBus. Raises AgentError likewise.
    """

    def __init__(self, bus: str) -> None:
        self._dbus, _ = _load()
        self._bus = _open(self._dbus, bus, None)

    def has(self, service: str) -> bool:
        """Whether somebody owns this name."""
        return bool(self._bus.name_has_owner(service))

    def call(self, service: str, path: str, method: str, signature: str, *arguments: Any) -> Any:
        """What `interface.method` answers. Raises AgentError when it does not, or not in time."""
        interface, _, name = method.rpartition(".")
        try:
            return self._bus.call_blocking(service, path, interface, name, signature, arguments, CALL_TIMEOUT_S)
        except self._dbus.DBusException as error:
            raise AgentError(f"{service} did not answer ({error.get_dbus_message()}).") from error

    def double(self, value: float) -> Any:
        """A number for an argument of any type (signature v)."""
        return self._dbus.Double(value, variant_level=1)

    def close(self) -> None:
        """Let go of the bus."""
        self._bus.close()


def _open(dbus: Any, bus: str, mainloop: Any) -> Any:
    try:
        if bus == "system":
            return dbus.SystemBus(mainloop=mainloop, private=True)
        if bus == "session":
            return dbus.SessionBus(mainloop=mainloop, private=True)
        return dbus.bus.BusConnection(bus, mainloop=mainloop)
    except dbus.DBusException as error:
        raise AgentError(
            f"There is no D-Bus {bus} bus here ({error.get_dbus_message()}): start agent and asebamedulla in "
            "one session (dbus-run-session), or use --bus system."
        ) from error


def _load() -> tuple[Any, Any]:
    try:
        import dbus
        import dbus.bus
        import dbus.mainloop.glib
        from gi.repository import GLib
    except ImportError as error:
        raise AgentError(
            "The Thymio over D-Bus needs dbus-python and PyGObject: sudo apt install python3-dbus python3-gi, or "
            "pip install 'zservo[thymio]'."
        ) from error
    dbus.mainloop.glib.threads_init()
    return dbus, GLib
