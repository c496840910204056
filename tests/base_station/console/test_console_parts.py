"""The console's parts without a browser: who may in, packets, orders read, addresses, plots, and the map's geometry."""

from __future__ import annotations

import asyncio
import base64
import json
import socket
import struct
import subprocess
import sys
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest

from base_station.console.feed import LOOKED_AT_S, SILENT_S, Feed, Sample, packet, status_of
from base_station.console.gate import Gate
from base_station.console.gauges import BATTERY, DELAY, FACTS, LOOP, facts
from base_station.console.launcher import ConsoleProcess, ConsoleSettings, address_text, is_loopback, listen
from base_station.console.line import SILENT, Line
from base_station.console.plots import CURVES, history_options, history_series
from base_station.console.routes import LARGEST_ORDER_BYTES, read_order
from base_station.console.scene import EXTENT, Fit, fitted, kept_fit, pose_of, rows_of, text_of
from base_station.errors import StationError
from base_station.orders import Order
from base_station.publication.schema import MAP, STATE, Addresses, Head, Map, Seen, State, Wish, encode
from protocol import Telemetry
from tests.helpers import ROOT

HOST = {"host": "127.0.0.1:8080"}
TOKEN = "a-long-secret"


async def nothing(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"inside"})


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        (HOST, 200),
        ({"host": "localhost:8080"}, 200),
        ({"host": "[::1]:8080"}, 200),
        ({**HOST, "origin": "http://127.0.0.1:8080"}, 200),
        ({**HOST, "origin": "http://evil.example"}, 403),
        ({**HOST, "origin": "http://127.0.0.1:9999"}, 403),
        ({**HOST, "origin": "null"}, 403),
        ({"host": "evil.example:8080"}, 403),
        ({"host": "[broken"}, 403),
        ({}, 403),
    ],
)
def test_on_loopback_only_the_consoles_own_pages_may_in(headers, status):
    assert Gate(nothing, None, 8080).judge(headers, "").status == status


@pytest.mark.parametrize(
    ("headers", "query", "status"),
    [
        ({}, "", 401),
        ({}, "token=wrong", 401),
        ({}, f"token={TOKEN}x", 401),
        ({}, "token=%C3%A9", 401),
        ({}, f"token={TOKEN}", 303),
        ({"cookie": f"zservo-8080={TOKEN}"}, "", 200),
        ({"cookie": f"other=1; zservo-8080={TOKEN}"}, "", 200),
        ({"cookie": f"zservo-8081={TOKEN}"}, "", 401),
        ({"cookie": "zservo-8080="}, "", 401),
        ({"cookie": f"zservo-8080={TOKEN}", "origin": "http://evil.example"}, "", 403),
    ],
)
def test_elsewhere_the_token_lets_in(headers, query, status):
    gate = Gate(nothing, TOKEN, 8080)
    assert gate.judge({"host": "robot.local:8080", **headers}, query).status == status


def visited(gate: Gate, kind: str = "http", path: str = "/", query: bytes = b"", **headers: str) -> list[dict]:
    """What the gate sends to such a visitor."""
    sent: list[dict] = []

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "websocket.connect"}

    names = [(name.encode(), value.encode()) for name, value in headers.items()]
    asyncio.run(gate({"type": kind, "path": path, "query_string": query, "headers": names}, receive, send))
    return sent


def test_the_token_becomes_a_cookie_and_leaves_the_address():
    begun, _ = visited(Gate(nothing, TOKEN, 8080), query=f"token={TOKEN}&x=1".encode(), host="robot.local:8080")
    headers = dict(begun["headers"])
    assert begun["status"] == 303
    assert headers[b"location"] == b"/?x=1"
    assert b"HttpOnly" in headers[b"set-cookie"] and TOKEN.encode() in headers[b"set-cookie"]
    away, _ = visited(Gate(nothing, TOKEN, 1), path="//evil.example", query=f"token={TOKEN}".encode(), host="h")
    assert dict(away["headers"])[b"location"] == b"/evil.example"


def test_the_websocket_and_every_route_are_guarded():
    gate = Gate(nothing, TOKEN, 8080)
    assert visited(gate, "websocket", "/_nicegui_ws/socket.io/", host="robot.local") == [
        {"type": "websocket.close", "code": 1008}
    ]
    for path in ("/", "/picture", "/order", "/static/console.js", "/_nicegui/x"):
        begun, body = visited(gate, path=path, host="robot.local")
        assert begun["status"] == 401 and b"terminal" in body["body"]
    inside, body = visited(gate, cookie=f"zservo-8080={TOKEN}", host="robot.local")
    assert (
        body["body"] == b"inside" and dict(inside["headers"])[b"content-security-policy"] == b"frame-ancestors 'none'"
    )


def test_a_packet_holds_head_features_and_picture():
    head = Head(
        number=7, width=64, height=48, first_row=0, rows=48, arrived_s=1.0, focal_px=50.0, center_px=31.5,
        seen=Seen(state="LOST", reason="hidden"), features=struct.pack("<4H", 1, 2, 3, 4),
    )  # fmt: skip
    packed = packet(head, status_of(None), b"JPEG")
    (length,) = struct.unpack_from("<I", packed)
    told = json.loads(packed[4 : 4 + length])
    assert told["head"]["number"] == 7 and told["head"]["features"] == 2 and told["status"]["connected"] is False
    assert packed[4 + length :] == struct.pack("<4H", 1, 2, 3, 4) + b"JPEG"


