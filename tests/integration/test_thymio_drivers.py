"""Both drivers of the Thymio II with real programs and real messages; faked is the robot alone, at its Aseba port.

The robot is tests/aseba_node.py: its buttons can be pressed, it can be lifted, put at an edge and unplugged, which
asebaplayground's cannot. thymiodirect talks to it over TCP and over a serial line (a pseudo terminal); asebamedulla
puts it on a real D-Bus.
"""

from __future__ import annotations

import contextlib
import logging
import os
import select
import shutil
import socket
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from protocol import Request
from robot_agent.errors import AgentError
from robot_agent.robots.thymio_node import COLOURS, ThymioNode
from robot_agent.robots.thymio_serial import SerialThymioRobot
from tests.aseba_node import AsebaNode
from tests.helpers import Operator, Program, Programs, RawStation, TelemetryLog, free_ports, wait_until

pytestmark = pytest.mark.timed

FRAME_BYTES = 160 * 120
MISSING = [name for name in ("asebamedulla", "dbus-daemon") if shutil.which(name) is None]
needs_medulla = pytest.mark.skipif(bool(MISSING), reason=f"not installed: {MISSING}; scripts/setup installs them")


class Bench:
    """A robot and a driver; `mend` does what a person does when the robot was plugged in again."""

    def __init__(self, node: AsebaNode, connect: Callable[..., ThymioNode], mend: Callable[[], object]) -> None:
        self.node, self.connect, self.mend = node, connect, mend


