"""Starts the console's process beside a station, and ends it; the station goes on without it, whatever happens there.

The listening socket is made here, so that the address is known, and is handed on. So is the token, over the console's
standard input: it stands in no command line. When that input ends, the station has: then the console ends too.
"""

from __future__ import annotations

import contextlib
import ipaddress
import json
import logging
import secrets
import socket
import subprocess
import sys
import threading
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path

from base_station.console.web import check_installed
from base_station.errors import StationError

log = logging.getLogger(__name__)

MOST_TRIES = 20
"""So many ports are tried, from the one that was asked for."""
END_S = 4.0
LAST_WORDS = 5
OPENED = "opened"
"""The line that the console says when the first page is open."""


@dataclass(frozen=True, kw_only=True)
class ConsoleSettings:
    """Where the console is served."""

    host: str = "127.0.0.1"
    port: int = 8080
    """The first that is tried."""


@dataclass(frozen=True, kw_only=True)
class Instructions:
    """What the console's process is told, as one line of JSON."""

    folder: str
    """Of the station's sockets."""
    descriptor: int
    """Of the listening socket."""
    port: int
    token: str | None


class ConsoleProcess:
    """Use as a context manager, while `folder` exists. Raises StationError when it cannot be served."""

    def __init__(self, folder: Path, settings: ConsoleSettings) -> None:
        check_installed()
        self._folder, self._host = folder, settings.host
        self._token = None if is_loopback(settings.host) else secrets.token_urlsafe(24)
        self._listening = listen(settings)
        self._port: int = self._listening.getsockname()[1]
        self.process: subprocess.Popen[str] | None = None
        self._ending = False
        self._said: deque[str] = deque(maxlen=LAST_WORDS)
        self._watching = threading.Thread(target=self._watch, name="console", daemon=True)
        self._opened = threading.Event()
        self._hearing = threading.Thread(target=self._hear, name="pages", daemon=True)

    @property
    def address(self) -> str:
        """To open in a browser; with the token where one is needed."""
        return address_text(self._host, self._port, self._token)

    @property
    def running(self) -> bool:
        """It serves pages; not when it has ended by itself."""
        return self.process is not None and self.process.poll() is None

    def opened(self, patience_s: float) -> bool:
        """Whether a page has been opened; waits so long for one."""
        return self._opened.wait(patience_s)

    def __enter__(self) -> ConsoleProcess:
        descriptor = self._listening.fileno()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "base_station.console"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            pass_fds=(descriptor,),
            process_group=0,  # Ctrl-C in the terminal is for the station, which then ends the console
        )
        told = Instructions(folder=str(self._folder), descriptor=descriptor, port=self._port, token=self._token)
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):  # it has ended already: `_watch` says so
            self.process.stdin.write(json.dumps(asdict(told)) + "\n")
            self.process.stdin.flush()
        self._listening.close()
        self._watching.start()
        self._hearing.start()
        return self

    def __exit__(self, *_: object) -> None:
        process, self._ending = self.process, True
        assert process is not None and process.stdin is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._watching.join(END_S)
        self._hearing.join(END_S)

    def _watch(self) -> None:
        """Read what it says, so that it never waits for that; and tell when it ends by itself."""
        process = self.process
        assert process is not None and process.stderr is not None
        for line in process.stderr:
            self._said.append(line.rstrip())
        process.stderr.close()
        code = process.wait()
        if not self._ending:
            why = " ".join(self._said) or "it said nothing"
            log.error("The console ended (exit code %d: %s). The station goes on without it.", code, why)

    def _hear(self) -> None:
        process = self.process
        assert process is not None and process.stdout is not None
        for line in process.stdout:
            if line.strip() == OPENED:
                self._opened.set()
        process.stdout.close()


def is_loopback(host: str) -> bool:
    """Only this machine can reach it."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def listen(settings: ConsoleSettings) -> socket.socket:
    """At the first free port from the one asked for; says so when it is another. Raises StationError."""
    for port in range(settings.port, min(settings.port + MOST_TRIES, 65536)):
        made = None
        try:
            family, *_, address = socket.getaddrinfo(settings.host, port, type=socket.SOCK_STREAM)[0]
            made = socket.socket(family, socket.SOCK_STREAM)
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            made.bind(address)
            made.listen(64)
        except socket.gaierror as error:
            raise StationError(f"--console-host {settings.host}: there is no such address.", usage=True) from error
        except OSError as error:
            if made is not None:
                made.close()
            if isinstance(error, PermissionError):
                raise StationError(f"--console-port {port} needs more rights: take 1024 or above.") from error
            if error.errno not in (98, 48):  # address in use: Linux, and elsewhere
                raise StationError(f"No console at {settings.host}:{port} ({error.strerror}).", usage=True) from error
            continue
        if port != settings.port:
            log.warning("Port %d is taken, the console takes %d (--console-port chooses).", settings.port, port)
        return made
    last = min(settings.port + MOST_TRIES, 65536) - 1
    raise StationError(f"The ports {settings.port} to {last} are all taken: give another --console-port.", usage=True)


def address_text(host: str, port: int, token: str | None) -> str:
    """As it is opened in a browser. Of all addresses (0.0.0.0) the one towards the network is told."""
    named = host
    try:
        if ipaddress.ip_address(host).is_unspecified:
            named = _own_address()
        elif ":" in host:
            named = f"[{host}]"
    except ValueError:
        pass
    return f"http://{named}:{port}/" + (f"?token={token}" if token else "")


def _own_address() -> str:
    """Of this machine in its network, else its name. Nothing is sent: connecting a datagram socket only chooses."""
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as choosing:
        choosing.connect(("192.0.2.1", 9))  # an address that is nobody's
        return str(choosing.getsockname()[0])
    return socket.gethostname()
