"""The two message ports, with real sockets: every request is answered, and telemetry goes on whatever is asked."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator

import msgpack
import pytest
import zmq

from protocol import Reply, Request, Telemetry, decode_reply, decode_telemetry, encode
from robot_agent.access import AllowList
from robot_agent.errors import AgentError
from robot_agent.outlet import Outlet

HOST = "127.0.0.1"


class Ports:
    """An outlet on free ports, and one peer that asks and listens."""

    def __init__(self, context: zmq.Context, **options) -> None:
        self.requests: list[Request] = []
        self.published = 0
        self.breaks: tuple[str, ...] = ()
        """What raises: requests of these actions, "report" for the telemetry."""
        self.failure: Exception | None = None
        with socket.create_server((HOST, 0)) as first, socket.create_server((HOST, 0)) as second:
            numbers = [place.getsockname()[1] for place in (first, second)]
        allow = options.pop("allow", AllowList())
        self.outlet = Outlet(HOST, *numbers, allow=allow, answer=self.answer, report=self.report, guard=self.guard)
        self.telemetry_port, self.control_port = numbers
        self.outlet.start()
        self.asking = context.socket(zmq.REQ)
        self.asking.connect(f"tcp://{HOST}:{self.control_port}")
        self.listening = context.socket(zmq.SUB)
        self.listening.subscribe(b"")
        self.listening.connect(f"tcp://{HOST}:{self.telemetry_port}")

    def answer(self, request: Request) -> Reply:
        self.requests.append(request)
        if request.action in self.breaks:
            raise RuntimeError("the camera's library failed")
        return Reply(ok=True)

    def guard(self, task: Callable[[], None]) -> None:
        try:
            task()
        except Exception as error:
            self.failure = error

    def report(self) -> Telemetry:
        if "report" in self.breaks:
            raise RuntimeError("no report")
        self.published += 1
        return Telemetry(sequence=self.published, monotonic_s=0.0, wall_s=0.0)

    def ask(self, data: bytes) -> Reply:
        self.asking.send(data)
        assert self.asking.poll(2000), "no reply"
        return decode_reply(self.asking.recv())

    def close(self) -> None:
        self.asking.close(linger=0)
        self.listening.close(linger=0)
        self.outlet.close()


@pytest.fixture
def ports() -> Iterator[Ports]:
    with zmq.Context() as context:
        opened = Ports(context)
        try:
            yield opened
        finally:
            opened.close()


def test_a_request_is_handed_on_and_answered(ports):
    assert ports.ask(encode(Request(action="stop", text="fire"))) == Reply(ok=True)
    assert ports.requests == [Request(action="stop", text="fire")]


def test_after_a_request_that_fails_the_emergency_stop_is_still_heard(ports):
    ports.breaks = ("exposure",)
    refused = ports.ask(encode(Request(action="exposure", value=1000.0)))
    assert not refused.ok and "RuntimeError: the camera's library failed" in refused.error
    assert ports.ask(encode(Request(action="stop", text="fire"))) == Reply(ok=True)
    assert ports.failure is None


def test_the_end_of_its_thread_is_not_unseen(ports):
    ports.breaks = ("report",)
    deadline_s = time.monotonic() + 2.0
    while ports.failure is None and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert str(ports.failure) == "no report"


def test_garbage_is_answered_with_what_is_wrong_and_the_port_goes_on(ports):
    ports.asking.send_multipart([b"two", b"parts"])
    assert not decode_reply(ports.asking.recv()).ok
    deep = msgpack.packb({"action": None})[:-1] + b"\x91" * 1000 + b"\xc0"
    for garbage in (b"", b"\xff\x00garbage", msgpack.packb([1]), msgpack.packb({"action": "dance"}), deep):
        reply = ports.ask(garbage)
        assert not reply.ok
        assert reply.error
    assert ports.requests == []
    assert ports.ask(encode(Request(action="hello"))).ok


def test_telemetry_comes_ten_times_a_second_by_itself(ports):
    assert ports.listening.poll(2000)
    ports.listening.recv()
    begun_s = time.monotonic()
    for _ in range(4):
        assert ports.listening.poll(1000)
        assert decode_telemetry(ports.listening.recv()).sequence > 0
    assert 0.3 < time.monotonic() - begun_s < 1.5


def test_a_peer_that_never_stops_asking_does_not_keep_telemetry_from_the_others(ports):
    assert ports.listening.poll(2000)
    before, deadline_s = ports.published, time.monotonic() + 0.5
    while time.monotonic() < deadline_s:
        ports.ask(encode(Request(action="hello")))
    assert 3 <= ports.published - before <= 8


def test_publishing_says_the_state_at_once(ports):
    assert ports.listening.poll(2000)
    before = ports.published
    for _ in range(5):
        ports.outlet.publish()
    assert ports.published - before >= 5
    sequences = [decode_telemetry(ports.listening.recv()).sequence for _ in range(6)]
    assert sequences == list(range(sequences[0], sequences[0] + 6))


@pytest.mark.parametrize("action", ["stop", "release"])
def test_what_a_stop_or_a_release_did_is_published_before_it_is_answered(ports, action):
    before = ports.published
    for asked in range(1, 6):
        ports.ask(encode(Request(action=action)))
        assert ports.published - before >= asked


def test_a_peer_that_is_not_allowed_gets_neither_answer_nor_telemetry():
    with zmq.Context() as context:
        closed = Ports(context, allow=AllowList(("192.0.2.0/24",)))
        try:
            closed.asking.send(encode(Request(action="stop")))
            assert not closed.asking.poll(300)
            assert not closed.listening.poll(0)
            assert closed.requests == []
        finally:
            closed.close()


def test_a_port_in_use_is_named(ports):
    with pytest.raises(AgentError, match=f"Port {ports.control_port} .* --port"):
        Outlet(
            HOST,
            ports.control_port,
            ports.control_port,
            allow=AllowList(),
            answer=ports.answer,
            report=ports.report,
            guard=ports.guard,
        )
