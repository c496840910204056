"""A Thymio II on D-Bus, link by link: bus, asebamedulla, node, firmware, Aseba protocol version, sensors.

Firmware and asebamedulla with different Aseba protocol versions are the thesis's stumbling block (section 3.2.1).
asebamedulla then lists no node and says nothing: neither on D-Bus nor in its log. But it passes all Aseba messages on
to whoever connects to its TCP port, so the version is asked for there, of the robot itself.
"""

from __future__ import annotations

import itertools
import re
import shutil
import socket
import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from robot_agent.doctor.findings import Finding, Verdict
from robot_agent.doctor.machine import run
from robot_agent.errors import AgentError
from robot_agent.robots.aseba import INTERFACE, OBJECT_PATH, SERVICE, BusCalls
from robot_agent.robots.aseba_messages import (
    GET_DESCRIPTION,
    LIST_NODES,
    OLDEST_PROTOCOL,
    AsebaDecoder,
    ask_version,
)

UNIT = "zservo-medulla.service"
MEDULLA_PORT = 33333
PROTOCOL = 5
"""Aseba 1.5 and 1.6, should asebamedulla not tell its own."""
NEEDED_VARIABLES = ("motor.left.target", "motor.right.target", "prox.horizontal")
FIND_S = 3.0
ANSWER_S = 1.2
SLOW_ANSWER_S = 0.15
FIRMWARE_MEND = "update the robot's firmware with Thymio Suite (or the Thymio Firmware Upgrader), on any PC"


def check_thymio(bus: str, node: str) -> Iterator[Finding]:
    """`bus`: session, system or an address; `node`: the robot's name."""
    try:
        calls = BusCalls(bus)
    except AgentError as error:
        no_bus = bus == "session" and not isinstance(error.__cause__, ImportError)
        mend = "dbus-run-session bash, and start asebamedulla and the agent in that shell" if no_bus else ""
        yield Finding("bus", Verdict.FAILED, str(error), mend)
        return
    try:
        yield Finding("bus", Verdict.OK, f"the D-Bus {'session' if ':' in bus else bus} bus is there")
        yield from _Thymio(calls, node).check()
    finally:
        calls.close()


class _Thymio:
    def __init__(self, calls: BusCalls, node: str) -> None:
        self._calls, self._node = calls, node

    def check(self) -> Iterator[Finding]:
        if not self._wait_for_service():
            yield Finding("service", Verdict.FAILED, f"asebamedulla is not on the bus ({SERVICE})", _start_medulla())
            return
        arguments = self._medulla_arguments()
        port = _port(arguments)
        protocol = medulla_protocol()
        target = next((word for word in arguments[1:] if ":" in word), "unknown")
        yield Finding("service", Verdict.OK, f"asebamedulla serves {target}, Aseba protocol {protocol}")
        nodes = self._wait_for_node()
        if self._node not in nodes:
            yield from _explain_absence(nodes, self._node, port, protocol)
            return
        yield Finding("node", Verdict.OK, f"{self._node} is there")
        yield from self._firmware()
        yield from _protocol(node_protocols(port, protocol), protocol)
        yield self._sensors()

    def _ask(self, method: str, *arguments: Any) -> Any:
        signature = "s" * len(arguments)
        return self._calls.call(SERVICE, OBJECT_PATH, f"{INTERFACE}.{method}", signature, *arguments)

    def _wait_for_service(self) -> bool:
        deadline_s = time.monotonic() + 1.0  # it may be starting just now
        while not self._calls.has(SERVICE):
            if time.monotonic() > deadline_s:
                return False
            time.sleep(0.1)
        return True

    def _wait_for_node(self) -> list[str]:
        """asebamedulla asks the robots for their descriptions once a second."""
        deadline_s = time.monotonic() + FIND_S
        while True:
            nodes = [str(name) for name in self._ask("GetNodesList")]
            if self._node in nodes or time.monotonic() > deadline_s:
                return nodes
            time.sleep(0.2)

    def _medulla_arguments(self) -> list[str]:
        """asebamedulla's command line; empty when it is another user's."""
        daemon = "org.freedesktop.DBus"
        try:
            process = int(
                self._calls.call(daemon, "/org/freedesktop/DBus", f"{daemon}.GetConnectionUnixProcessID", "s", SERVICE)
            )
            return Path(f"/proc/{process}/cmdline").read_bytes().decode(errors="replace").split("\0")[:-1]
        except (AgentError, OSError):
            return []

    def _firmware(self) -> Iterator[Finding]:
        variables = {str(name) for name in self._ask("GetVariablesList", self._node)}
        missing = [name for name in NEEDED_VARIABLES if name not in variables]
        if missing:
            said = f"{self._node} has no {', '.join(missing)}: it is no Thymio II, or its firmware is broken"
            yield Finding("firmware", Verdict.FAILED, said, FIRMWARE_MEND)
        elif "_fwversion" in variables:
            version = ".".join(str(int(number)) for number in self._ask("GetVariable", self._node, "_fwversion"))
            yield Finding("firmware", Verdict.OK, f"version {version}")
        else:
            yield Finding("firmware", Verdict.WARNING, "the robot does not tell its version", FIRMWARE_MEND)

    def _sensors(self) -> Finding:
        took_s = []
        readings: list[int] = []
        for _ in range(7):
            asked_s = time.monotonic()
            readings = [int(value) for value in self._ask("GetVariable", self._node, "prox.horizontal")]
            took_s.append(time.monotonic() - asked_s)
        median_s = statistics.median(took_s)
        said = f"proximity {readings}, answered in {median_s * 1000:.0f} ms (median)"
        if median_s > SLOW_ANSWER_S:
            return Finding("sensors", Verdict.WARNING, said, "use the cable instead of the wireless dongle")
        return Finding("sensors", Verdict.OK, said)


