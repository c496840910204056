"""The console in a real browser, with a simulated robot: one station and one Chromium for all, in the order written.

A target chosen by dragging, the robot that follows it, the emergency stop and its release, trackers exchanged, the page
reloaded, two pages at once, a page closed while it drives.
"""

from __future__ import annotations

import math
import re
import signal
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from protocol import Telemetry
from tests.helpers import Programs, TelemetryLog, driving, free_ports, standing, wait_until

sync_api = pytest.importorskip("playwright.sync_api")
CHROMIUM = Path("/usr/bin/chromium")
SWITCHES = [
    "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update", "--disable-sync",
    "--no-first-run",
]  # fmt: skip
pytestmark = [pytest.mark.alone, pytest.mark.skipif(not CHROMIUM.exists(), reason="no /usr/bin/chromium here")]


class Stage:
    """A simulated robot, its station with a console, and a browser."""

    def __init__(self, browser: Any, memory: Path) -> None:
        self.programs = Programs()
        port = free_ports()
        self.programs.agent(
            port, "--robot", "sim", "--scenario", "poster", "--size", "320x240", "--speed-scale", "4", "--seed", "1"
        )
        self.log = TelemetryLog(port).wait_until_live()
        self.station = self.programs.station(
            port, "--behaviour", "idle", "--memory", str(memory), "--no-status", "--console", "--console-port",
            str(free_ports()), tracker="ztransform",
        )  # fmt: skip
        said = self.station.says("console: http", 30.0)
        found = re.search(r"console: (http://127\.0\.0\.1:\d+/)", said)
        assert found, said
        self.address = found[1]
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self._context = browser.new_context(viewport={"width": 1280, "height": 800})
        self.page = self.open()

    def open(self) -> Any:
        """A page that shows pictures."""
        page = self._context.new_page()
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        wait_until(self._serves, 20.0, "the console's page")
        page.goto(self.address, wait_until="domcontentloaded")
        self.sees_pictures(page)
        return page

    def _serves(self) -> bool:
        try:
            with urllib.request.urlopen(self.address, timeout=5.0) as answer:
                return answer.status == 200
        except OSError:
            return False

    def sees_pictures(self, page: Any) -> None:
        page.wait_for_function(
            "() => window.zservo?.picture.head && zservo.picture.times_ms.length > 3", timeout=20_000
        )

    def head(self, page: Any = None) -> dict[str, Any]:
        """Of the picture that the page shows."""
        head = (page or self.page).evaluate("() => zservo.picture.head")
        assert head is not None, "no picture"
        return head

    def choose(self, page: Any, label: str, option: str) -> None:
        """In one of the page's selects."""
        page.get_by_label(label, exact=True).click()
        page.locator(".q-menu .q-item", has_text=re.compile(f"^{option}$")).click()
        page.locator(".q-menu").wait_for(state="detached")
        page.wait_for_function(
            "([label, option]) => [...document.querySelectorAll('.q-field')].some(field => "
            "field.innerText.includes(label) && field.innerText.includes(option))",
            arg=[label, option],
        )

    def behave(self, name: str, page: Any = None) -> None:
        """Choose this behaviour, and wait until the station goes by it."""
        page = page or self.page
        # the select follows the station five times a second; an option that it still shows as chosen is no choice
        page.wait_for_function(
            "() => [...document.querySelectorAll('.q-field')].some(field => field.innerText.includes('Behaviour') && "
            "field.innerText.includes(zservo.picture.status.behaviour))"
        )
        self.choose(page, "Behaviour", name)
        page.wait_for_function("name => zservo.picture.status.behaviour === name", arg=name)

    def face_the_target(self) -> None:
        """Steer until it is well in view: a pattern on a slow machine may have turned the robot far away."""
        self.behave("teleop")
        for _ in range(8):
            last = self.log.last
            assert last is not None
            if abs(bearing_deg(last)) < 12:
                break
            key = "ArrowLeft" if bearing_deg(last) > 0 else "ArrowRight"
            self.page.keyboard.down(key)
            self.log.wait_for(lambda m: abs(bearing_deg(m)) < 8, since_s=self.now_s(), what="a target ahead")
            self.page.keyboard.up(key)
            self.log.wait_for(standing, since_s=self.now_s(), what="a robot that stands")

    def now_s(self) -> float:
        """On the agent's clock."""
        assert self.log.last is not None
        return self.log.last.monotonic_s

    def target_px(self) -> tuple[float, float]:
        """Column of the target's middle in the picture, and roughly how wide it looks, by the simulation's truth."""
        last = self.log.last
        assert last is not None and last.truth is not None and last.truth.bearing_rad is not None
        assert last.truth.range_m is not None
        head = self.head()
        return (
            head["center_px"] - head["focal_px"] * math.tan(last.truth.bearing_rad),
            head["focal_px"] * 0.2 / last.truth.range_m,
        )

    def drag(self, x: float, y: float, width: float, height: float) -> None:
        """Over these pixels of the frame."""
        box = self.page.locator(".view canvas").bounding_box()
        scale = box["width"] / self.head()["width"]
        self.page.mouse.move(box["x"] + x * scale, box["y"] + y * scale)
        self.page.mouse.down()
        self.page.mouse.move(box["x"] + (x + width / 2) * scale, box["y"] + (y + height / 2) * scale)
        self.page.mouse.move(box["x"] + (x + width) * scale, box["y"] + (y + height) * scale)
        self.page.mouse.up()

    def close(self) -> None:
        self.log.close()
        self.programs.close()
        self._context.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=str(CHROMIUM), args=SWITCHES)
        yield started
        started.close()


