"""Which robots are there: listens to multicast DNS for `_zservo._tcp` for a moment, then asks each robot itself.

What comes from the network is anybody's: at most so many robots, addresses and ports that are some, names without
control characters, and an answer to hello within a second or none.
"""

from __future__ import annotations

import contextlib
import dataclasses
import ipaddress
import threading
import time
from collections.abc import Callable
from typing import Any

import zmq

from base_station.errors import StationError
from protocol import SERVICE_TYPE, Hello, ProtocolError, Request, decode_reply, encode
from protocol.records import MAX_MESSAGE_BYTES

MAX_ROBOTS = 64
MAX_ADDRESSES = 8
MAX_TEXT = 60
HELLO_S = 1.0
LOOK_UP_MS = 1500
LAST_FRAME_PORT = 65532


@dataclasses.dataclass(frozen=True, kw_only=True)
class FoundRobot:
    """A robot as it announced itself. `hello` is its own answer, None when it gave none."""

    name: str
    addresses: tuple[str, ...]
    """One at least; the first one is that at which it answers, if it does at any."""
    port: int
    robot: str
    camera: str
    hello: Hello | None = None

    @property
    def address(self) -> str:
        """Where to connect to."""
        return self.addresses[0]

    @property
    def busy(self) -> str:
        """Whether a station drives it, in words."""
        if self.hello is None:
            return "does not answer"
        return f"busy with {printable(self.hello.busy_with)}" if self.hello.busy_with else "free"


def printable(text: object) -> str:
    """Text from the network, cut to what fits in a column, without what could write elsewhere on the screen."""
    cleaned = "".join(c if c.isprintable() else "?" for c in str(text)[: MAX_TEXT + 1])
    return cleaned if len(cleaned) <= MAX_TEXT else cleaned[: MAX_TEXT - 1] + "…"


def robot_from(name: str, addresses: list[str], port: int | None, properties: dict[Any, Any]) -> FoundRobot | None:
    """An announcement as a robot; None when it is none that one could connect to."""
    if port is None or not 1 <= port <= LAST_FRAME_PORT:
        return None
    usable = []
    for text in addresses[:MAX_ADDRESSES]:
        with contextlib.suppress(ValueError):
            address = ipaddress.IPv4Address(text)
            if not (address.is_multicast or address.is_unspecified):
                usable.append(str(address))
    if not usable:
        return None

    def told(key: str) -> str:
        value = properties.get(key.encode())
        return printable(value.decode(errors="replace")) if isinstance(value, bytes) and value else "?"

    return FoundRobot(
        name=printable(name.removesuffix("." + SERVICE_TYPE)),
        addresses=tuple(usable),
        port=port,
        robot=told("robot"),
        camera=told("camera"),
    )


def find_robots(seconds: float, sleep: Callable[[float], None] = time.sleep) -> list[FoundRobot]:
    """Robots that announce themselves within that time, asked for their state, by name.

    Raises StationError without zeroconf, or where there is no network to listen to.
    """
    zeroconf = _load()
    names: set[str] = set()
    lock = threading.Lock()

    def changed(zeroconf: Any, service_type: str, name: str, state_change: Any) -> None:
        with lock:
            if state_change.name == "Removed":
                names.discard(name)
            elif len(names) < MAX_ROBOTS:
                names.add(name)

    try:
        with contextlib.closing(zeroconf.Zeroconf(ip_version=zeroconf.IPVersion.V4Only)) as listener:
            browser = zeroconf.ServiceBrowser(listener, SERVICE_TYPE, handlers=[changed])
            sleep(seconds)
            with lock:
                seen = sorted(names)
            browser.cancel()
            found = [robot for name in seen if (robot := _look_up(listener, name)) is not None]
    except (OSError, RuntimeError) as error:  # RuntimeError is zeroconf's for: no network interface
        raise StationError(f"The network cannot be listened to ({error}): name the robot with --host.") from error
    return _greet(found)


def _look_up(listener: Any, name: str) -> FoundRobot | None:
    """What a robot told of itself came with its name, as a rule; one that did not tell may answer a second later at the
    earliest, since multicast records go out once a second (RFC 6762, section 6)."""
    info = listener.get_service_info(SERVICE_TYPE, name, timeout=LOOK_UP_MS)
    return None if info is None else robot_from(name, info.parsed_addresses(), info.port, info.properties)


def _greet(robots: list[FoundRobot]) -> list[FoundRobot]:
    """Each with its answer to hello; all are asked at once, at all of their addresses, and waited for together."""
    with zmq.Context() as context, contextlib.ExitStack() as opened:
        poller = zmq.Poller()
        asked: dict[zmq.Socket[bytes], tuple[int, str]] = {}
        places = [(index, address) for index, robot in enumerate(robots) for address in robot.addresses]
        for index, address in places:
            asking = opened.enter_context(context.socket(zmq.REQ))
            asking.linger = 0
            asking.maxmsgsize = MAX_MESSAGE_BYTES
            asking.connect(f"tcp://{address}:{robots[index].port + 3}")
            asking.send(encode(Request(action="hello")))
            poller.register(asking, zmq.POLLIN)
            asked[asking] = index, address
        greeted, deadline_s = list(robots), time.monotonic() + HELLO_S
        while asked and (left_s := deadline_s - time.monotonic()) > 0:
            for answering, _ in poller.poll(max(1, round(left_s * 1000))):
                index, address = asked.pop(answering)
                poller.unregister(answering)
                with contextlib.suppress(ProtocolError):
                    hello = decode_reply(answering.recv()).hello
                    others = tuple(other for other in robots[index].addresses if other != address)
                    greeted[index] = dataclasses.replace(robots[index], addresses=(address, *others), hello=hello)
            if all(robot.hello is not None for robot in greeted):
                break
    return greeted


def _load() -> Any:
    try:
        import zeroconf
    except ImportError as error:
        raise StationError(
            "Finding robots needs zeroconf: pip install 'zservo[discovery]'; or name the robot with --host."
        ) from error
    return zeroconf
