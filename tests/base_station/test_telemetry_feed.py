"""A telemetry message that cannot be used ends the link in words, not a thread unseen."""

from __future__ import annotations

import threading
import time

import zmq

from base_station.sockets import TelemetryFeed
from protocol import Telemetry, encode


def test_what_ends_the_thread_is_told():
    told = threading.Event()
    errors: list[Exception] = []

    def take(telemetry: Telemetry) -> None:
        raise ZeroDivisionError("wheel base")

    def failed(error: Exception) -> None:
        errors.append(error)
        told.set()

    with zmq.Context() as context, context.socket(zmq.PUB) as publisher:
        publisher.linger = 0
        port = publisher.bind_to_random_port("tcp://127.0.0.1")
        feed = TelemetryFeed(context, "127.0.0.1", port, take, failed)
        deadline_s = time.monotonic() + 5.0
        while not told.is_set() and time.monotonic() < deadline_s:
            publisher.send(encode(Telemetry(sequence=1, monotonic_s=0.0, wall_s=0.0)))
            told.wait(0.02)
        feed.close()
    assert [str(error) for error in errors] == ["wheel base"]
