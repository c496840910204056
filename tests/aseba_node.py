"""A Thymio II faked at its outermost edge: the Aseba messages of a real one's firmware, on a TCP port.

Real programs talk to it (asebamedulla, thymiodirect over TCP or a serial line), and tests set what cannot be had from
asebaplayground's Thymio: buttons, accelerometer, battery, lights as variables, and unplugging.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Sequence

HEADER = struct.Struct("<HHH")
DESCRIPTION, VARIABLE, EVENT, FUNCTION = 0x9000, 0x9001, 0x9002, 0x9003
VARIABLES, NODE_PRESENT = 0x9005, 0x900C
GET_DESCRIPTION, GET_VARIABLES, SET_VARIABLES, GET_NODE_DESCRIPTION, LIST_NODES = 0xA000, 0xA00B, 0xA00C, 0xA010, 0xA011
NODE_ID, PROTOCOL = 1, 5

FIRMWARE = {
    "_id": 1, "event.source": 1, "event.args": 32, "_fwversion": 2, "_productId": 1, "button.backward": 1,
    "button.left": 1, "button.center": 1, "button.forward": 1, "button.right": 1, "prox.horizontal": 7,
    "prox.ground.ambiant": 2, "prox.ground.reflected": 2, "prox.ground.delta": 2, "motor.left.target": 1,
    "motor.right.target": 1, "_vbat": 2, "_imot": 2, "motor.left.speed": 1, "motor.right.speed": 1, "acc": 3,
    "leds.top": 3, "temperature": 1,
}  # fmt: skip
"""Variables and sizes, in the order of the firmware of 2020 (those that matter here)."""
AT_REST = {"prox.ground.delta": [900, 900], "acc": [0, 0, 22]}


class AsebaNode:
    """Listens from construction to `close`. Any number of clients, as on a bus."""

    def __init__(self, name: str = "thymio-II", variables: dict[str, int] = FIRMWARE, protocol: int = PROTOCOL) -> None:
        self._name, self._sizes, self._protocol = name, variables, protocol
        self._lock = threading.Lock()
        self._values = {variable: [0] * size for variable, size in variables.items()}
        self.writes: list[tuple[float, str, list[int]]] = []
        """All that was written to variables: when (monotonic s), which, what."""
        self.silent = False
        """A robot that is there and does not answer."""
        self._values |= {name: values for name, values in AT_REST.items() if name in variables}
        self._clients: list[socket.socket] = []
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._plugged = True
        threading.Thread(target=self._listen, daemon=True).start()

    def set(self, variable: str, *values: int) -> None:
        """What the robot measures from now on."""
        with self._lock:
            assert len(values) == len(self._values[variable])
            self._values[variable] = list(values)

    def get(self, variable: str) -> list[int]:
        with self._lock:
            return list(self._values[variable])

    @property
    def targets(self) -> tuple[int, int]:
        return self.get("motor.left.target")[0], self.get("motor.right.target")[0]

    def unplug(self) -> None:
        """Every connection ends, and new ones end at once."""
        self._plugged = False
        with self._lock:
            clients, self._clients = self._clients, []
        for client in clients:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def plug(self) -> None:
        """It is back, switched on anew: all targets are zero."""
        self.set("motor.left.target", 0)
        self.set("motor.right.target", 0)
        self._plugged = True

    def close(self) -> None:
        self.unplug()
        self._server.close()

    def _listen(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            if not self._plugged:
                client.close()
                continue
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._lock:
                self._clients.append(client)
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        with client, contextlib.suppress(OSError), client.makefile("rb") as stream:
            while len(header := stream.read(HEADER.size)) == HEADER.size:
                length, _, kind = HEADER.unpack(header)
                answer = self._answer(kind, stream.read(length))
                if answer and not self.silent:
                    client.sendall(answer)

    def _answer(self, kind: int, payload: bytes) -> bytes:
        words = [word for (word,) in struct.iter_unpack("<h", payload[: len(payload) // 2 * 2])]
        if kind == LIST_NODES:
            return _message(NODE_PRESENT, struct.pack("<H", self._protocol))
        if kind in (GET_DESCRIPTION, GET_NODE_DESCRIPTION):
            return self._description()
        if kind == GET_VARIABLES and words[0] == NODE_ID:
            with self._lock:
                flat = [value for values in self._values.values() for value in values]
            part = flat[words[1] : words[1] + words[2]]
            return _message(VARIABLES, struct.pack(f"<{1 + len(part)}h", words[1], *part))
        if kind == SET_VARIABLES and words[0] == NODE_ID:
            self._take(words[1], words[2:])
        return b""

    def _take(self, offset: int, values: Sequence[int]) -> None:
        with self._lock:
            for variable, size in self._sizes.items():
                if offset < size:
                    self._values[variable][offset : offset + len(values)] = values
                    self.writes.append((time.monotonic(), variable, list(values)))
                    return
                offset -= size

    def _description(self) -> bytes:
        numbers = (self._protocol, 766, 32, 620, len(self._sizes), 1, 1)
        messages = [_message(DESCRIPTION, _text(self._name) + struct.pack("<7H", *numbers))]
        messages += [_message(VARIABLE, struct.pack("<H", size) + _text(name)) for name, size in self._sizes.items()]
        messages.append(_message(EVENT, _text("button.center") + _text("Center button status changed")))
        function = (
            _text("leds.top") + _text("Set RGB top led") + struct.pack("<H", 1) + struct.pack("<H", 1) + _text("red")
        )
        messages.append(_message(FUNCTION, function))
        return b"".join(messages)


def _text(text: str) -> bytes:
    return bytes([len(text)]) + text.encode()


def _message(kind: int, payload: bytes) -> bytes:
    return HEADER.pack(len(payload), NODE_ID, kind) + payload