def test_the_status_tells_a_latched_stop_from_other_stops():
    def status(reason: str) -> dict:
        telemetry = Telemetry(sequence=1, monotonic_s=0.0, wall_s=0.0, safety="stopped", reason=reason)
        return status_of(State(link="connected", connected=True, telemetry=telemetry, behaviour="idle"))

    assert status("emergency stop: by the operator")["latched"] is True
    assert status("no command for 500 ms")["latched"] is False
    assert status("")["behaviour"] == "idle"


@pytest.mark.parametrize(
    "body", [b"", b"[]", b"{}", b"\xff", b'{"kind": "dance"}', b'{"kind": "learn", "box": [1, 2, 3]}',
             b'{"kind": "learn", "box": [1, 2, NaN, 4]}', b'{"kind": "learn", "box": [1, 2, -3, 4]}',
             b'{"kind": "drive", "forward": 2}', b"[" * LARGEST_ORDER_BYTES],
)  # fmt: skip
def test_an_order_that_makes_no_sense_is_told(body):
    with pytest.raises(ValueError, match=r".+"):
        read_order(body)


def test_an_order_is_read():
    assert read_order(b'{"kind": "learn", "box": [1, 2.5, 30, 40]}') == Order(kind="learn", box=(1.0, 2.5, 30.0, 40.0))
    assert read_order(b'{"kind": "drive", "forward": -1, "left": 0.5}').left == 0.5


@pytest.mark.parametrize(
    ("host", "own"),
    [("127.0.0.1", True), ("127.1.2.3", True), ("::1", True), ("localhost", True), ("0.0.0.0", False),
     ("192.168.1.5", False), ("robot.local", False)],
)  # fmt: skip
def test_loopback_is_told_from_other_addresses(host, own):
    assert is_loopback(host) is own


def test_addresses_can_be_opened():
    assert address_text("127.0.0.1", 8080, None) == "http://127.0.0.1:8080/"
    assert address_text("::1", 8080, None) == "http://[::1]:8080/"
    told = address_text("0.0.0.0", 81, "t")
    assert told.endswith(":81/?token=t") and "0.0.0.0" not in told


def test_a_taken_port_gives_the_next_one_and_says_so(caplog):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with listen(ConsoleSettings(port=port)) as found:
            assert port < found.getsockname()[1] < port + 20
    assert f"Port {port} is taken" in caplog.text


def test_addresses_that_there_are_not_are_one_sentence():
    with pytest.raises(StationError, match="no such address"):
        listen(ConsoleSettings(host="no.such.host.invalid"))
    with pytest.raises(StationError, match="No console at"):
        listen(ConsoleSettings(host="203.0.113.9"))


def test_the_terminal_is_told_the_token_of_any_other_address(tmp_path):
    console = ConsoleProcess(tmp_path, ConsoleSettings(host="0.0.0.0", port=18300))
    assert len(console.address.partition("?token=")[2]) >= 32
    assert "?" not in ConsoleProcess(tmp_path, ConsoleSettings(port=18300)).address


def test_a_missing_nicegui_is_one_sentence_that_names_the_extra():
    code = (
        "import sys\n"
        "class Blocker:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.partition('.')[0] == 'nicegui':\n"
        "            raise ModuleNotFoundError(name)\n"
        "sys.meta_path.insert(0, Blocker())\n"
        "from base_station.console.web import check_installed\n"
        "from base_station.errors import StationError\n"
        "try:\n"
        "    check_installed()\n"
        "except StationError as error:\n"
        "    print(error)\n"
    )
    said = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert "zservo[console]" in said.stdout, said.stderr


def test_a_silent_station_is_told_and_asked_again(tmp_path):
    line = Line(f"ipc://{tmp_path}/nobody", 0.05)
    for _ in range(2):
        assert asyncio.run(line.ask(Wish(order=Order(kind="stop")))) == SILENT
    line.close()


def test_gauges_are_texts_with_units():
    texts = facts(State(link="", connected=True, loop_hz=29.96, frame_to_command_ms=1.2, frame_to_command_p95_ms=3.4))
    assert tuple(texts) == FACTS
    assert texts[LOOP] == "30.0 Hz" and texts[DELAY] == "1.2 | 3.4 ms" and texts[BATTERY] == "-"


def test_the_plots_lines_end_now_and_have_gaps():
    samples = [Sample(time_s=100.0 + i, shift_px=i, zoom=None, bearing_rad=0.1, confidence=0.5) for i in range(3)]
    shift, zoom, bearing, _ = (line["data"] for line in history_series(samples))
    assert shift == [[-2.0, 0], [-1.0, 1], [0.0, 2]]
    assert [value for _, value in zoom] == [None] * 3
    assert bearing[0][1] == pytest.approx(5.73, abs=0.01)
    options = history_options()
    assert len(options["grid"]) == len(CURVES) == len(history_series([]))
    assert options["yAxis"][2][":max"] == "(on) => (on.max > 1.0 ? null : 1.0)", "a degree at the least"
    assert ":min" not in options["yAxis"][3] and options["yAxis"][3]["min"] == 0


