"""The map in the page, in a real browser: what a tracker publishes is drawn and seen, also as it changes, is lost, goes
and comes back."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from base_station.console.launcher import ConsoleProcess, ConsoleSettings
from base_station.geometry import PinholeCamera
from base_station.publication.service import Publication
from base_station.publication.states import Choices
from base_station.station import Step
from base_station.trackers.base import MapView
from base_station.types import Frame, TrackerResult, TrackingState
from protocol import Command, Hello, Telemetry
from tests.helpers import free_ports, wait_until

sync_api = pytest.importorskip("playwright.sync_api")
pytest.importorskip("nicegui")
CHROMIUM = Path("/usr/bin/chromium")
SWITCHES = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync", "--no-first-run"]
pytestmark = pytest.mark.skipif(not CHROMIUM.exists(), reason="no /usr/bin/chromium here")

KEYFRAME_RGB, CAMERA_RGB, POINT_RGB = (0xF2, 0x99, 0x2E), (0x4A, 0x9D, 0xFF), (0xB9, 0xC4, 0xCF)
SCENE = """
() => {
  const [, scene] = Object.entries(window).find(([name]) => name.startsWith("scene_"));
  const count = (name) => scene.getObjectByName(name)?.geometry.attributes.position?.count;
  return { points: count("points"), keyframes: count("keyframes"), camera: scene.getObjectByName("camera")?.visible };
}
"""
WIDTHS = "() => ['.place', '.map canvas'].map((one) => document.querySelector(one).getBoundingClientRect().width)"


class Mapper:
    """A tracker whose map is chosen: a wall ahead, above and below a camera that drives along an arc."""

    def __init__(self) -> None:
        self.view: MapView | None = map_view(keyframes=26, points=400)

    def learn(self, frame: Frame, target: object) -> None: ...
    def update(self, frame: Frame) -> TrackerResult: ...  # type: ignore[empty-body]
    def close(self) -> None: ...

    def show_map(self) -> MapView | None:
        return self.view


def map_view(*, keyframes: int, points: int, placed: bool = True) -> MapView:
    along = np.linspace(0.0, 1.0, keyframes)
    driven = np.stack([np.sin(3 * along), np.full(keyframes, 0.4), 2 * along], 1)
    wall = np.random.default_rng(0).uniform((-1.5, -1.0, 3.9), (2.0, 0.9, 4.1), (points, 3))
    pose = np.eye(4)
    pose[:3, 3] = driven[-1]
    return MapView(points=wall, keyframes=driven, world_from_cam=pose if placed else None)


class Robot:
    state, connected = "connected", True
    telemetry: Telemetry | None = None
    hello: Hello | None = None


class Run:
    """A station's publication, a step each twentieth of a second; which tracker it has can be changed."""

    def __init__(self) -> None:
        self.mapper, self.tracker = Mapper(), "slam"
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._steps, daemon=True)
        self.publication = Publication(
            Robot(), Choices, tracker=lambda: self.mapper if self.tracker == "slam" else None
        )

    def _steps(self) -> None:
        image, camera = np.full((48, 64), 90, np.uint8), PinholeCamera.with_fov(64, 48)
        step = Step(
            frame=Frame(image=image, number=0, time_s=0.0, camera=camera),
            result=TrackerResult(state=TrackingState.TRACKING), shadow=None, command=Command(0, 0), learned=False,
            tracker_s=0.001, frame_to_command_s=0.002, tracker="slam", shadow_tracker=None, behaviour="idle", orders=(),
        )  # fmt: skip
        while not self._ending.wait(0.05):
            self.publication.step(replace(step, tracker=self.tracker))

    def __enter__(self) -> Run:
        self.publication.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self.publication.__exit__()


@pytest.fixture
def run() -> Iterator[Run]:
    with Run() as made:
        yield made


def pixels(page: Any, rgb: tuple[int, int, int]) -> int:
    """So many of the map's have nearly this colour."""
    shot = cv2.imdecode(np.frombuffer(page.locator(".map .place").screenshot(), np.uint8), cv2.IMREAD_COLOR)
    return int((np.abs(shot.astype(int) - rgb[::-1]).max(2) < 40).sum())


def test_the_map_is_seen_as_it_changes_is_lost_and_comes_back(run: Run) -> None:
    with (
        ConsoleProcess(run.publication.addresses.folder, ConsoleSettings(port=free_ports())) as console,
        sync_api.sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=SWITCHES)
        page = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme="dark")
        complaints: list[str] = []
        page.on("pageerror", lambda error: complaints.append(str(error)))

        def opened() -> bool:
            try:
                page.goto(console.address, wait_until="domcontentloaded")
            except sync_api.Error:  # it is not served yet
                return False
            return True

        def drawn(points: int, keyframes: int, camera: bool = True) -> None:
            def right() -> bool:
                return page.evaluate(SCENE) == {"points": points, "keyframes": keyframes, "camera": camera}

            page.locator(".map canvas").wait_for(timeout=30_000)
            wait_until(right, 20.0, f"{points} points, {keyframes} keyframes, camera {camera}")

        wait_until(opened, 30.0, "the page")
        drawn(400, 26)
        page.get_by_text("26 keyframes").wait_for()
        wait_until(lambda: pixels(page, KEYFRAME_RGB) > 150, 20.0, "the keyframes' colour")
        assert pixels(page, CAMERA_RGB) > 20 and pixels(page, POINT_RGB) > 200

        run.mapper.view = map_view(keyframes=40, points=900, placed=False)
        drawn(900, 40, camera=False)
        page.get_by_text("camera: not placed").wait_for()
        run.mapper.view = map_view(keyframes=9, points=120)  # merged, and thinned out
        drawn(120, 9)

        run.tracker = "ztransform"
        page.locator(".map").wait_for(state="hidden")
        page.set_viewport_size({"width": 1000, "height": 700})
        run.tracker, run.mapper.view = "slam", None
        page.get_by_text("no map yet").wait_for()
        run.mapper.view = map_view(keyframes=12, points=60)
        drawn(60, 12)
        wait_until(lambda: np.ptp(page.evaluate(WIDTHS)) < 2, 10.0, "a canvas as wide as its place")
        wait_until(lambda: pixels(page, KEYFRAME_RGB) > 100, 20.0, "the keyframes' colour")
        browser.close()
    assert complaints == []
