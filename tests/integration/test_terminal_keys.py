"""A person at a terminal: keys drive the robot, and the terminal is given back as it was."""

from __future__ import annotations

import os
import pty
import signal
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.helpers import Program, Programs, TelemetryLog, driving

pytestmark = pytest.mark.timed  # a key counts for a moment only


class Terminal:
    """A pseudo terminal: `type` is the keyboard, `user_end` is what a program gets as its standard input."""

    def __init__(self) -> None:
        self._keyboard, self.user_end = pty.openpty()

    def type(self, keys: str) -> None:
        os.write(self._keyboard, keys.encode())

    def settings(self) -> list:
        return termios.tcgetattr(self.user_end)

    def close(self) -> None:
        os.close(self._keyboard)
        os.close(self.user_end)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    opened = Terminal()
    yield opened
    opened.close()


def teleop(
    programs: Programs, port: int, pictures: Path, listen: Callable[[], TelemetryLog], terminal: Terminal
) -> tuple[Program, TelemetryLog]:
    """A station that takes keys, when it takes them."""
    programs.replay(port, pictures)
    telemetry = listen()
    station = programs.station(port, "--behaviour", "teleop", stdin=terminal.user_end)
    telemetry.wait_for(lambda message: message.safety == "ok", 20.0, what="commands that come")
    return station, telemetry


def test_keys(
    programs: Programs, port: int, pictures: Path, listen: Callable[[], TelemetryLog], terminal: Terminal
) -> None:
    """w drives for a while, space stops for good, r releases, q ends with exit code 0; the terminal is restored."""
    before = terminal.settings()
    station, telemetry = teleop(programs, port, pictures, listen, terminal)
    assert terminal.settings() != before, "keys are read as they are pressed"

    terminal.type("w")
    forwards = telemetry.wait_for(lambda message: min(message.wheels_asked) > 0, 3.0, what="wheels that turn forwards")
    telemetry.wait_for(
        lambda message: not driving(message), 3.0, since_s=forwards.monotonic_s, what="wheels that stop with the key"
    )
    terminal.type("\x1b[D")
    telemetry.wait_for(
        lambda message: message.wheels_asked[0] < 0 < message.wheels_asked[1],
        3.0,
        since_s=forwards.monotonic_s,
        what="wheels that turn left",
    )
    terminal.type("w")
    terminal.type(" ")
    stopped = telemetry.wait_for(lambda message: message.reason.startswith("emergency stop"), 3.0, what="the stop")
    terminal.type("w")
    time.sleep(0.4)
    later = [message for message in telemetry.messages if message.monotonic_s >= stopped.monotonic_s]
    assert len(later) > 5 and not any(driving(message) for message in later)
    terminal.type("r")
    telemetry.wait_for(
        lambda message: message.safety == "ok", 3.0, since_s=later[-1].monotonic_s, what="the stop released"
    )
    terminal.type("w")
    telemetry.wait_for(driving, 3.0, since_s=later[-1].monotonic_s, what="wheels that turn again")

    terminal.type("q")
    assert station.exit_code(5) == 0, station.stderr
    assert terminal.settings() == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_terminal_is_restored_after_a_signal(
    programs: Programs,
    port: int,
    pictures: Path,
    listen: Callable[[], TelemetryLog],
    terminal: Terminal,
    number: signal.Signals,
) -> None:
    """Whatever ends the station, the terminal echoes again."""
    before = terminal.settings()
    station, _ = teleop(programs, port, pictures, listen, terminal)

    station.signal(number)
    assert station.exit_code(5) == 0, station.stderr
    assert terminal.settings() == before


def test_keys_before_there_is_a_robot(programs: Programs, port: int, terminal: Terminal) -> None:
    """q ends a station that still waits for its robot."""
    station = programs.station(port, "--behaviour", "teleop", stdin=terminal.user_end)
    station.says("waiting for the robot")

    terminal.type("q")
    assert station.exit_code(5) == 1
    assert "No frame came" in station.stderr
