"""Who may connect: the addresses of `--allow`, for the raw ports and, through ZAP (ZeroMQ RFC 27), for the ZMQ ones."""

from __future__ import annotations

import ipaddress
import logging
import threading

import zmq

from robot_agent.errors import UsageError

log = logging.getLogger(__name__)

ZAP_ENDPOINT = "inproc://zeromq.zap.01"


class AllowList:
    """Networks from which stations may connect. Empty: from anywhere. Raises UsageError on what is no network."""

    def __init__(self, networks: tuple[str, ...] = ()) -> None:
        try:
            self._networks = [ipaddress.ip_network(text, strict=False) for text in networks]
        except ValueError as error:
            raise UsageError(f"--allow: {error}. Give an address or a network such as 192.168.0.0/24.") from error

    def permits(self, address: str) -> bool:
        """Whether this IP address may connect."""
        if not self._networks:
            return True
        ip = ipaddress.ip_address(address)
        mapped = getattr(ip, "ipv4_mapped", None)
        return any((mapped or ip) in network for network in self._networks)


class ZapGate:
    """Answers ZeroMQ's question, for each connection to the context's sockets, whether the peer may connect.

    Sockets ask it when their `zap_domain` is set. Must exist before they are bound.
    """

    def __init__(self, context: zmq.Context[zmq.Socket[bytes]], allow: AllowList) -> None:
        self._allow = allow
        self._socket = context.socket(zmq.REP)
        self._socket.linger = 0
        self._socket.bind(ZAP_ENDPOINT)
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="zap", daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while not self._closing.is_set():
            if not self._socket.poll(200):
                continue
            version, request_id, _domain, address, *_ = self._socket.recv_multipart()
            permitted = self._allow.permits(address.decode())
            if not permitted:
                log.warning("%s may not connect (--allow)", address.decode())
            status = (b"200", b"OK") if permitted else (b"400", b"not allowed")
            self._socket.send_multipart([version, request_id, *status, b"", b""])
        self._socket.close()

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
