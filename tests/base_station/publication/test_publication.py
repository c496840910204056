"""What a station publishes: messages there and back, wishes checked, a private folder, and a loop that never waits."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
import zmq

from base_station.errors import StationError
from base_station.geometry import PinholeCamera
from base_station.orders import Order
from base_station.publication.schema import MAP, STATE, Addresses, Answer, Head, Map, State, Wish, encode
from base_station.publication.service import Publication, unknown_name
from base_station.publication.states import QUIET_S, Choices, StateMaker, map_of
from base_station.station import Step
from base_station.trackers.base import MapView, Shown, SignatureView
from base_station.types import Box, Frame, TrackerResult, TrackingState
from protocol import Command, FrameStamp, Hello, Telemetry
from protocol.records import from_bytes
from tests.helpers import ROOT, wait_until

CHOICES = Choices(trackers=("ztransform", "klt"), behaviours=("follow", "idle"), landmarks=("door",))


@dataclass
class Robot:
    state: str = "connected"
    connected: bool = True
    telemetry: Telemetry | None = None
    hello: Hello | None = None


@dataclass
class Taker:
    """Notes what is ordered."""

    posted: list[Order] = field(default_factory=list)
    stopped: list[str] = field(default_factory=list)

    def post(self, order: Order) -> None:
        self.posted.append(order)

    def emergency(self, action: str) -> str:
        self.stopped.append(action)
        return "the battery is flat" if action == "release" else ""


def step_of(number: int = 1, *, notices: tuple[str, ...] = (), width: int = 64, height: int = 48) -> Step:
    image = np.full((height, width), number % 256, np.uint8)
    result = TrackerResult(state=TrackingState.TRACKING, bearing_rad=0.1, zoom=1.5, confidence=0.9, box=Box(1, 2, 3, 4))
    camera = PinholeCamera.with_fov(width, height)
    return Step(
        frame=Frame(image=image, number=number, time_s=number / 30, camera=camera, connection="a"),
        result=result, shadow=None, command=Command(3, -4), learned=number == 1, tracker_s=0.001,
        frame_to_command_s=0.002, tracker="ztransform", shadow_tracker=None, behaviour="follow", orders=(),
        notices=notices,
    )  # fmt: skip


@pytest.fixture
def context() -> Iterator[zmq.Context]:
    made: zmq.Context = zmq.Context()
    yield made
    made.destroy(linger=0)


def subscribed(context: zmq.Context, address: str) -> zmq.Socket:
    socket = context.socket(zmq.SUB)
    socket.subscribe(b"")
    socket.connect(address)
    return socket


def ask(context: zmq.Context, address: str, data: bytes) -> str:
    with context.socket(zmq.REQ) as socket:
        socket.linger = 0
        socket.connect(address)
        socket.send(data)
        assert socket.poll(3000), "no answer"
        return from_bytes(Answer, socket.recv()).error


def test_a_state_comes_back_as_it_went():
    stamp = FrameStamp(connection=1, number=2, capture_s=3.0, dropped=4)
    robot = Robot(telemetry=Telemetry(sequence=1, monotonic_s=2.0, wall_s=3.0, frame=stamp))
    maker = StateMaker(robot, lambda: CHOICES, outcome=lambda: "there")
    maker.note_step(step_of(1, notices=("look out",)))
    maker.note_step(step_of(5))
    numbers = np.arange(5, dtype=np.float32)
    state = maker.state(SignatureView(now=numbers, learned=numbers))
    again = from_bytes(State, encode(state))
    assert again == state
    assert again.passed_over == 3
    assert again.learned and again.outcome == "there" and again.command == (3, -4)
    assert [notice.text for notice in again.notices] == ["look out"]
    assert again.frame_to_command_ms == pytest.approx(2.0)
    assert again.signature is not None and np.frombuffer(again.signature.now, "<f4").tolist() == [0, 1, 2, 3, 4]


def test_without_frames_nothing_old_is_told():
    robot = Robot(connected=False, telemetry=Telemetry(sequence=1, monotonic_s=2.0, wall_s=3.0))
    maker = StateMaker(robot, lambda: replace(CHOICES, tracker="klt", behaviour="idle"))
    assert (maker.state(None).tracker, maker.state(None).behaviour) == ("klt", "idle"), "by which it will begin"
    maker.note_step(step_of())
    maker.note_wait()
    assert maker.state(None).seen is not None, "a frame may be a moment late"
    time.sleep(QUIET_S + 0.05)
    maker.note_wait()
    state = maker.state(None)
    assert state.seen is None and state.telemetry is None and state.loop_hz == 0 and state.command == (0, 0)
    assert (state.tracker, state.behaviour) == ("ztransform", "follow")


def test_a_head_tells_the_features_within_the_frame():
    maker = StateMaker(Robot(), lambda: CHOICES)
    head = maker.head(step_of(), Shown(features_px=np.array([[1.4, 2.6], [-5.0, 999.0]]), bands=4))
    assert np.frombuffer(head.features, "<u2").reshape(-1, 2).tolist() == [[1, 3], [0, 47]]
    assert from_bytes(Head, encode(head)) == head
    assert (head.width, head.rows, head.bands, head.seen.box) == (64, 48, 4, (1.0, 2.0, 3.0, 4.0))


def test_a_large_map_is_thinned_and_fits_in_a_message():
    points = np.random.default_rng(0).normal(size=(50_001, 3))
    points[7] = np.nan
    published = map_of(MapView(points=points, keyframes=points[:900], world_from_cam=np.eye(4)))
    again = from_bytes(Map, encode(published))
    assert map_of(None, "slam") == Map(tracker="slam")
    assert again == published
    assert 1000 < len(again.points) // 12 <= 2000 and len(again.keyframes) // 12 <= 300
    assert (again.point_count, again.keyframe_count) == (50_001, 900)
    assert np.isfinite(np.frombuffer(again.points, "<f4")).all()


@pytest.mark.parametrize(
    ("order", "wrong"),
    [
        (Order(kind="tracker", name="klt"), ""),
        (Order(kind="tracker", name="landmark:door"), ""),
        (Order(kind="shadow"), ""),
        (Order(kind="tracker", name="kltt"), "did you mean klt"),
        (Order(kind="tracker", name="/tmp/evil.py:Tracker"), "no tracker"),
        (Order(kind="shadow", name="landmark:gate"), "no shadow"),
        (Order(kind="behaviour", name="dance"), "no behaviour"),
        (Order(kind="drive", forward=1.0), ""),
    ],
)
def test_only_names_that_are_offered_can_be_ordered(order, wrong):
    said = unknown_name(order, CHOICES)
    assert said == "" if not wrong else wrong in said


def test_the_desks_take_wishes_and_say_what_is_wrong(context):
    taker, forgotten = Taker(), []
    with Publication(Robot(), lambda: CHOICES, orders=taker, forget=forgotten.append) as publication:
        orders, emergency = publication.addresses.orders, publication.addresses.emergency
        assert ask(context, orders, encode(Wish(order=Order(kind="behaviour", name="idle")))) == ""
        assert ask(context, emergency, encode(Wish(order=Order(kind="stop")))) == ""
        assert ask(context, orders, encode(Wish(order=Order(kind="release")))) == "the battery is flat"
        assert ask(context, orders, encode(Wish(forget="door"))) == ""
        assert "map" in ask(context, orders, b"\x01")
        assert "no order" in ask(
            context, orders, encode(Wish()).replace(b"\xa5order\xc0", b"\xa5order\x81\xa4kind\xa1x")
        )
        assert "neither" in ask(context, orders, encode(Wish()))
        assert "only stop" in ask(context, emergency, encode(Wish(order=Order(kind="learn"))))
    assert [order.kind for order in taker.posted] == ["behaviour"]
    assert taker.stopped == ["stop", "release"]
    assert forgotten == ["door"]


def test_a_robot_that_does_not_take_the_stop_is_no_longer_driven(context):
    class Plain(Taker):
        def emergency(self, action: str) -> str:
            return "no control port"

    taker = Plain()
    with Publication(Robot(), lambda: CHOICES, orders=taker) as publication:
        said = ask(context, publication.addresses.emergency, encode(Wish(order=Order(kind="stop"))))
    assert "no control port" in said and "idle" in said
    assert taker.posted == [Order(kind="behaviour", name="idle")]


def test_a_replay_takes_no_orders(context):
    with Publication(Robot(), lambda: CHOICES) as publication:
        assert "replay" in ask(context, publication.addresses.orders, encode(Wish(order=Order(kind="learn"))))
        assert "replay" in ask(context, publication.addresses.emergency, encode(Wish(order=Order(kind="stop"))))


def test_the_folder_is_for_its_owner_alone_and_goes():
    with Publication(Robot(), lambda: CHOICES) as publication:
        folder = publication.addresses.folder
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        assert {path.name for path in folder.iterdir()} == {"pictures", "state", "orders", "emergency"}
    assert not folder.exists()


def test_a_folder_with_too_long_a_name_is_passed_over(tmp_path, monkeypatch):
    deep = tmp_path / ("x" * 100)
    deep.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(deep))
    with Publication(Robot(), lambda: CHOICES) as publication:
        assert len(str(publication.addresses.folder)) < 80


class Mapper:
    """A tracker with a map and something to show."""

    def learn(self, frame, target): ...
    def close(self): ...
    def update(self, frame): ...

    def show(self):
        return Shown(features_px=np.array([[1, 2]]))

    def show_map(self):
        return MapView(points=np.ones((4, 3)), keyframes=np.zeros((1, 3)), world_from_cam=None)


def test_pictures_states_and_maps_arrive(context):
    with Publication(Robot(), lambda: CHOICES, tracker=Mapper) as publication:
        pictures = subscribed(context, publication.addresses.pictures)
        states = subscribed(context, publication.addresses.state)
        kinds: dict[bytes, bytes] = {}

        def all_came() -> bool:
            publication.step(step_of(9))
            while states.poll(10):
                message = states.recv()
                kinds[message[:1]] = message[1:]
            return len(kinds) == 2 and bool(pictures.poll(0))

        wait_until(all_came, 5.0, "a picture, a state and a map")
        head, pixels = pictures.recv_multipart()
        assert from_bytes(Head, head).features == b"\x01\x00\x02\x00"
        assert pixels == bytes([9]) * 64 * 48
        assert from_bytes(State, kinds[STATE]).tracker == "ztransform"
        published = from_bytes(Map, kinds[MAP])
        assert (published.tracker, published.point_count) == ("ztransform", 4)


def test_a_signature_is_asked_for_no_more_often_than_it_is_sent(context):
    class Signer(Mapper):
        asked = 0

        def show_signature(self):
            self.asked += 1
            return SignatureView(now=np.ones(3), learned=np.zeros(3))

    tracker = Signer()
    with Publication(Robot(), lambda: CHOICES, tracker=lambda: tracker) as publication:
        states = subscribed(context, publication.addresses.state)
        time.sleep(0.1)  # a subscription takes a moment to arrive
        begun_s, told = time.monotonic(), []
        while time.monotonic() - begun_s < 0.6:
            publication.step(step_of())
            time.sleep(0.01)
        while states.poll(20):
            message = states.recv()
            if message[:1] == STATE:
                told.append(from_bytes(State, message[1:]).signature)
    assert 2 <= tracker.asked <= 7
    assert told and all(one is not None and len(one.now) == 3 * 4 for one in told)


@pytest.mark.parametrize("shows", [lambda: 1 / 0, lambda: "a window", lambda frame: None])
def test_a_tracker_that_means_something_else_by_show_stops_nothing(context, shows):
    tracker = Mapper()
    tracker.show = shows
    with Publication(Robot(), lambda: CHOICES, tracker=lambda: tracker) as publication:
        states = subscribed(context, publication.addresses.state)

        def told() -> list[str]:
            publication.step(step_of())
            return [n.text for n in from_bytes(State, states.recv()[1:]).notices] if states.poll(20) else []

        notices = wait_until(told, 5.0, "a word about it")
        assert len(notices) == 1 and "cannot show itself" in notices[0]


LISTENER = """
import sys, zmq
for address in sys.argv[1:]:
    socket = zmq.Context.instance().socket(zmq.SUB)
    socket.rcvhwm = 1
    socket.subscribe(b"")
    socket.connect(address)
