"""The console's lines to the station: one for wishes, one for the emergency stop alone, each with its own thread."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

import zmq

from base_station.orders import Order
from base_station.publication.schema import Addresses, Answer, Wish, encode
from protocol import ProtocolError
from protocol.records import from_bytes

SILENT = "The station does not answer. If the robot still moves, use its own button, or cut its power."


class Line:
    """Asks, one after the other. `patience_s`: for an answer."""

    def __init__(self, address: str, patience_s: float) -> None:
        self._address, self._patience_ms = address, round(patience_s * 1e3)
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._socket: zmq.Socket[bytes] | None = None
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="line")

    async def ask(self, wish: Wish) -> str:
        """What went wrong, in words; empty when all is well."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._ask, wish)

    def close(self) -> None:
        self._thread.shutdown(wait=False, cancel_futures=True)
        self._context.destroy(linger=0)

    def _ask(self, wish: Wish) -> str:
        if self._socket is None:
            self._socket = self._context.socket(zmq.REQ)
            self._socket.linger = 0
            self._socket.connect(self._address)
        try:
            self._socket.send(encode(wish), zmq.DONTWAIT)
            if self._socket.poll(self._patience_ms):
                return from_bytes(Answer, self._socket.recv()).error
        except zmq.ZMQError:
            pass
        except ProtocolError as error:
            return f"The station's answer makes no sense: {error}"
        self._socket.close()  # REQ is stuck after a lost answer
        self._socket = None
        return SILENT


class Lines:
    """Takes each wish to where it belongs."""

    def __init__(self, addresses: Addresses) -> None:
        self._orders, self._emergency = Line(addresses.orders, 3.0), Line(addresses.emergency, 3.0)

    async def order(self, order: Order) -> str:
        """What went wrong, in words; empty when all is well."""
        line = self._emergency if order.kind in ("stop", "release") else self._orders
        return await line.ask(Wish(order=order))

    async def forget(self, landmark: str) -> str:
        """The same."""
        return await self._orders.ask(Wish(forget=landmark))

    def close(self) -> None:
        self._orders.close()
        self._emergency.close()
