"""robot-agent doctor on Debian's own packages, with the real asebamedulla and asebaplayground: says what is well, finds
what is not, and recovers a known wheel trim without ever leaving the wheels turning."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.aseba_node import AsebaNode
from tests.helpers import LOOPBACK, Program, Programs, free_ports, wait_until
from tests.playground import DEBIAN_PYTHON, Playground, needs_aseba

pytestmark = needs_aseba


def doctor(programs: Programs, *options: str, stdin: int = subprocess.DEVNULL, **environment: str) -> Program:
    program = (DEBIAN_PYTHON, "-m", "robot_agent", "doctor", "--port", str(free_ports()))
    return programs.start(*program, *options, stdin=stdin, **environment)


def session_bus(programs: Programs) -> dict[str, str]:
    """The environment with a D-Bus session bus on which nobody is yet."""
    daemon = programs.start("dbus-daemon", "--session", "--nofork", "--print-address")
    return {"DBUS_SESSION_BUS_ADDRESS": wait_until(lambda: daemon.stdout.strip(), 5.0, "a session bus")}


@pytest.fixture
def replay(pictures: Path) -> tuple[str, ...]:
    return ("--robot", "thymio", "--camera", "replay", "--source", str(pictures))


def test_without_a_bus_and_without_asebamedulla_it_names_what_to_start(
    programs: Programs, replay: tuple[str, ...]
) -> None:
    without_bus = doctor(programs, *replay, DBUS_SESSION_BUS_ADDRESS="unix:path=/nowhere")
    without_medulla = doctor(programs, *replay, **session_bus(programs))
    assert without_bus.exit_code() == without_medulla.exit_code() == 1
    assert "FAIL  bus: There is no D-Bus session bus here" in without_bus.stdout
    assert "dbus-run-session" in without_bus.stdout
    assert "FAIL  service: asebamedulla is not on the bus" in without_medulla.stdout
    assert "-> asebamedulla" in without_medulla.stdout


def test_robots_that_asebamedulla_does_not_show(programs: Programs, replay: tuple[str, ...]) -> None:
    """The thesis's stumbling block: asebamedulla sees a robot of another protocol version and hides it, without a word
    on the bus. The doctor tells that apart from no robot at all. (Examined at the same time: each waits a while.)"""
    newer, older = AsebaNode(protocol=6), AsebaNode(protocol=3)
    examined = {}
    for name, target in (("newer", newer), ("older", older), ("none", None)):
        bus = session_bus(programs)
        targets = () if target is None else (f"tcp:{LOOPBACK};{target.port}",)
        programs.start("asebamedulla", "-p", str(free_ports()), *targets, **bus)
        examined[name] = doctor(programs, *replay, **bus)
    assert [program.exit_code(30.0) for program in examined.values()] == [1, 1, 1]
    newer.close()
    older.close()
    for name, version, mend in (("newer", 6, "apt install aseba"), ("older", 3, "Thymio Suite")):
        said = examined[name].stdout
        assert f"FAIL  protocol: robot 1 speaks Aseba protocol {version}, asebamedulla 4 to 5" in said
        assert "FAIL  node: asebamedulla hides the robot" in said
        assert mend in said.partition("FAIL  protocol")[2].splitlines()[1]
    assert "no robot answers it" in examined["none"].stdout
    assert "FAIL  protocol" not in examined["none"].stdout


def test_a_robot_on_a_serial_line_or_tcp(programs: Programs, pictures: Path) -> None:
    """Through thymiodirect, without asebamedulla; and one that is not there."""
    pytest.importorskip("thymiodirect")
    robot = AsebaNode()
    options = ("--camera", "replay", "--source", str(pictures), "--robot", "thymio-serial", "--device")
    command = (sys.executable, "-m", "robot_agent", "doctor", "--port", str(free_ports()))
    there = programs.start(*command, *options, f"tcp:{LOOPBACK}:{robot.port}")
    assert there.exit_code(20.0) == 0, there.stdout
    robot.close()
    gone = programs.start(*command, *options, f"tcp:{LOOPBACK}:{robot.port}")
    assert "  OK  robot: thymio-serial answers, proximity [0, 0, 0, 0, 0, 0, 0]" in there.stdout
    assert gone.exit_code(30.0) == 1
    assert "FAIL  robot: " in gone.stdout


@pytest.fixture(scope="module")
def playground(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Playground]:
    programs = Programs()
    yield Playground(programs, tmp_path_factory.mktemp("playground"))
    programs.close()


def test_a_robot_that_is_well(
    playground: Playground, programs: Programs, replay: tuple[str, ...], tmp_path: Path
) -> None:
    """Everything is OK but the cable, which a playground has not; the report names no other machine. With a wrong
    --node the right one is told."""
    report = tmp_path / "report.txt"
    examined = doctor(programs, *replay, "--report", str(report), **playground.environment)
    misnamed = doctor(programs, *replay, "--node", "thymio-III", **playground.environment)
    assert examined.exit_code(20.0) == 0, examined.stdout
    text = examined.stdout
    for part in (
        "packages",
        "ports",
        "camera",
        "bus",
        "service",
        "node",
        "firmware",
        "protocol",
        "sensors",
        "loopback",
    ):
        assert f"  OK  {part}: " in text, text
    assert "firmware: version 11.0" in text
    assert "robot 1 speaks Aseba protocol 5, asebamedulla 4 to 5" in text
    assert "gives 160x120 at 30.0 pictures a second" in text
    assert "ready: " in text.splitlines()[-2]
    assert "tcp:localhost" in text
    assert "sensors: " in report.read_text()
    assert "localhost" not in report.read_text()
    assert misnamed.exit_code(20.0) == 1
    assert "FAIL  node: no 'thymio-III', but thymio-II" in misnamed.stdout
    assert "-> --node thymio-II" in misnamed.stdout


def answer(program: Program, question: str, text: str) -> None:
    wait_until(lambda: question in program.stdout or not program.alive, 15.0, question)
    stdin = program.process.stdin
    assert stdin is not None
    stdin.write(f"{text}\n".encode())
    stdin.flush()


def test_a_known_wrong_trim_is_recovered(playground: Playground, programs: Programs, tmp_path: Path) -> None:
    """The playground's wheels are equal, so the true trim is 1; with 0.95 stored the robot veers to the left. The
    person with the ruler is the playground's own pose."""
    stored = tmp_path / "zservo" / "robot.json"
    stored.parent.mkdir()
    stored.write_text('{"trim": 0.95}')
    playground.put(30.0, 100.0, 0.0)
    options = ("--robot", "thymio", "--calibrate-wheels", "--run-speed", "250", "--run-s", "5")
    environment = playground.environment | {"XDG_CONFIG_HOME": str(tmp_path)}
    calibrating = doctor(programs, *options, stdin=subprocess.PIPE, **environment)
    answer(calibrating, "Drive now? [y/N]", "y")
    wait_until(lambda: "How many cm did it come" in calibrating.stdout, 20.0, "the end of the run")
    asked_s = time.monotonic()
    stood = playground.wait_for(lambda look: look.get("left") == look.get("right") == 0, "a stop", since_s=asked_s)
    ran_cm, veered_cm = stood["x"] - 30.0, stood["y"] - 100.0
    assert ran_cm > 35.0
    assert veered_cm > 3.0
    answer(calibrating, "along the line?", f"{ran_cm:.1f}")
    answer(calibrating, "right negative)?", f"{veered_cm:.1f}")
    assert calibrating.exit_code() == 0, calibrating.stderr
    assert math.isclose(json.loads(stored.read_text())["trim"], 1.0, abs_tol=0.006)
    assert "did not confirm" not in calibrating.stderr


