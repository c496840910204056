"""The picture of a run is a PNG that shows the run: view, path and curves."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from base_station.evaluation.closed_loop import LoopLog
from base_station.evaluation.picture import HEIGHT, PANEL_H, PANEL_W, WIDTH, RunPicture
from base_station.geometry import PinholeCamera
from base_station.station import Step
from base_station.types import Box, Frame, TrackerResult, TrackingState
from protocol import STOP, Truth

PANELS = {
    "view": (slice(0, PANEL_H), slice(0, PANEL_W)),
    "path": (slice(0, PANEL_H), slice(PANEL_W, WIDTH)),
    "bearing": (slice(PANEL_H, HEIGHT), slice(0, PANEL_W)),
    "distance": (slice(PANEL_H, HEIGHT), slice(PANEL_W, WIDTH)),
}
SEEN = TrackerResult(
    state=TrackingState.TRACKING, bearing_rad=0.1, zoom=1.2, confidence=0.9, box=Box(200, 150, 100, 80)
)
LOST = TrackerResult(state=TrackingState.LOST, reason="out of sight")


def step(number: int, result: TrackerResult, size: tuple[int, int] = (640, 480)) -> Step:
    width, height = size
    image = np.full((height, width), 120, np.uint8)
    return Step(
        frame=Frame(image=image, number=number, time_s=number / 30, camera=PinholeCamera.with_fov(width, height)),
        result=result,
        shadow=None,
        tracker="ztransform",
        behaviour="follow",
        command=STOP,
        learned=False,
        tracker_s=0.0,
        frame_to_command_s=None,
    )


def true(number: int) -> tuple[float, Truth]:
    angle = number / 20
    where = (math.cos(angle), math.sin(angle), 0.0)
    return number / 30, Truth(robot=where, target=(where[0] + 0.4, where[1], 0.0), bearing_rad=0.1, range_m=0.4)


def drawn(picture: RunPicture, truths: list[tuple[float, Truth]]) -> np.ndarray:
    """The PNG decoded again; its size and format are checked."""
    summary = LoopLog(tracker="ztransform", behaviour="follow").summary(scenario="leader", seed=0, rhythm="free")
    data = picture.png(truths, summary)
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape == (HEIGHT, WIDTH, 3)
    return image


def coloured(panel: np.ndarray) -> int:
    """Pixels that are neither gray nor nearly so: curves, paths, boxes."""
    return int((np.ptp(panel.astype(int), axis=2) > 60).sum())


def inked(panel: np.ndarray) -> int:
    return int((panel.min(2) < 128).sum())


def test_a_run_fills_all_four_panels():
    picture = RunPicture()
    for number in range(60):
        picture.note_step(step(number, SEEN))
    image = drawn(picture, [true(number) for number in range(60)])
    assert coloured(image[PANELS["view"]]) > 200  # the box
    assert np.median(image[PANELS["view"]]) == 120  # the camera's picture
    assert coloured(image[PANELS["path"]]) > 500
    assert coloured(image[PANELS["bearing"]]) > 300
    assert coloured(image[PANELS["distance"]]) > 300


@pytest.mark.parametrize(("result", "strongest"), [(SEEN, 1), (LOST, None)])
def test_the_box_is_green_while_tracking_and_not_there_when_lost(result, strongest):
    picture = RunPicture()
    picture.note_step(step(1, result))
    view = drawn(picture, [])[PANELS["view"]]
    line = view[PANEL_H * 150 // 480 - 3 : PANEL_H * 150 // 480 + 3, PANEL_W * 250 // 640].astype(int)
    if strongest is None:
        assert coloured(view) == 0
    else:
        brightest = line[np.argmax(np.ptp(line, axis=1))]
        assert int(np.argmax(brightest)) == strongest
        assert np.ptp(brightest) > 60


def test_without_truth_the_path_is_unknown_and_the_curves_are_what_was_seen():
    picture = RunPicture()
    for number in range(30):
        picture.note_step(step(number, SEEN))
    image = drawn(picture, [])
    assert coloured(image[PANELS["path"]]) == 0
    assert inked(image[PANELS["path"]]) > 200  # a sentence says so
    assert coloured(image[PANELS["distance"]]) > 300


def test_a_run_without_a_frame_is_said_to_be_one():
    image = drawn(RunPicture(), [])
    for panel in PANELS.values():
        assert inked(image[panel]) > 100
        assert coloured(image[panel]) == 0


@pytest.mark.parametrize("size", [(320, 240), (640, 64), (32, 600), (1280, 960)])
def test_a_frame_of_any_shape_fits_into_its_panel(size):
    picture = RunPicture()
    picture.note_step(step(1, LOST, size))
    view = drawn(picture, [])[PANELS["view"]]
    scale = min(PANEL_W / size[0], PANEL_H / size[1])
    shown = int((np.abs(view.astype(int) - 120).max(2) <= 2).sum())
    assert shown > 0.5 * size[0] * size[1] * scale**2 * (1 - 26 / (size[1] * scale))


def test_a_robot_that_stands_is_drawn_too():
    picture = RunPicture()
    picture.note_step(step(1, SEEN))
    image = drawn(picture, [true(0)] * 5)
    assert coloured(image[PANELS["path"]]) > 50