@pytest.fixture(scope="module")
def stage(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    made = Stage(browser, tmp_path_factory.mktemp("memory") / "landmarks.npz")
    yield made
    made.close()


def bearing_deg(message: Telemetry) -> float:
    """Of the target, by the simulation's truth."""
    assert message.truth is not None and message.truth.bearing_rad is not None
    return math.degrees(message.truth.bearing_rad)


def latched(message: Telemetry) -> bool:
    return message.reason.startswith("emergency stop")


def test_the_page_shows_pictures_and_numbers(stage: Stage) -> None:
    page = stage.page
    first = stage.head()["number"]
    page.wait_for_function("first => zservo.picture.head?.number > first + 5", arg=first)
    assert (stage.head()["width"], stage.head()["height"]) == (320, 240)
    page.get_by_text("sim, poster, 320x240").wait_for()
    page.get_by_text("wheels ok").wait_for()
    drawn = page.evaluate(
        "() => { const c = document.querySelector('.view canvas');"
        " return Array.from(c.getContext('2d').getImageData(0, c.height / 2, c.width, 60).data) }"
    )
    assert len(set(drawn[::4])) > 50, "the picture has hardly any gray levels"


def test_a_dragged_box_is_the_target(stage: Stage) -> None:
    middle, width = stage.target_px()
    box = (middle - width / 3, 120 - width / 3, 2 * width / 3, 2 * width / 3)
    stage.drag(*box)
    stage.page.get_by_text(re.compile(r"Target: \d+")).wait_for()

    def learned() -> bool:
        seen = stage.head()["seen"]
        return seen["state"] == "TRACKING" and seen["box"] is not None and abs(seen["box"][2] - box[2]) < 4

    wait_until(learned, 5.0, "a target of the dragged size")
    for found, dragged in zip(stage.head()["seen"]["box"], box, strict=True):
        assert found == pytest.approx(dragged, abs=4)


def test_held_keys_drive_in_teleop_only(stage: Stage) -> None:
    page, since_s = stage.page, stage.now_s()
    page.keyboard.down("a")
    time.sleep(0.4)
    page.keyboard.up("a")
    assert not any(driving(message) for message in stage.log.messages if message.monotonic_s >= since_s)
    stage.behave("teleop")
    page.keyboard.down("d")
    turning = stage.log.wait_for(driving, since_s=stage.now_s(), what="wheels that turn")
    assert turning.wheels_asked[0] > 0 > turning.wheels_asked[1], "not to the right"
    stage.log.wait_for(lambda m: bearing_deg(m) > 10, since_s=stage.now_s(), what="a target on the left")
    page.keyboard.up("d")
    released_s = stage.now_s()
    stopped = stage.log.wait_for(lambda m: m.wheels_asked == (0, 0), since_s=released_s, what="wheels asked to stand")
    assert stopped.monotonic_s - released_s < 0.3


def test_the_robot_follows_the_chosen_target(stage: Stage) -> None:
    assert stage.log.last is not None and bearing_deg(stage.log.last) > 8
    stage.behave("follow")
    since_s = stage.now_s()
    stage.log.wait_for(driving, since_s=since_s, what="wheels that turn")
    stage.log.wait_for(lambda m: abs(bearing_deg(m)) < 3, since_s=since_s, what="a target straight ahead")


def test_the_emergency_stop_latches_and_is_released(stage: Stage) -> None:
    page = stage.page
    stage.behave("pattern")  # drives whatever it sees
    stage.log.wait_for(driving, since_s=stage.now_s(), what="wheels that turn")
    page.locator("#stop").click()
    stage.log.wait_for(lambda m: latched(m) and standing(m), since_s=stage.now_s(), what="a latched stop")
    page.locator("#stop-title", has_text="STOPPED").wait_for()
    page.get_by_text(re.compile("emergency stop: by the operator")).first.wait_for()
    page.locator("#release").click()
    stage.log.wait_for(lambda m: driving(m) and not latched(m), since_s=stage.now_s(), what="wheels that turn again")
    page.locator("#release").wait_for(state="hidden")


def test_the_space_bar_stops_but_not_while_typing(stage: Stage) -> None:
    page = stage.page
    name = page.get_by_label("name of a landmark")
    name.click()
    page.keyboard.type("a b")
    assert name.input_value() == "a b"
    assert stage.log.last is not None and not latched(stage.log.last)
    name.fill("")
    stage.behave("pattern")  # the select has the focus, or had it
    page.keyboard.press("Space")
    stage.log.wait_for(latched, since_s=stage.now_s(), what="a latched stop")
    page.locator("#release").click()
    stage.log.wait_for(lambda m: not latched(m), since_s=stage.now_s(), what="a released robot")


def test_trackers_are_exchanged(stage: Stage) -> None:
    stage.face_the_target()
    stage.behave("follow")
    stage.log.wait_for(lambda m: abs(bearing_deg(m)) < 3, since_s=stage.now_s(), what="a target straight ahead")
    stage.behave("idle")
    stage.choose(stage.page, "Tracker", "klt")
    stage.choose(stage.page, "Shadow", "phase")
    wait_until(lambda: stage.head()["shadow"] is not None, 10.0, "a result of the shadow")
    wait_until(lambda: stage.head()["seen"]["state"] == "TRACKING", 10.0, "the new tracker's result")
    stage.choose(stage.page, "Shadow", "none")
    stage.choose(stage.page, "Tracker", "ztransform")
    wait_until(lambda: stage.head()["shadow"] is None, 10.0, "no shadow any more")


def test_a_landmark_is_learned_gone_to_and_forgotten(stage: Stage) -> None:
    page = stage.page
    page.get_by_label("name of a landmark").fill("poster")
    page.get_by_role("button", name="Learn target").click()
    page.locator(".item", has_text="poster").wait_for(timeout=20_000)
    page.locator(".item").get_by_role("button", name="Go to").click()
    page.wait_for_function("() => zservo.picture.status.behaviour === 'goto'")
    wait_until(lambda: stage.head()["seen"]["state"] == "TRACKING", 15.0, "the landmark in view")
    stage.behave("idle")
    page.locator(".item").get_by_role("button", name="Forget").click()
    page.locator(".item").wait_for(state="detached")


def test_two_pages_and_a_reload(stage: Stage) -> None:
    second = stage.open()
    second.locator("#stop").click()
    for page in (stage.page, second):
        page.locator("#stop-title", has_text="STOPPED").wait_for()
    stage.page.reload(wait_until="domcontentloaded")
    stage.sees_pictures(stage.page)
    stage.page.locator("#stop-title", has_text="STOPPED").wait_for()
    stage.page.locator("#release").click()
    for page in (stage.page, second):
        page.locator("#release").wait_for(state="hidden")
    second.close()


@pytest.mark.parametrize("leaving", ["closed", "out of focus"])
def test_a_page_that_drives_and_goes_lets_the_robot_stand(stage: Stage, leaving: str) -> None:
    page = stage.open()
    stage.behave("teleop", page)
    page.keyboard.down("ArrowLeft")
    stage.log.wait_for(driving, since_s=stage.now_s(), what="wheels that turn")
    if leaving == "closed":
        page.close()
    else:
        page.evaluate("() => window.dispatchEvent(new Event('blur'))")
    gone_s = stage.now_s()
    stopped = stage.log.wait_for(lambda m: m.wheels_asked == (0, 0), since_s=gone_s, what="wheels asked to stand")
    assert stopped.monotonic_s - gone_s < 0.6
    time.sleep(0.3)
    assert stage.log.last is not None and not driving(stage.log.last)
    page.close()


PLUG_IN = """
() => {
  window.stick = [0, -1];
  const pad = {
    connected: true, id: "test",
    get axes() { return window.stick },
    get buttons() { return [{ pressed: false }, { pressed: !!window.stopButton }] },
  };
  navigator.getGamepads = () => window.stick ? [pad] : [];
}
"""
"""No gamepad is plugged into this machine: one that the page reads like any other, with its stick pushed forward."""


def test_the_pages_pad_and_a_gamepad_drive_while_they_are_held(stage: Stage) -> None:
    page = stage.page
    stage.behave("teleop")
    pad = page.locator('[data-drive="backward"]')
    pad.hover()
    page.mouse.down()
    backing = stage.log.wait_for(driving, since_s=stage.now_s(), what="wheels that turn")
    assert max(backing.wheels_asked) < 0
    page.mouse.up()
    stage.log.wait_for(lambda m: m.wheels_asked == (0, 0), 1.0, since_s=stage.now_s(), what="wheels asked to stand")
    page.bring_to_front()
    page.evaluate(PLUG_IN)
    forward = stage.log.wait_for(driving, since_s=stage.now_s(), what="wheels that turn")
    assert min(forward.wheels_asked) > 0
    page.evaluate("() => { window.stick = null }")
    stage.log.wait_for(lambda m: m.wheels_asked == (0, 0), 1.0, since_s=stage.now_s(), what="wheels asked to stand")
    stage.behave("idle")
    page.evaluate("() => { window.stick = [0, 0]; window.stopButton = true }")  # whatever the behaviour
    stage.log.wait_for(latched, since_s=stage.now_s(), what="a latched stop")
    page.evaluate("() => { window.stick = null; window.stopButton = false }")
    page.locator("#release").click()
    stage.log.wait_for(lambda m: not latched(m), since_s=stage.now_s(), what="a released robot")


BOXES = "query => [...document.querySelectorAll(query)].map(found => found.getBoundingClientRect().toJSON())"


def boxes(page: Any, query: str) -> list[dict[str, float]]:
    """Of what is shown on the page, in its window's pixels."""
    return [box for box in page.evaluate(BOXES, query) if box["width"] and box["height"]]


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (1280, 720)])
def test_all_that_matters_is_in_view_and_nothing_behind_the_stop(stage: Stage, width: int, height: int) -> None:
    page = stage.page
    page.set_viewport_size({"width": width, "height": height})
    page.wait_for_function("height => innerHeight === height", arg=height)
    assert page.evaluate("() => document.documentElement.scrollHeight") <= height
    (bar,) = boxes(page, "#emergency")
    for part in (".view", ".choices", ".landmarks", ".gauges", ".plots", ".signature"):
        page.locator(part).wait_for()
        (box,) = boxes(page, part)
        assert box["top"] >= 0 and box["bottom"] <= bar["top"] and box["right"] <= width, part
    (view,), (plots,) = boxes(page, ".view"), boxes(page, ".plots canvas")
    assert view["width"] / view["height"] == pytest.approx(4 / 3, rel=0.02)
    assert view["width"] > 0.3 * width and plots["height"] > 170


