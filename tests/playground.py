"""A real Thymio II without hardware: Debian's asebaplayground and asebamedulla on a D-Bus session bus of their own."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from robot_agent.playground.programs import PACKAGES
from tests.helpers import ROOT, Program, Programs, free_ports, wait_until

DEBIAN_PYTHON = "/usr/bin/python3"
MODULES = {
    "cv2": "python3-opencv",
    "dbus": "python3-dbus",
    "gi": "python3-gi",
    "msgpack": "python3-msgpack",
    "numpy": "python3-numpy",
    "zmq": "python3-zmq",
}
"""What the agent imports there, and the Debian package that brings it."""
LISTEN, TIME_WAIT = "0A", "06"
"""States of a connection in /proc/net/tcp."""
WORLD = """<!DOCTYPE aseba-playground>
<aseba-playground>
 <color name="white" r="0.9" g="0.9" b="0.9"/>
 <world w="200" h="200" color="white" groundTexture="ground.png"/>
 <wall x="150" y="100" l1="2" l2="60" h="20" color="white"/>
 <robot type="thymio2" x="60" y="100" angle="0" port="{port}" name="thymio-II"/>
</aseba-playground>
"""


def missing_programs() -> list[str]:
    """The Debian packages of the programs behind a playground that this machine has not."""
    return sorted({package for name, package in PACKAGES.items() if shutil.which(name) is None})


def missing_modules() -> list[str]:
    """The Debian packages of what the agent needs in Debian's Python that this machine has not."""
    looks = "import importlib.util as u, sys; print(*[n for n in sys.argv[1:] if u.find_spec(n) is None])"
    try:
        absent = subprocess.run(
            [DEBIAN_PYTHON, "-c", looks, *MODULES], capture_output=True, text=True, check=True
        ).stdout
    except (OSError, subprocess.CalledProcessError):
        return ["python3"]
    return [MODULES[name] for name in absent.split()]


def skip_without(packages: list[str]) -> pytest.MarkDecorator:
    return pytest.mark.skipif(
        bool(packages), reason=f"missing Debian packages: {' '.join(packages)} (scripts/test installs them)"
    )


needs_playground = skip_without(missing_programs())
needs_aseba = skip_without(missing_programs() + missing_modules())


EDGE_CM = 30.0
"""Left of this the floor is black, as the ground sensors see a table's edge."""


class Playground:
    """One simulated Thymio, 60 cm from the left side, looking at a wall 90 cm ahead. `medulla`: with asebamedulla;
    without it the robot's port, `aseba_port`, is free for another client."""

    def __init__(self, programs: Programs, folder: Path, *, medulla: bool = True) -> None:
        self._programs = programs
        self.aseba_port = free_ports()
        (folder / "world.playground").write_text(WORLD.format(port=self.aseba_port))
        floor = np.full((200, 200, 3), 255, np.uint8)
        floor[:, : round(EDGE_CM)] = 0
        assert cv2.imwrite(str(folder / "ground.png"), floor)
        bus = programs.start("dbus-daemon", "--session", "--nofork", "--print-address")
        self.environment = {"DBUS_SESSION_BUS_ADDRESS": wait_until(lambda: bus.stdout.strip(), 5.0, "a session bus")}
        screen = programs.start("Xvfb", "-displayfd", "1", "-screen", "0", "320x240x24", "+extension", "GLX")
        display = ":" + wait_until(lambda: screen.stdout.strip(), 10.0, "a display")
        programs.start(
            "asebaplayground",
            str(folder / "world.playground"),
            DISPLAY=display,
            LIBGL_ALWAYS_SOFTWARE="1",
            **self.environment,
        )
        if medulla:
            self.medulla = self.start_medulla()
        self._probe = programs.start(
            DEBIAN_PYTHON, str(ROOT / "tests/aseba_probe.py"), stdin=subprocess.PIPE, **self.environment
        )
        self.wait_for(lambda look: "left" in look or not medulla, "the robot", timeout_s=20.0)

    def start_medulla(self) -> Program:
        """asebamedulla, once the playground awaits a client: it looks only once."""
        wait_until(lambda: awaits_client(self.aseba_port), 20.0, "a playground that awaits a client")
        target = f"tcp:localhost;{self.aseba_port}"
        return self._programs.start("asebamedulla", "-p", str(self.aseba_port + 1), target, **self.environment)

    def agent(self, port: int, *options: str, robot: str = "thymio", **environment: str) -> Program:
        """The agent on Debian's own Python and packages, driving this robot."""
        arguments = ("-m", "robot_agent", "--robot", robot, "--port", str(port), *options)
        return self._programs.start(DEBIAN_PYTHON, *arguments, **(self.environment | environment))

    def put(self, x_cm: float, y_cm: float, angle_rad: float) -> None:
        """Carry the robot there."""
        stdin = self._probe.process.stdin
        assert stdin is not None
        stdin.write(f"{x_cm} {y_cm} {angle_rad}\n".encode())
        stdin.flush()
        put_s = time.monotonic()
        near = lambda look: abs(look["x"] - x_cm) < 2 and abs(look["y"] - y_cm) < 2  # noqa: E731
        self.wait_for(near, "the robot put there", since_s=put_s)

    def looks(self, since_s: float = 0.0) -> list[dict[str, Any]]:
        """All that the probe saw since then."""
        lines = self._probe.stdout.splitlines(keepends=True)
        return [look for line in lines if line.endswith("\n") and (look := json.loads(line))["time_s"] >= since_s]

    def wait_for(
        self, condition: Callable[[dict[str, Any]], bool], what: str, timeout_s: float = 5.0, since_s: float = 0.0
    ) -> dict[str, Any]:
        """The first look since then that meets the condition."""

        def found() -> dict[str, Any] | None:
            return next((look for look in self.looks(since_s) if condition(look)), None)

        return wait_until(found, timeout_s, what)


def agent_with_playground(programs: Programs, port: int, folder: Path, *options: str) -> Program:
    """An agent that serves already, behind a leader in a playground of its own; its temporary files are in `folder`
    (a short path: a socket's may have 107 characters)."""
    agent = programs.start(
        *(sys.executable, "-m", "robot_agent", "--port", str(port), "--robot", "playground", "--seed", "3"),
        *("--speed-scale", "4"),
        *options,
        TMPDIR=str(folder),
    )
    agent.says("serving robot playground", 30.0)
    return agent


def awaits_client(port: int) -> bool:
    """Whether asebaplayground listens there and has no client. A connection to find out would count as a client.

    A new client in the same simulation step in which the old one goes is its undoing: Aseba's SimpleDashelConnection
    keeps the old client's stream for closing although its hub has freed it already (a core file shows closeOldStreams
    reading it), and the playground ends by SIGSEGV, or does not, as the memory may be. So the next client comes when
    the playground has let go of the last.
    """
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    states = {words[3] for words in lines if words[1].endswith(f":{port:04X}")}
    return LISTEN in states and states <= {LISTEN, TIME_WAIT}
