"""The two ZMQ ports: telemetry is published on one, hello and control requests are answered on the other."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable

import zmq

from protocol import ProtocolError, Reply, Request, Telemetry, decode_request, encode
from protocol.records import MAX_MESSAGE_BYTES
from robot_agent.access import AllowList, ZapGate
from robot_agent.errors import AgentError
from robot_agent.ports import advice

log = logging.getLogger(__name__)

HEARTBEAT_S = 0.1
TOLD_AT_ONCE = ("stop", "release")
"""Requests whose effect is published before they are answered: who stops a robot waits for no heartbeat to see it."""
ZAP_DOMAIN = b"zservo"


class Outlet:
    """Owns both sockets. `answer` makes the reply to a request, `report` the telemetry of this moment. `guard` runs the
    thread's task: should that end by an error, the emergency stop would not be heard any more.

    Raises AgentError when a port cannot be opened.
    """

    def __init__(
        self,
        host: str,
        telemetry_port: int,
        control_port: int,
        *,
        allow: AllowList,
        answer: Callable[[Request], Reply],
        report: Callable[[], Telemetry],
        guard: Callable[[Callable[[], None]], None],
    ) -> None:
        self._answer, self._report = answer, report
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._gate = ZapGate(self._context, allow)
        self._publishing = threading.Lock()
        self._publisher = self._open(zmq.PUB, host, telemetry_port)
        self._control = self._open(zmq.REP, host, control_port)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=guard, args=(self._serve,), name="outlet", daemon=True)

    def _open(self, kind: int, host: str, port: int) -> zmq.Socket[bytes]:
        opened = self._context.socket(kind)
        opened.linger = 0
        opened.maxmsgsize = MAX_MESSAGE_BYTES
        opened.setsockopt(zmq.ZAP_DOMAIN, ZAP_DOMAIN)
        if kind == zmq.PUB:
            opened.sndhwm = 256  # some seconds; a subscriber that is slower loses telemetry, never the agent its pace
        try:
            opened.bind(f"tcp://{host}:{port}")
        except zmq.ZMQError as error:
            self._gate.close()
            self._context.destroy(linger=0)
            raise AgentError(
                f"Port {port} on {host} cannot be opened ({error.strerror}): {advice(error.errno)}"
            ) from error
        return opened

    def start(self) -> None:
        """Begin to answer and to publish."""
        self._thread.start()

    def publish(self) -> None:
        """Publish the telemetry of this moment; any thread may ask."""
        with self._publishing:
            if not self._publisher.closed:
                self._publisher.send(encode(self._report()), zmq.NOBLOCK)

    def _serve(self) -> None:
        due_s = time.monotonic()  # by the clock, not when nobody asks: a peer that never stops asking is no excuse
        while not self._closing.is_set():
            if time.monotonic() >= due_s:
                self.publish()
                due_s = time.monotonic() + HEARTBEAT_S
            if self._control.poll(max(0, math.ceil((due_s - time.monotonic()) * 1000))):
                self._control.send(encode(self._reply(self._control.recv_multipart())))

    def _reply(self, parts: list[bytes]) -> Reply:
        try:
            if len(parts) != 1:
                raise ProtocolError(f"a request is one message part, {len(parts)} came")
            request = decode_request(parts[0])
            reply = self._answer(request)
            if request.action in TOLD_AT_ONCE:
                self.publish()
            return reply
        except ProtocolError as error:
            log.warning("control port: %s", error)
            return Reply(ok=False, error=str(error))
        except Exception as error:  # of a camera's or robot's own library: the next request may be the emergency stop
            log.exception("control port: a request failed")
            return Reply(ok=False, error=f"the agent could not do that ({type(error).__name__}: {error})")

    def close(self) -> None:
        self._closing.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._gate.close()
        with self._publishing:
            self._context.destroy(linger=100)
