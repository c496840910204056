"""The programs behind a playground: a display nobody sees, a D-Bus bus of its own, asebaplayground and asebamedulla.

Each is started through `setpriv --pdeathsig`: the kernel ends it when this process ends, even by SIGKILL. On an orderly
end they are ended by their process ids, last started first, and waited for. Their files lie in a temporary folder, so
nothing is read from or left in the user's home.
"""

from __future__ import annotations

import os
import select
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from robot_agent.errors import AgentError
from robot_agent.ports import free_ports
from robot_agent.robots.aseba import BusCalls

PACKAGES = {
    "Xvfb": "xvfb",
    "dbus-daemon": "dbus",
    "asebaplayground": "aseba",
    "asebamedulla": "aseba",
    "setpriv": "util-linux",
}
"""Program and the Debian package that brings it."""
PLAYGROUND_SERVICE = "ch.epfl.mobots.AsebaPlayground"
SCREEN = "320x240x24"
"""The playground draws itself without a graphics card: the smaller, the cheaper."""
START_S = 20.0
END_S = 2.0

_BUS_CONFIG = """<!DOCTYPE busconfig PUBLIC "-//freedesktop//DTD D-BUS Bus Configuration 1.0//EN"
 "http://www.freedesktop.org/standards/dbus/1.0/busconfig.dtd">
<busconfig><type>session</type><keep_umask/><listen>unix:path={socket}</listen><auth>EXTERNAL</auth>
<policy context="default"><allow send_destination="*" eavesdrop="true"/><allow eavesdrop="true"/><allow own="*"/>
</policy></busconfig>
"""
"""A session bus that starts no services: whatever is on it was started here."""


class Programs:
    """Running from construction to `close`. Raises AgentError when a program is missing or does not come up."""

    def __init__(self, describe: Callable[[int, int], str]) -> None:
        """`describe`: the playground file's text, given the TCP ports of the follower and the leader."""
        check_installed()
        with ExitStack() as opened:
            self._folder = Path(tempfile.mkdtemp(prefix="zservo-playground-"))
            opened.callback(shutil.rmtree, self._folder, ignore_errors=True)
            self._running: dict[str, subprocess.Popen[bytes]] = {}
            opened.callback(self._end_all)
            follower_port, leader_port, medulla_port = (base := free_ports(3)), base + 1, base + 2
            self.bus = f"unix:path={self._folder / 'bus'}"
            """The address of the bus that they are on."""
            self._environment = os.environ | {
                "DBUS_SESSION_BUS_ADDRESS": self.bus,
                "LIBGL_ALWAYS_SOFTWARE": "1",
                "HOME": str(self._folder),
                "XDG_DATA_HOME": str(self._folder),
                "XDG_RUNTIME_DIR": str(self._folder),
                "QT_QPA_PLATFORM": "xcb",
            }
            self._start_bus()
            self._start_display()
            described = self._folder / "world.playground"
            described.write_text(describe(follower_port, leader_port), encoding="utf-8")
            self._start("asebaplayground", str(described))
            self._wait("asebaplayground", self._playground_answers)
            self._start_medulla(medulla_port, follower_port)
            self.close = opened.pop_all().close

    def why_ended(self, name: str, within_s: float = 0.0) -> str | None:
        """What a program said last, if it has ended, or ends within this time; None while it runs."""
        try:
            code = self._running[name].wait(within_s)
        except subprocess.TimeoutExpired:
            return None
        said = self._log(name).read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return f"{name} has ended with exit code {code}" + (f": {said[-1]}" if said else "")

    def _start_bus(self) -> None:
        config = self._folder / "bus.conf"
        config.write_text(_BUS_CONFIG.format(socket=self._folder / "bus"), encoding="utf-8")
        self._start("dbus-daemon", f"--config-file={config}", "--nofork", "--nopidfile")
        self._wait("dbus-daemon", (self._folder / "bus").exists)

    def _start_display(self) -> None:
        """Xvfb finds a free display by itself and tells which."""
        readable, writable = os.pipe()
        try:
            # fmt: off
            self._start("Xvfb", "-displayfd", str(writable), "-screen", "0", SCREEN, "+extension", "GLX",
                        "-nolisten", "tcp", "-noreset", pass_fd=writable)
            # fmt: on
            self._wait("Xvfb", lambda: bool(select.select([readable], [], [], 0)[0]))
            self._environment["DISPLAY"] = ":" + os.read(readable, 16).decode().strip()
        finally:
            os.close(readable)
            os.close(writable)

    def _start_medulla(self, port: int, follower_port: int) -> None:
        """asebamedulla talks through a connection that is made for it, because its own would wait with each command
        until the playground has acknowledged the question before (Nagle's algorithm): a simulation step more."""
        with socket.socket() as connection:
            self._wait("asebaplayground", lambda: connection.connect_ex(("127.0.0.1", follower_port)) == 0)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            target = f"tcp:localhost;{follower_port};sock={connection.fileno()}"
            # Without a port of its own medulla would take the playground's.
            self._start("asebamedulla", "-p", str(port), target, pass_fd=connection.fileno())

    def _playground_answers(self) -> bool:
        bus = BusCalls(self.bus)
        try:
            return bus.has(PLAYGROUND_SERVICE)
        finally:
            bus.close()

    def _start(self, name: str, *arguments: str, pass_fd: int | None = None) -> None:
        # Xvfb ends tidily when asked; the others may be busy and hold nothing worth saving.
        death = "TERM" if name == "Xvfb" else "KILL"
        with self._log(name).open("wb") as log:
            self._running[name] = subprocess.Popen(
                ["setpriv", "--pdeathsig", death, "--", name, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
                cwd=self._folder,
                pass_fds=() if pass_fd is None else (pass_fd,),
                start_new_session=True,  # a Ctrl-C is for the agent: it ends them after it has stopped the wheels
            )

    def _wait(self, name: str, is_there: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + START_S
        while not is_there():
            if why := self.why_ended(name):
                raise AgentError(f"The playground did not start: {why}.")
            if time.monotonic() > deadline_s:
                raise AgentError(f"The playground did not start: {name} does not come up within {START_S:.0f} s.")
            time.sleep(0.02)

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"

    def _end_all(self) -> None:
        for process in reversed(self._running.values()):
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def check_installed() -> None:
    """Raises AgentError that names the Debian packages of what is missing."""
    missing = [name for name in PACKAGES if shutil.which(name) is None]
    if missing:
        packages = " ".join(sorted({PACKAGES[name] for name in missing}))
        raise AgentError(
            f"The playground needs {', '.join(missing)}: install the Debian packages (apt-get install {packages})."
        )
