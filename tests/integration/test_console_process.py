"""The console's process by itself: the token on every route, foreign pages refused, its death told and survived."""

from __future__ import annotations

import json
import logging
import signal
import struct
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from base_station.console.launcher import ConsoleProcess, ConsoleSettings
from tests.helpers import Programs, free_ports, wait_until, write_pictures

pytest.importorskip("nicegui")


@pytest.fixture
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="zs") as made:
        yield Path(made)


def visit(address: str, path: str = "", data: bytes | None = None, **headers: str) -> tuple[int, str, dict[str, str]]:
    """Status, text and headers; redirects are not followed."""

    class Stay(urllib.request.HTTPRedirectHandler):
        def redirect_request(self, *_: object) -> None:
            return None

    names = {name.replace("_", "-"): value for name, value in headers.items()}
    request = urllib.request.Request(address + path, data=data, headers=names)
    try:
        with urllib.request.build_opener(Stay).open(request, timeout=5.0) as answer:
            return answer.status, answer.read().decode(errors="replace"), dict(answer.headers)
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode(errors="replace"), dict(error.headers)


def up(address: str) -> bool:
    try:
        return visit(address)[0] > 0
    except OSError:  # refused, or not answered in time: the socket listens before the console is there
        return False


def test_any_other_address_needs_the_token_on_every_route(folder: Path) -> None:
    with ConsoleProcess(folder, ConsoleSettings(host="0.0.0.0", port=free_ports())) as console:
        name, _, query = console.address.partition("?")
        address = f"http://127.0.0.1:{name.rpartition(':')[2]}"
        wait_until(lambda: up(address), 20.0, "the console")
        for path in ("", "picture?after=0", "static/console.js", "_nicegui_ws/socket.io/?EIO=4&transport=polling"):
            assert visit(address, path)[0] == 401
        assert visit(address, "order", b"{}", content_type="application/json")[0] == 401
        status, _, headers = visit(address, "?" + query)
        assert status == 303 and headers["location"] == "/"
        cookie = headers["set-cookie"].partition(";")[0]
        status, page, _ = visit(address, cookie=cookie)
        assert status == 200 and "/static/console.js" in page
        assert visit(address, "static/console.js", cookie=cookie)[0] == 200
        assert visit(address, "picture?after=0", cookie=cookie)[0] == 200


def test_foreign_pages_and_foreign_names_are_refused_on_loopback(folder: Path) -> None:
    with ConsoleProcess(folder, ConsoleSettings(port=free_ports())) as console:
        address = console.address
        wait_until(lambda: up(address), 20.0, "the console")
        stop = json.dumps({"kind": "stop"}).encode()
        assert visit(address, "order", stop, content_type="application/json", origin="http://evil.example")[0] == 403
        assert visit(address, "order", stop, content_type="application/json", origin="http://[")[0] == 403
        assert visit(address, "order", stop, content_type="text/plain")[0] == 415
        assert visit(address, host="evil.example")[0] == 403
        assert visit(address, "order", b'{"kind": "dance"}', content_type="application/json")[0] == 400
        assert visit(address, "order", b"[" * 10_000, content_type="application/json")[0] == 400
        assert visit(address, "picture?after=" + "9" * 500)[0] == 200


def test_the_consoles_death_is_told_and_nothing_more(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR), ConsoleProcess(folder, ConsoleSettings(port=free_ports())) as console:
        wait_until(lambda: up(console.address), 20.0, "the console")
        assert console.process is not None
        console.process.kill()
        wait_until(lambda: "The station goes on without it" in caplog.text, 5.0, "a word about it")


def looked(address: str) -> dict[str, dict]:
    """A page's look at the picture: what came with it."""
    with urllib.request.urlopen(f"{address}picture?after=0", timeout=5.0) as answer:
        packet = answer.read()
    (length,) = struct.unpack("<I", packet[:4])
    return json.loads(packet[4 : 4 + length])


def test_a_replay_begins_with_its_first_page_and_keeps_the_last_picture(programs: Programs, tmp_path: Path) -> None:
    pictures, figures = write_pictures(tmp_path / "pictures", 12), tmp_path / "figures.json"
    station = programs.start(
        sys.executable, "-m", "base_station", "replay", str(pictures), "--tracker", "phase", "--json", str(figures),
        "--console", "--console-port", str(free_ports()),
    )  # fmt: skip
    said = station.says("begins when this page is opened", 30.0)
    address = said.partition("console: ")[2].split()[0]
    wait_until(lambda: up(address), 20.0, "the console")
    time.sleep(0.7)  # longer than the whole recording takes
    assert not figures.exists()
    looked(address)
    station.says("at its end", 20.0)
    assert json.loads(figures.read_text())["trackers"][0]["frames"] == 12
    time.sleep(2.5)  # longer than a page shows an old picture
    wait_until(lambda: "head" in looked(address), 5.0, "the last picture")
    kept = looked(address)
    assert kept["head"]["seen"]["state"] == "TRACKING"
    assert kept["status"]["connected"] and kept["status"]["link"].endswith("at its end")
    station.signal(signal.SIGINT)
    assert station.exit_code() == 0