print("listening", flush=True)
sys.stdin.read()
"""


def test_a_listener_that_stands_still_costs_the_loop_nothing():
    """A console that was stopped (SIGSTOP) neither delays the loop nor fills its memory."""
    with Publication(Robot(), lambda: CHOICES) as publication:
        addresses = publication.addresses
        listener = subprocess.Popen(
            [sys.executable, "-c", LISTENER, addresses.pictures, addresses.state],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT,
        )  # fmt: skip
        try:
            assert listener.stdout is not None
            assert listener.stdout.readline() == b"listening\n"
            time.sleep(0.2)
            os.kill(listener.pid, signal.SIGSTOP)
            took_s, rss = [], []
            for number in range(300):
                step = step_of(number, width=640, height=480)
                begun_s = time.thread_time()
                publication.step(step)
                took_s.append(time.thread_time() - begun_s)
                rss.append(int(Path("/proc/self/statm").read_text().split()[1]) * 4096)
            assert float(np.median(took_s)) < 0.002
            assert rss[-1] - rss[30] < 30 * 640 * 480, "pictures pile up"
        finally:
            listener.kill()
            listener.wait()


def test_no_folder_for_sockets_is_one_sentence(monkeypatch, tmp_path):
    long = tmp_path / ("y" * 90)
    long.mkdir()

    def made(**_: object) -> str:
        (long / "z").mkdir()
        return str(long / "z")

    monkeypatch.setattr("tempfile.mkdtemp", made)
    with pytest.raises(StationError, match="TMPDIR"):
        Publication(Robot(), lambda: CHOICES)


def test_addresses_name_the_sockets(tmp_path):
    assert Addresses(tmp_path).orders == f"ipc://{tmp_path}/orders"