def medulla_protocol() -> int:
    """The Aseba protocol version that the installed asebamedulla tells."""
    told = re.search(r"Aseba protocol (\d+)", run("asebamedulla", "--version") or "")
    return int(told[1]) if told else PROTOCOL


def node_protocols(port: int, protocol: int, answer_s: float = ANSWER_S) -> dict[int, int] | None:
    """Aseba protocol version of every robot behind asebamedulla, by its number; None when its port does not answer.

    Both questions are asked: nodes older than protocol 5 know only the second.
    """
    decoder = AsebaDecoder()
    versions: dict[int, int] = {}
    deadline_s = time.monotonic() + answer_s
    try:
        with socket.create_connection(("127.0.0.1", port), answer_s) as connection:
            connection.sendall(bytes(ask_version(LIST_NODES, protocol)) + bytes(ask_version(GET_DESCRIPTION, protocol)))
            while (left_s := deadline_s - time.monotonic()) > 0 and not versions:
                connection.settimeout(left_s)
                data = connection.recv(4096)
                if not data:
                    break
                for message in decoder.receive_data(data):
                    if (version := message.protocol_version) is not None:
                        versions[message.source] = version
    except TimeoutError:
        return versions
    except OSError:
        return None
    return versions


def _explain_absence(nodes: list[str], node: str, port: int, protocol: int) -> Iterator[Finding]:
    versions = node_protocols(port, protocol)
    if versions and not all(OLDEST_PROTOCOL <= version <= protocol for version in versions.values()):
        yield from _protocol(versions, protocol)
        said = "asebamedulla hides the robot, because their Aseba protocols differ"
        yield Finding("node", Verdict.FAILED, said, FIRMWARE_MEND)
    elif nodes:
        yield Finding("node", Verdict.FAILED, f"no {node!r}, but {', '.join(nodes)}", f"--node {nodes[0]}")
    else:
        said = "asebamedulla is there, but no robot answers it"
        mend = f"plug the Thymio in, switch it on, then start asebamedulla again: {_start_medulla()}"
        yield Finding("node", Verdict.FAILED, said, mend)


def _protocol(versions: dict[int, int] | None, protocol: int) -> Iterator[Finding]:
    part = "protocol"
    if versions is None:
        yield Finding(
            part, Verdict.SKIPPED, "asebamedulla's TCP port does not answer; it accepts the robot, which is enough"
        )
    elif not versions:
        yield Finding(
            part, Verdict.SKIPPED, "the robot does not tell its version; asebamedulla accepts it, which is enough"
        )
    for number, version in (versions or {}).items():
        said = f"robot {number} speaks Aseba protocol {version}, asebamedulla {OLDEST_PROTOCOL} to {protocol}"
        if OLDEST_PROTOCOL <= version <= protocol:
            yield Finding(part, Verdict.OK, said)
        else:
            newer = (
                "sudo apt install aseba (a newer one: the robot's firmware is ahead), or put an older firmware on it"
            )
            yield Finding(part, Verdict.FAILED, said, newer if version > protocol else FIRMWARE_MEND)


def _port(arguments: list[str]) -> int:
    """asebamedulla's TCP port, as its command line says."""
    for option, value in itertools.pairwise(arguments):
        if option == "-p" and value.isdecimal() and 1 <= int(value) <= 65535:
            return int(value)
    return MEDULLA_PORT


def _start_medulla() -> str:
    if shutil.which("asebamedulla") is None:
        return "sudo apt install --no-install-recommends aseba"
    if Path.home().joinpath(".config/systemd/user", UNIT).exists():
        return f"systemctl --user restart {UNIT}"
    return 'asebamedulla "ser:device=/dev/ttyACM0" &   (in the same D-Bus session)'
