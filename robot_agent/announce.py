"""Makes the agent findable: DNS-SD over multicast DNS (RFC 6762, 6763), service `_zservo._tcp`.

Optional: without the zeroconf package (Debian: python3-zeroconf) the agent does without, and stations find it by
--host. Only what a station needs to connect is told; whether the robot is busy it asks the agent itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import ipaddress
import logging
import secrets
import socket
import threading
import uuid
from typing import Any

from protocol import PROTOCOL_VERSION, SERVICE_TYPE
from robot_agent.errors import UsageError

log = logging.getLogger(__name__)

MAX_NAME_BYTES = 40
"""DNS allows 63, and a name that is taken gets a number behind it."""


class Announcement:
    """Says on the local network that an agent serves `port` here, until `close`. Never fails the agent: what goes
    wrong is logged. Telling takes seconds, so it has a thread of its own."""

    def __init__(self, host: str, port: int, *, robot: str, camera: str) -> None:
        self._closing = threading.Event()
        self._thread = threading.Thread(
            target=self._tell, args=(host, port, {"robot": robot, "camera": camera}), name="announce", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Say goodbye, so that nobody finds what is not there any more."""
        self._closing.set()
        self._thread.join(timeout=3.0)

    def _tell(self, host: str, port: int, properties: dict[str, str]) -> None:
        zeroconf = _load()
        addresses = _addresses(host)
        if not addresses:
            return
        try:
            info = zeroconf.ServiceInfo(
                SERVICE_TYPE,
                f"{instance_name(socket.gethostname(), uuid.getnode(), port)}.{SERVICE_TYPE}",
                addresses=[socket.inet_aton(address) for address in addresses],
                port=port,
                server=f"zservo-{secrets.token_hex(4)}.local.",  # whose addresses these are: no other agent's
                properties={"protocol": str(PROTOCOL_VERSION), **properties},
            )
            with contextlib.closing(zeroconf.Zeroconf(interfaces=addresses)) as responder:
                responder.register_service(info, allow_name_change=True)
                log.info("announced as %s", info.name)
                self._closing.wait()
                responder.unregister_service(info)
        except Exception as error:  # a network without multicast is no reason not to drive
            log.warning("not announced on the network (%s: %s); --host finds this robot", type(error).__name__, error)


def announced(host: str, port: int, *, wanted: bool, robot: str, camera: str) -> Announcement | None:
    """Announce an agent that others can reach, where zeroconf is there; one on the loopback only when `wanted`.

    Raises UsageError when it is wanted and zeroconf is not there.
    """
    if not wanted and ipaddress.ip_address(_resolved(host)).is_loopback:
        return None
    try:
        _load()
    except ImportError as error:
        if wanted:
            raise UsageError(
                "--announce needs zeroconf: sudo apt install python3-zeroconf, or pip install 'zservo[discovery]'."
            ) from error
        return None
    return Announcement(host, port, robot=robot, camera=camera)


def _load() -> Any:
    """Raises ImportError where the package is not there."""
    import zeroconf

    return zeroconf


def _resolved(host: str) -> str:
    try:
        return socket.gethostbyname(host)
    except OSError:
        return "0.0.0.0"


def _addresses(host: str) -> list[str]:
    """The IPv4 addresses under which `host` is reached from elsewhere."""
    if (listening := _resolved(host)) != "0.0.0.0":
        return [listening]
    import ifaddr  # zeroconf's own dependency

    found = [ip.ip for adapter in ifaddr.get_adapters() for ip in adapter.ips if isinstance(ip.ip, str)]
    return [address for address in found if not ipaddress.ip_address(address).is_loopback]


def instance_name(hostname: str, hardware_address: int, port: int) -> str:
    """A machine's name as one DNS label, and four digits that tell this agent from others with that name.

    Probing for a name that is taken (RFC 6762, section 8) does not help robots made from one SD card and switched on
    together: each finds the name free, and stations see one robot. A machine and a port keep their digits.
    """
    label = "".join(c if c.isalnum() or c == "-" else "-" for c in hostname.partition(".")[0])
    digits = hashlib.sha256(f"{hardware_address:x} {port}".encode()).hexdigest()[:4]
    return f"{label.encode()[:MAX_NAME_BYTES].decode(errors='ignore') or 'robot'}-{digits}"