def test_words_at_the_page_cover_nothing_to_press(stage: Stage) -> None:
    for page_size in ((1440, 900), (390, 844)):
        page = stage.page
        page.set_viewport_size({"width": page_size[0], "height": page_size[1]})
        page.evaluate("() => scrollTo(0, 0)")
        page.evaluate("() => { zservo.toast('The tracker klt looks now.'); zservo.toast('Target: 120x90 px') }")
        assert page.evaluate("() => document.documentElement.scrollWidth") <= page_size[0]
        toasts = boxes(page, ".toast")
        assert toasts
        for toast in toasts:
            for box in boxes(page, "#stop, #release, #scheme, .orders button, .q-field"):
                apart = (
                    toast["right"] <= box["left"] or box["right"] <= toast["left"]
                    or toast["bottom"] <= box["top"] or box["bottom"] <= toast["top"]
                )  # fmt: skip
                assert apart, (page_size, toast, box)
        middle = toasts[-1]["left"] + toasts[-1]["width"] / 2, toasts[-1]["top"] + toasts[-1]["height"] / 2
        under = page.evaluate("([x, y]) => document.elementFromPoint(x, y).className", list(middle))
        assert "toast" not in under, "presses do not go through"
    page.set_viewport_size({"width": 1280, "height": 800})


def test_nothing_was_asked_of_any_other_machine(stage: Stage) -> None:
    asked = [url for url in stage.requests if not url.startswith(("data:", "blob:"))]
    assert len(asked) > 20
    assert [url for url in asked if not re.match(r"(http|ws)://127\.0\.0\.1:", url)] == []
    assert stage.complaints == []


def test_the_console_ends_with_the_station_and_the_page_says_so(stage: Stage) -> None:
    stage.station.signal(signal.SIGTERM)
    stage.page.get_by_text(re.compile("station has ended|cannot be reached")).first.wait_for(timeout=10_000)
    (banner,), (top,) = boxes(stage.page, "#banner"), boxes(stage.page, ".top")
    assert banner["bottom"] <= top["top"], "the banner covers the robot's name and state"
    assert stage.station.exit_code() == 0
    wait_until(lambda: not stage.station.orphans(), 5.0, "the console's end")
    stage.page.locator("#stop").click()
    stage.page.locator("#stop-title", has_text="NOT STOPPED").wait_for()
    stage.page.locator("#stop-hint", has_text="cut its power").wait_for()
