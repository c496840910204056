"""Folders and videos are replayed as recordings are: what is learned, what is true, at which rate, how it is told."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from base_station.errors import StationError
from base_station.orders import Order
from base_station.recording.agreement import agreement, difference
from base_station.recording.planning import kits_of
from base_station.recording.poses import ROBOT_FROM_CAMERA, inverse, world_from_camera
from base_station.recording.replay import Replayed, ReplayPlan, replay
from base_station.recording.series import Series, figures
from base_station.recording.sources import Known, SourceFrame, TargetTruth, open_source
from base_station.trackers.registry import make_tracker
from base_station.types import Box, TrackerResult, TrackingState
from base_station.watcher import Kit
from tests.helpers import numbered_picture, write_pictures

TRACKED = TrackerResult(state=TrackingState.TRACKING, bearing_rad=0.1, zoom=2.0, shift_px=3.0, confidence=0.5)
LOST = TrackerResult(state=TrackingState.LOST, reason="gone")


@pytest.fixture
def otb(tmp_path: Path) -> Path:
    """A scene that moves a pixel to the right with each of 12 pictures; the box moves with it."""
    folder = write_pictures(tmp_path / "otb" / "img", 12, 320, 240).parent
    boxes = [f"{100 + number},60,120,100" for number in range(12)]
    (folder / "groundtruth_rect.txt").write_text("\n".join(boxes) + "\n")
    return folder


def kit(name: str) -> Kit:
    return Kit(name=name, tracker=make_tracker(name))


def run(path: Path, tracker: str = "phase", **options: object) -> tuple[list[Replayed], Known]:
    source = open_source(path, **options)  # type: ignore[arg-type]
    return list(replay(source, ReplayPlan(tracker=tracker), kit)), source.known()


def test_the_first_true_box_is_learned_and_the_truth_is_what_the_tracker_sees(otb: Path):
    steps, known = run(otb)
    assert len(steps) == len(known.truth) == 12
    assert steps[0].step.orders == (Order.learn(Box(100, 60, 120, 100)),)
    for replayed in steps:
        truth, result = known.truth[replayed.place], replayed.step.result
        assert result.shift_px == pytest.approx(truth.shift_px, abs=0.3)
        assert result.bearing_rad == pytest.approx(truth.bearing_rad, abs=0.002)
        assert truth.zoom == 1.0
    assert [replayed.step.frame.time_s for replayed in steps[:3]] == [0, 1 / 30, 2 / 30]


def test_shrunk_pictures_have_a_shrunk_box_and_truth(otb: Path):
    steps, known = run(otb, width=160)
    assert steps[0].step.frame.image.shape == (120, 160)
    assert steps[0].step.orders == (Order.learn(Box(50, 30, 60, 50)),)
    assert known.truth[11].shift_px == pytest.approx(5.5)
    assert steps[11].step.result.shift_px == pytest.approx(5.5, abs=0.3)


def test_a_target_of_ones_own_is_learned_and_there_is_no_truth(otb: Path):
    steps, known = run(otb, target=Box(20, 30, 90, 90))
    assert steps[0].step.orders == (Order.learn(Box(20, 30, 90, 90)),)
    assert known.truth == {}


def test_a_gap_in_the_pictures_leaves_no_truth_to_tell(otb: Path):
    missing = sorted((otb / "img").iterdir())[5]
    missing.unlink()
    with pytest.raises(StationError, match="which box belongs to which picture cannot be told"):
        open_source(otb)
    assert len(run(otb, target=Box(100, 60, 120, 100))[0]) == 11


def test_a_box_that_is_none_is_no_truth(otb: Path):
    lines = (otb / "groundtruth_rect.txt").read_text().splitlines()
    lines[3], lines[7] = "1e300,60,120,100", "nan,nan,nan,nan"
    (otb / "groundtruth_rect.txt").write_text("\n".join(lines))
    known = run(otb)[1]
    assert sorted(set(range(12)) - set(known.truth)) == [3, 7]
    assert known.notes == ["2 of 12 true boxes are none, and their pictures are not compared"]
    (otb / "groundtruth_rect.txt").write_text("")
    with pytest.raises(StationError, match="first line is no box"):
        run(otb)


def test_plain_pictures_are_a_place_to_learn(tmp_path: Path):
    steps, known = run(write_pictures(tmp_path / "plain", 5))
    assert steps[0].step.orders == (Order.learn(None),)
    assert all(replayed.step.result.state is TrackingState.TRACKING for replayed in steps)
    assert known.notes == []


def test_pictures_that_cannot_be_read_are_passed_over_and_counted(tmp_path: Path):
    folder = write_pictures(tmp_path / "plain", 6)
    (folder / "00001.png").write_bytes(b"no picture")
    assert cv2.imwrite(str(folder / "00004.png"), numbered_picture(4, 80, 60))
    steps, known = run(folder)
    assert [replayed.place for replayed in steps] == [1, 2, 4, 5]
    assert steps[0].step.learned, "what was ordered with the missing picture is not forgotten"
    assert "2 pictures cannot be read or differ in size; the first: 00001.png" in known.notes[0]
    for path in folder.iterdir():
        path.write_bytes(b"")
    with pytest.raises(StationError, match="none of the 6 pictures"):
        run(folder)


def test_a_slam_sequence_keeps_its_times_and_camera(tmp_path: Path):
    folder = tmp_path / "tum"
    write_pictures(folder / "rgb", 4, 160, 120)
    lines = [f"{100 + number * 0.05:.3f} rgb/{number:05d}.png" for number in range(1, 5)]
    (folder / "rgb.txt").write_text("\n".join(lines))
    names = {"fx": 150.0, "fy": 151.0, "cx": 79.0, "cy": 61.0}
    (folder / "camera.yaml").write_text("".join(f"Camera.{name}: {value}\n" for name, value in names.items()))
    steps, _ = run(folder)
    camera = steps[0].step.frame.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == tuple(names.values())
    assert [replayed.step.frame.time_s for replayed in steps] == pytest.approx([100.05, 100.1, 100.15, 100.2])


def test_the_rate_is_kept_and_a_late_frame_is_not_waited_for(otb: Path):
    now_s, slept = [50.0], []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now_s[0] += seconds

    source = open_source(otb)
    for number, _ in enumerate(
        replay(source, ReplayPlan(tracker="phase"), kit, speed=2.0, clock=lambda: now_s[0], sleep=sleep)
    ):
        if number == 4:
            now_s[0] += 3.5 / 60  # slow for three frames and a half
    assert slept[:4] == pytest.approx([1 / 60] * 4)
    assert len(slept) == 11 - 3
    assert slept[4] == pytest.approx(0.5 / 60)


class Operated:
    """Frames in memory with orders of an operator."""

    name = "operated"

    def __init__(self, orders: dict[int, tuple[Order, ...]]) -> None:
        self._orders = orders

    def __iter__(self) -> Iterator[SourceFrame]:
        from tests.base_station.recording.test_recording_files import a_step

        for number in range(1, 21):
            frame = a_step(number).frame
            yield SourceFrame(frame=None if number == 5 else frame, orders=self._orders.get(number, ()))

    def known(self) -> Known:
        return Known()


def test_orders_take_effect_at_their_frames_unless_the_plan_keeps_its_tracker():
    box = Box(40, 30, 60, 50)
    orders = {
        1: (Order.learn(box),),
        5: (Order(kind="shadow", name="z-shift"),),
        10: (Order(kind="tracker", name="ncc"), Order(kind="stop")),
        15: (Order(kind="shadow"), Order.learn(None)),
    }
    plain = list(replay(Operated(orders), ReplayPlan(tracker="phase"), kit))
    names = {one.step.frame.number: (one.step.tracker, one.step.shadow_tracker) for one in plain}
    assert 5 not in names
    assert (names[4], names[6], names[9]) == (("phase", None), ("phase", "z-shift"), ("phase", "z-shift"))
    assert (names[10], names[14], names[15]) == (("ncc", "z-shift"), ("ncc", "z-shift"), ("ncc", None))
    assert [one.step.frame.number for one in plain if one.step.learned] == [1, 10, 15]
    plan = ReplayPlan(tracker="phase", keep_tracker=True, keep_shadow=True)
    kept = list(replay(Operated(orders), plan, kit))
    assert {(one.step.tracker, one.step.shadow_tracker) for one in kept} == {("phase", None)}
    assert [order.kind for one in kept for order in one.step.orders] == ["learn", "stop", "learn"]


def test_an_unknown_tracker_is_a_mistake_of_usage(otb: Path):
    source = open_source(otb)
    with pytest.raises(StationError, match="did you mean") as caught:
        list(replay(source, ReplayPlan(tracker="ztransfrom"), kits_of(source, None)))
    assert caught.value.usage


def test_a_tracker_that_gives_no_result_is_told_without_a_robot(otb: Path, tmp_path: Path):
    own = tmp_path / "none.py"
    own.write_text(
        "class Mine:\n    def learn(self, frame, target): pass\n    def update(self, frame): pass\n"
        "    def close(self): pass\n"
    )
    with pytest.raises(StationError, match=r"Mine\.update returned NoneType, not a TrackerResult") as caught:
        run(otb, f"{own}:Mine")
    assert "robot" not in str(caught.value)


def test_a_tracker_of_ones_own_that_fails_is_named_with_its_line(otb: Path, tmp_path: Path):
    own = tmp_path / "mine.py"
    own.write_text(
        "class Mine:\n"
        "    def learn(self, frame, target): pass\n"
        "    def update(self, frame): return frame.number / 0\n"
        "    def close(self): pass\n"
    )
    with pytest.raises(StationError, match=r"frame 1: ZeroDivisionError: .*\(mine.py, line 3\)"):
        run(otb, tracker=f"{own}:Mine")


def test_a_tracker_that_cannot_be_closed_buries_no_cause(
    otb: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    own = tmp_path / "mine.py"
    own.write_text(
        "class Mine:\n    def learn(self, frame, target): pass\n    def update(self, frame): pass\n"
        "    def close(self): raise OSError('stuck')\n"
    )
    with pytest.raises(StationError, match=r"Mine\.update returned NoneType"):
        run(otb, f"{own}:Mine")
    assert "the tracker did not close cleanly: OSError: stuck (mine.py, line 4)" in caplog.text


def test_agreement_is_told_bit_for_bit_and_in_numbers():
    other = replace(TRACKED, bearing_rad=0.1 + math.radians(0.5), zoom=2.02, shift_px=4.0)
    same = agreement([(TRACKED, TRACKED), (LOST, LOST)])
    assert same.identical and same.first_difference is None
    found = agreement([(TRACKED, TRACKED), (other, TRACKED), (LOST, TRACKED), (LOST, LOST)])
    assert (found.frames, found.same, found.first_difference, found.same_state) == (4, 2, 1, 3)
    assert not found.identical
    assert (found.tracked_now, found.tracked_then) == (2, 3)
    assert found.bearing_deg_max == pytest.approx(0.5)
    assert found.bearing_deg_rms == pytest.approx(0.5 / math.sqrt(2))
    assert found.zoom_percent_rms == pytest.approx(1.0 / math.sqrt(2))
    assert found.shift_px_rms == pytest.approx(1 / math.sqrt(2))
    assert found.difference == "shift_px 4.0 instead of 3.0"
    assert not agreement([]).identical


def test_a_pose_that_differs_in_its_last_bit_is_no_same():
    pose = np.eye(4)
    nearly = pose.copy()
    nearly[0, 3] = 5e-324
    one, other = (replace(TRACKED, cam_from_world=matrix) for matrix in (pose, nearly))
    assert difference(one, replace(TRACKED, cam_from_world=np.eye(4))) == ""
    assert difference(one, other).startswith("cam_from_world")
    assert difference(one, TRACKED).startswith("cam_from_world")


def test_figures_count_from_the_learning_and_know_the_spans_of_lost():
    series = Series(name="mine")
    blind = TrackerResult(state=TrackingState.INITIALIZING, reason="nothing learned yet")
    for number, result in enumerate([blind, blind, TRACKED, LOST, LOST, TRACKED, TRACKED, LOST]):
        series.add(number, number * 0.1, result, seconds=0.001 * number, learned=number == 2)
    truth = {number: TargetTruth(bearing_rad=0.1 - math.radians(1), zoom=1.6) for number in range(8)}
    found = figures(series, truth, "truth")
    assert found.tracked_share == pytest.approx(3 / 6)
    assert (found.lost_frames, found.lost_spans) == (3, 2)
    assert found.longest_lost_s == pytest.approx(0.2)
    assert found.bearing_error_deg_rms == pytest.approx(1)
    assert found.zoom_error_percent_rms == pytest.approx(25)
    assert found.compared_frames == 3
    assert found.ms_p50 == pytest.approx(3.5)


def test_poses_of_the_camera_look_along_the_heading():
    pose = world_from_camera(1.0, 2.0, math.pi / 2, -math.pi / 2)
    assert pose[:3, 2] == pytest.approx([1, 0, 0])  # ahead, after panning back
    assert pose[:3, 1] == pytest.approx([0, 0, -1])  # down
    assert pose[:3, 0] == pytest.approx([0, -1, 0])  # right
    assert np.linalg.det(ROBOT_FROM_CAMERA) == pytest.approx(1)
    assert inverse(pose) @ pose == pytest.approx(np.eye(4))