def test_the_map_is_fitted_into_the_scene():
    points = np.random.default_rng(0).uniform(4.0, 6.0, (500, 3))
    points[0] = 1000.0
    fit = fitted(points, np.array([[5.0, 5.0, 0.0]]))
    assert fit.middle == pytest.approx([5, 5, 2.9], abs=0.15) and fit.scale == pytest.approx(EXTENT / 2.9, rel=0.05)
    none = np.empty((0, 3))
    assert fitted(none, none).scale == 1.0 and fitted(np.ones((3, 3)), none).scale == 1.0


def test_the_scene_stands_still_until_the_map_has_outgrown_it():
    old = Fit((0.0, 0.0, 0.0), 1.0)
    assert kept_fit(None, old) is old
    assert kept_fit(old, Fit((0.1 * EXTENT, 0.0, 0.0), 1.1)) is old
    for new in (Fit((0.0, 0.5 * EXTENT, 0.0), 1.0), Fit((0.0, 0.0, 0.0), 0.5), Fit((0.0, 0.0, 0.0), 2.0)):
        assert kept_fit(old, new) is new


def test_a_maps_numbers_are_read_and_what_is_none_is_left_out():
    rows = np.arange(7, dtype="<f4")
    assert rows_of(rows.tobytes()).tolist() == [[0, 1, 2], [3, 4, 5]]
    rows[4] = np.inf
    assert rows_of(rows.tobytes()).tolist() == [[0, 1, 2]]
    assert np.frombuffer(base64.b64decode(text_of(rows_of(rows.tobytes()))), "<f4").tolist() == [0, 1, 2]
    assert pose_of(Map(camera=tuple(range(16)))) == pytest.approx(np.arange(16.0).reshape(4, 4))
    for camera in (None, (1.0, 2.0), (float("nan"),) * 16):
        assert pose_of(Map(camera=camera)) is None


def test_a_map_is_that_of_the_tracker_that_steers(tmp_path):
    feed, told = Feed(Addresses(tmp_path)), State(link="", connected=True, tracker="slam")
    for message in (STATE + encode(told), MAP + encode(Map(tracker="slam", point_count=7))):
        feed._take_state(message)
    assert feed.map is not None and feed.map.point_count == 7
    feed._take_state(STATE + encode(told))
    assert feed.map is not None
    feed._take_state(STATE + encode(replace(told, tracker="ztransform")))
    assert feed.map is None, "when slam comes back, its map is a new one"


@pytest.mark.parametrize(
    ("asked", "width"),
    [((), 640), ((0,), 640), ((320,), 320), ((100, 320), 320), ((200,), 200), ((320, 0), 640), ((9999,), 640)],
)
def test_a_picture_is_no_wider_than_the_widest_page_shows_it(tmp_path, asked, width):
    feed, image = Feed(Addresses(tmp_path)), np.zeros((480, 640), np.uint8)
    head = Head(number=1, width=640, height=480, first_row=0, rows=480, arrived_s=0.0, focal_px=1, center_px=1,
                seen=Seen(state="LOST"))  # fmt: skip
    for one in asked:
        asyncio.run(feed.picture(0, 0.001, one))
    feed._asked_s = time.monotonic()
    feed._take_picture([encode(head), image.tobytes()])
    packed = asyncio.run(feed.picture(0, 1.0))
    (length,) = struct.unpack("<I", packed[:4])
    jpeg = cv2.imdecode(np.frombuffer(packed[4 + length :], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert jpeg.shape == (width * 3 // 4, width)


def test_a_page_that_is_gone_makes_no_picture_wide(tmp_path, monkeypatch):
    feed, clock = Feed(Addresses(tmp_path)), [100.0]
    monkeypatch.setattr("base_station.console.feed.time.monotonic", lambda: clock[0])
    for seconds, width, kept in ((0.0, 600, 600), (0.1, 300, 600), (LOOKED_AT_S + 0.1, 300, 300)):
        clock[0] += seconds
        feed._note_look(width)
        assert feed._width == kept


def test_a_station_that_has_fallen_silent_is_not_shown_to_stand_well(tmp_path, monkeypatch):
    """A loop that hangs publishes nothing: what was true a minute ago must not stay green."""
    feed, clock = Feed(Addresses(tmp_path)), [100.0]
    monkeypatch.setattr("base_station.console.feed.time.monotonic", lambda: clock[0])
    telling = State(link="connected", connected=True, seen=Seen(state="TRACKING", reason=""), behaviour="follow")
    feed._take_state(STATE + encode(telling))
    assert feed.state == telling and feed.status()["connected"]
    clock[0] += SILENT_S + 10
    assert feed.state is not None and (feed.state.seen, feed.state.telemetry) == (None, None)
    assert not feed.status()["connected"] and "no news" in feed.status()["link"]
    feed._take_state(STATE + encode(telling))
    assert feed.state == telling