def test_wheels_stop_on_ctrl_c_and_nothing_is_stored(
    playground: Playground, programs: Programs, tmp_path: Path
) -> None:
    playground.put(30.0, 100.0, 0.0)
    options = ("--robot", "thymio", "--calibrate-wheels", "--yes", "--run-s", "20")
    calibrating = doctor(programs, *options, **playground.environment, XDG_CONFIG_HOME=str(tmp_path))
    playground.wait_for(lambda look: look.get("left") == look.get("right") == 200, "a robot that drives", 10.0)
    asked_s = time.monotonic()
    calibrating.signal(signal.SIGINT)
    playground.wait_for(lambda look: look.get("left") == look.get("right") == 0, "a stop", 1.0, asked_s)
    assert calibrating.exit_code() == 1
    assert "Stopped by hand; nothing was stored." in calibrating.stderr
    assert "did not confirm" not in calibrating.stderr
    assert not list(tmp_path.rglob("robot.json"))


def test_wheels_stop_before_a_wall(playground: Playground, programs: Programs, tmp_path: Path) -> None:
    playground.put(128.0, 100.0, 0.0)
    options = ("--robot", "thymio", "--calibrate-wheels", "--yes", "--run-s", "20")
    calibrating = doctor(programs, *options, **playground.environment, XDG_CONFIG_HOME=str(tmp_path))
    assert calibrating.exit_code() == 1
    assert "obstacle in front" in calibrating.stderr
    ended_s = time.monotonic()
    stood = playground.wait_for(lambda look: look.get("left") == look.get("right") == 0, "a stop", since_s=ended_s)
    assert max(stood["proximity"]) < 4400, "it touched the wall"