class SerialLine:
    """A pseudo terminal that leads to the robot's TCP port, as the cable leads to the robot."""

    def __init__(self, port: int) -> None:
        self._ours, theirs = os.openpty()
        tty.setraw(theirs)
        self.path = os.ttyname(theirs)
        self._theirs = theirs  # kept open: the line stands while nobody reads it
        self._robot = socket.create_connection(("127.0.0.1", port))
        threading.Thread(target=self._carry, daemon=True).start()

    def _carry(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                readable, _, _ = select.select([self._ours, self._robot], [], [])
                if self._ours in readable:
                    self._robot.sendall(os.read(self._ours, 4096))
                if self._robot in readable and not self._write(self._robot.recv(4096)):
                    return

    def _write(self, data: bytes) -> bool:
        while data:
            data = data[os.write(self._ours, data) :]
        return True

    def close(self) -> None:
        for descriptor in (self._ours, self._theirs):
            with contextlib.suppress(OSError):
                os.close(descriptor)
        self._robot.close()


@pytest.fixture
def node() -> Iterator[AsebaNode]:
    robot = AsebaNode()
    yield robot
    robot.close()


@pytest.fixture
def medulla(programs: Programs, node: AsebaNode) -> Callable[[], str]:
    """Starts asebamedulla, again when it runs already; the bus's address."""
    bus = programs.start("dbus-daemon", "--session", "--nofork", "--print-address")
    address = wait_until(lambda: bus.stdout.strip(), 5.0, "a session bus")
    running: list[Program] = []

    def start() -> str:
        while running:
            running.pop().kill()
        target = f"tcp:localhost;{node.port}"
        started = programs.start("asebamedulla", "-p", str(free_ports()), target, DBUS_SESSION_BUS_ADDRESS=address)
        running.append(started)
        return address

    return start


@pytest.fixture(params=["tcp", pytest.param("dbus", marks=needs_medulla)])
def bench(request: pytest.FixtureRequest, node: AsebaNode) -> Iterator[Bench]:
    """Each way to a robot that is the same; drivers that a test has made are closed."""
    made: list[ThymioNode] = []
    if request.param == "tcp":
        make: Callable[..., ThymioNode] = lambda **options: SerialThymioRobot(  # noqa: E731
            device=f"tcp:127.0.0.1:{node.port}", **options
        )
        mend: Callable[[], object] = lambda: None  # noqa: E731
    else:
        pytest.importorskip("dbus")
        from robot_agent.robots.thymio import ThymioRobot

        start = request.getfixturevalue("medulla")
        bus = start()
        make, mend = (lambda **options: ThymioRobot(bus=bus, **options)), start

    def connect(**options: float) -> ThymioNode:
        made.append(make(**options))
        return made[-1]

    yield Bench(node, connect, mend)
    for robot in made:
        robot.close()


def test_it_stands_first_then_obeys_and_stands_at_the_end(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    """A robot that drove when the driver came is stopped; both targets follow, trimmed; the end is confirmed."""
    bench.node.set("motor.left.target", 120)
    bench.node.set("motor.right.target", 130)
    robot = bench.connect(trim=1.25)
    wait_until(lambda: bench.node.targets == (0, 0), 1.0, "a robot that stands first")
    robot.set_wheels(100, -100)
    wait_until(lambda: bench.node.targets == (100, -80), 1.0, "both targets")
    bench.node.set("motor.left.speed", 98)
    bench.node.set("motor.right.speed", -80)
    wait_until(lambda: robot.state().wheels_measured == (98, -100), 2.0, "measured speeds, in the units asked in")
    robot.close()
    assert bench.node.targets == (0, 0)
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]


def test_the_newest_wheels_win_and_both_are_written(bench: Bench) -> None:
    """Two hundred changes at once: pairs arrive whole and in order, fewer than there were, and the last is the last."""
    robot = bench.connect()
    wait_until(lambda: len(bench.node.writes) >= 2, 1.0, "the first stop, of both")
    bench.node.writes.clear()
    for speed in range(1, 201):
        robot.set_wheels(speed, -speed)
    wait_until(lambda: bench.node.targets == (200, -200), 2.0, "the newest")
    wheels = [(name, values[0]) for _, name, values in bench.node.writes if name.endswith("target")]
    lefts = [value for name, value in wheels if name == "motor.left.target"]
    rights = [value for name, value in wheels if name == "motor.right.target"]
    assert lefts == [-value for value in rights] == sorted(lefts)
    assert len(lefts) < 100, "it waits for the robot's answers"


def test_what_the_robot_senses_arrives(bench: Bench) -> None:
    """An edge, a tilt, the centre button, an obstacle, the battery: as the agent's safety needs them."""
    node = bench.node
    node.set("_vbat", 775, 776)
    robot = bench.connect()
    wait_until(lambda: robot.state().acceleration == (0, 0, 22) and robot.state().ground == (900, 900), 3.0, "at rest")
    assert robot.state().problem == "" and not robot.state().button
    node.set("prox.ground.delta", 15, 880)
    node.set("acc", 16, -3, 15)
    node.set("button.center", 1)
    node.set("prox.horizontal", 0, 0, 2411, 0, 0, 0, 7)
    wait_until(lambda: robot.state().ground == (15, 880), 2.0, "the edge")
    wait_until(lambda: robot.state().acceleration == (16, -3, 15), 2.0, "the tilt")
    wait_until(lambda: robot.state().button, 2.0, "the button")
    assert robot.state().proximity == (0, 0, 2411, 0, 0, 0, 7)
    wait_until(lambda: abs((robot.state().battery_v or 0.0) - 3.9) < 0.01, 1.0, "the battery")


def test_the_lights_tell(bench: Bench) -> None:
    """Firmware with lights as variables is lit; at the end it is dark."""
    robot = bench.connect()
    for what, colour in COLOURS.items():
        robot.show(what)
        wait_until(lambda colour=colour: bench.node.get("leds.top") == list(colour), 1.0, f"{what} shown")
    robot.close()
    wait_until(lambda: bench.node.get("leds.top") == [0, 0, 0], 1.0, "dark")


def test_a_write_that_got_lost_is_written_again(bench: Bench) -> None:
    """Whatever sets the targets besides, or a stop that the radio swallowed: the driver's targets return."""
    robot = bench.connect()
    robot.set_wheels(30, 40)
    wait_until(lambda: bench.node.targets == (30, 40), 1.0, "both targets")
    for variable in ("motor.left.target", "motor.right.target"):
        bench.node.set(variable, 300)
        wait_until(lambda: bench.node.targets == (30, 40), 2.0, f"{variable} written again")


def test_it_is_unplugged_and_plugged_in_again(bench: Bench) -> None:
    """Its wheels are unknown; back again it stands, then obeys. Over D-Bus asebamedulla must be started anew."""
    robot = bench.connect()
    robot.set_wheels(50, 50)
    wait_until(lambda: bench.node.targets == (50, 50), 1.0, "driving")
    bench.node.unplug()
    wait_until(lambda: "its wheels are unknown" in robot.state().problem, 2.0, "a problem")
    assert robot.state().wheels_measured is None or "asebamedulla" in robot.state().problem
    robot.set_wheels(0, 0)  # as the supervisor does
    bench.node.plug()
    bench.mend()
    wait_until(lambda: not robot.state().problem, 3.0, "the robot's return")
    assert bench.node.targets == (0, 0)
    robot.set_wheels(20, 20)
    wait_until(lambda: bench.node.targets == (20, 20), 1.0, "obeying")


def test_a_robot_that_falls_silent_is_told_and_not_confirmed(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    """It is there and does not answer: a problem, and at the end an error instead of a confirmation."""
    robot = bench.connect()
    robot.set_wheels(50, 50)
    bench.node.silent = True
    wait_until(lambda: "its wheels are unknown" in robot.state().problem, 2.5, "a problem")
    robot.close()
    assert "did not confirm that its wheels stand" in caplog.text


def test_over_a_serial_line(node: AsebaNode) -> None:
    """pyserial on a pseudo terminal: found, driven; the line breaks and is told."""
    line = SerialLine(node.port)
    robot = SerialThymioRobot(device=line.path)
    try:
        robot.set_wheels(70, -70)
        wait_until(lambda: node.targets == (70, -70), 1.0, "both targets")
        node.set("button.center", 1)
        wait_until(lambda: robot.state().button, 1.0, "the button")
        line.close()
        wait_until(lambda: line.path in robot.state().problem, 3.0, "what became of the line")
    finally:
        robot.close()
        line.close()


def test_another_node_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """There is a robot, but not the one asked for."""
    monkeypatch.setattr("robot_agent.robots.thymio_node.FIND_S", 1.5)
    monkeypatch.setattr("robot_agent.robots.thymio_serial.GREET_S", 0.5)
    robot = AsebaNode("e-puck")
    try:
        with pytest.raises(AgentError, match=r"no node 'thymio-II' answers on .* \(there is e-puck; --node\)"):
            SerialThymioRobot(device=f"tcp:127.0.0.1:{robot.port}")
    finally:
        robot.close()


@pytest.mark.parametrize(
    ("device", "said"),
    [
        (None, r"there is no serial port /nowhere/tty\*"),
        ("/dev/nosuch", "the serial port /dev/nosuch cannot be opened"),
        ("/dev/null", "the serial port /dev/null cannot be opened"),
        ("tcp:127.0.0.1:1", "127.0.0.1:1 does not answer"),
    ],
)
def test_no_port_is_an_error_in_words(device, said, monkeypatch) -> None:
    monkeypatch.setattr("robot_agent.robots.thymio_node.FIND_S", 0.6)
    monkeypatch.setattr("robot_agent.robots.aseba_wire.SERIAL_PORTS", "/nowhere/tty*")
    with pytest.raises(AgentError, match=said):
        SerialThymioRobot(device=device)


@pytest.mark.parametrize(
    "sent",
    [b"\x00" * 64, b"\xff" * 64, b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\x06\x00\x01\x00\x00\x90"],
    ids=["zeros", "ones", "a web server", "half a message"],
)
def test_something_else_at_the_port_is_told(sent: bytes, monkeypatch, capfd) -> None:
    """Not Aseba's protocol, or a message that breaks off: a sentence, never a traceback."""
    monkeypatch.setattr("robot_agent.robots.thymio_node.FIND_S", 1.5)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    client, _ = server.accept()
                    client.sendall(sent)
                    clients.append(client)

        clients: list[socket.socket] = []
        threading.Thread(target=serve, daemon=True).start()
        with pytest.raises(AgentError, match=r"not Aseba's protocol|broke off"):
            SerialThymioRobot(device=f"tcp:127.0.0.1:{server.getsockname()[1]}")
        for client in clients:
            client.close()
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize(("module", "extra"), [("thymiodirect", "thymio-serial"), ("serial", "python3-serial")])
def test_a_missing_package_is_named(module: str, extra: str, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(AgentError, match=extra):
        SerialThymioRobot(device="/dev/ttyACM7")


def test_agent_and_station_tell_by_the_robot_s_lights(
    programs: Programs, port: int, pictures: Path, node: AsebaNode, operator: Operator
) -> None:
    """Red without a station, green while it tracks; the centre button stops and releases, an edge limits."""
    agent = programs.start(
        *(sys.executable, "-m", "robot_agent", "--robot", "thymio-serial", "--device", f"tcp:127.0.0.1:{node.port}"),
        *("--camera", "replay", "--source", str(pictures), "--port", str(port), "--trim", "0.8"),
    )
    agent.says("serving robot thymio-serial", 20.0)
    telemetry = TelemetryLog(port).wait_until_live()
    try:
        wait_until(lambda: node.get("leds.top") == [32, 0, 0], 2.0, "red")
        assert "show" in operator.hello().capabilities
        refused = operator.ask(Request(action="show", text="purple"))
        assert not refused.ok and "tracking, lost, idle, not 'purple'" in refused.error
        station = programs.station(port, "--behaviour", "follow")
        wait_until(lambda: node.get("leds.top") == [0, 32, 0], 15.0, "green")
        node.set("button.center", 1)
        told = telemetry.wait_for(lambda message: "the robot's button" in message.reason, 2.0, what="the stop")
        assert told.safety == "stopped" and told.battery_v is not None
        wait_until(lambda: node.get("leds.top") == [32, 0, 0], 1.0, "red again")
        node.set("button.center", 0)
        time.sleep(0.3)
        node.set("button.center", 1)
        telemetry.wait_for(lambda message: message.safety == "ok", 2.0, since_s=told.monotonic_s, what="the release")
        wait_until(lambda: node.get("leds.top") == [0, 32, 0], 1.0, "green again")
        station.kill()
        wait_until(lambda: node.get("leds.top") == [32, 0, 0], 2.0, "red without a station")
        wait_until(lambda: telemetry.last is not None and telemetry.last.station is None, 2.0, "a robot that is free")
        with RawStation(port, FRAME_BYTES) as raw:
            node.set("prox.ground.delta", 20, 900)
            for _ in range(30):
                raw.read_frame()
                raw.send(50, 50)
            edge = telemetry.wait_for(lambda message: message.reason == "an edge in front", 2.0, what="the edge")
            assert edge.wheels_asked == (0, 0)
            assert node.get("leds.top") == [0, 0, 32], "a station that says nothing is idle"
    finally:
        telemetry.close()
    agent.process.terminate()
    assert agent.exit_code() == 0 and "did not confirm" not in agent.stderr
    assert node.targets == (0, 0) and node.get("leds.top") == [0, 0, 0]
