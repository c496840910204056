"""The summary's figures, on made-up runs whose answers are known."""

from __future__ import annotations

import dataclasses
import math
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from base_station.evaluation.closed_loop import LoopLog, Summary
from base_station.geometry import PinholeCamera
from base_station.station import Step
from base_station.types import Frame, TrackerResult, TrackingState
from protocol import STOP, FrameStamp, Telemetry, Truth

CAMERA = PinholeCamera.with_fov(8, 6)
IMAGE = np.zeros((6, 8), np.uint8)
STATION = "127.0.0.1:5000"
LEARNED_M = 0.4


def tracking(bearing_rad: float | None = 0.0) -> TrackerResult:
    return TrackerResult(state=TrackingState.TRACKING, bearing_rad=bearing_rad, zoom=1.0, confidence=1.0)


def lost(reason: str = "out of sight") -> TrackerResult:
    return TrackerResult(state=TrackingState.LOST, reason=reason)


def truth(
    bearing_deg: float | None = 0.0, range_m: float | None = LEARNED_M, in_view: bool = True, x: float = 0.0, **more
) -> Truth:
    bearing_rad = None if bearing_deg is None else math.radians(bearing_deg)
    return Truth(robot=(x, 0.0, 0.0), bearing_rad=bearing_rad, range_m=range_m, in_view=in_view, **more)


def step(number: int, time_s: float, result: TrackerResult, *, learned: bool = False, **costs: float | None) -> Step:
    return Step(
        frame=Frame(image=IMAGE, number=number, time_s=time_s, camera=CAMERA, connection=STATION),
        result=result,
        shadow=None,
        tracker="ztransform",
        behaviour="follow",
        command=STOP,
        pan_rad=costs.get("pan_rad"),
        learned=learned,
        tracker_s=costs.get("tracker_s") or 0.0004,
        frame_to_command_s=costs.get("delay_s", 0.002),
    )


def telemetry(number: int, true: Truth | None, **more) -> Telemetry:
    stamp = FrameStamp(connection=1, number=number, capture_s=0.0, dropped=more.pop("dropped", 0))
    return Telemetry(sequence=number, monotonic_s=0.0, wall_s=0.0, frame=stamp, station=STATION, truth=true, **more)


def summed(log: LoopLog) -> Summary:
    return log.summary(scenario="leader", seed=3, rhythm="free")


def run(
    seconds: float,
    look: Callable[[float], TrackerResult] = lambda time_s: tracking(),
    true: Callable[[float], Truth | None] = lambda time_s: truth(),
    *,
    learned_at: int = 0,
    zero_s: float = 100.0,
) -> Summary:
    """The summary of ten frames a second; `look` and `true` say what the tracker and the simulator say."""
    log = LoopLog(tracker="t", behaviour="b")
    for index in range(round(seconds * 10) + 1):
        time_s = index / 10
        log.note_telemetry(telemetry(index + 1, true(time_s)))
        log.note_step(step(index + 1, zero_s + time_s, look(time_s), learned=index == learned_at))
    return summed(log)


def test_the_names_of_the_run_come_through():
    summary = run(1)
    assert (summary.scenario, summary.tracker, summary.behaviour, summary.seed, summary.rhythm) == (
        "leader", "t", "b", 3, "free",
    )  # fmt: skip
    assert (summary.frames, summary.duration_s) == (11, 1.0)
    assert summary.as_dict()["frames"] == 11
    assert set(summary.as_dict()) == {field.name for field in dataclasses.fields(Summary)}


def test_a_perfect_run_has_no_errors_and_is_settled_at_once():
    summary = run(10)
    assert summary.tracking_share == 1.0
    assert summary.bearing_error_deg_rms == summary.bearing_estimate_error_deg_rms == 0.0
    assert summary.distance_error_rel_rms == summary.final_distance_error_m == 0.0
    assert summary.settled_s == 0.0
    assert (summary.lost_said_after_s, summary.lost_reason) == (None, None)


def test_tracking_share_counts_frames_in_view_only_and_from_learning_on():
    """Frames 0..100: learned at 20; lost in 30..39 while in view; out of view 60..79, lost there as well."""

    def look(time_s: float) -> TrackerResult:
        index = round(time_s * 10)
        return lost() if index < 20 or 30 <= index < 40 or 60 <= index < 80 else tracking()

    summary = run(10, look, lambda time_s: truth(in_view=not 60 <= round(time_s * 10) < 80), learned_at=20)
    assert summary.tracking_share == pytest.approx(51 / 61, abs=1e-6)


def test_errors_are_root_mean_squares_after_the_first_five_seconds():
    """Until 5 s everything is far off; then the bearing is +-3 degrees and the range 10 % too far."""
    summary = run(
        15,
        true=lambda time_s: (
            truth(40.0, 5.0) if time_s < 5 else truth(3.0 * (-1) ** round(time_s * 10), 1.1 * LEARNED_M)
        ),
        look=lambda time_s: tracking(0.0),
    )
    assert summary.bearing_error_deg_rms == pytest.approx(3.0, abs=1e-5)
    assert summary.bearing_estimate_error_deg_rms == pytest.approx(3.0, abs=1e-5)


def test_range_errors_are_relative_to_the_range_at_learning():
    """Learned at 0.4 m in the first frame; later 0.44 m and 0.36 m in turn."""
    summary = run(
        15,
        true=lambda time_s: truth(range_m=LEARNED_M * (1.0 if time_s == 0 else 1.1 if round(time_s * 10) % 2 else 0.9)),
    )
    assert summary.distance_error_rel_rms == pytest.approx(0.1, abs=1e-6)
    assert summary.final_distance_error_m == pytest.approx(0.04, abs=1e-6)


def test_root_mean_square_is_no_mean():
    summary = run(15, true=lambda time_s: truth(4.0 if time_s >= 10 else 0.0))
    assert summary.bearing_error_deg_rms == pytest.approx(4.0 * math.sqrt(51 / 101), abs=1e-5)


def test_how_well_it_sees_is_judged_by_what_it_says_while_it_tracks():
    """Reported 1 degree too far left; the frames in which it is lost do not count."""
    summary = run(
        15,
        look=lambda time_s: lost() if round(time_s) % 2 else tracking(math.radians(6.0)),
        true=lambda time_s: truth(5.0),
    )
    assert summary.bearing_estimate_error_deg_rms == pytest.approx(1.0, abs=1e-5)
    assert summary.bearing_error_deg_rms == pytest.approx(5.0, abs=1e-5)


def test_a_bearing_just_left_of_behind_is_near_one_just_right_of_behind():
    summary = run(15, look=lambda time_s: tracking(math.radians(179.0)), true=lambda time_s: truth(-179.0))
    assert summary.bearing_estimate_error_deg_rms == pytest.approx(2.0, abs=1e-5)


def test_the_end_is_the_mean_size_of_the_errors_of_the_last_second():
    summary = run(
        20,
        true=lambda time_s: truth(9.0, 2.0) if 0 < time_s < 19.05 else truth(-0.5 if time_s else 0.0, LEARNED_M - 0.02),
    )
    assert summary.final_bearing_error_deg == pytest.approx(0.5, abs=1e-5)
    # learned at 0.38 m in the first frame, so the last second is exact
    assert summary.final_distance_error_m == pytest.approx(0.0, abs=1e-9)


def test_settled_is_when_it_came_within_1_cm_and_half_a_degree_for_good():
    """There from 2 s to 3 s, off again, there for good from 6 s."""

    def true(time_s: float) -> Truth:
        if time_s == 0.0:
            return truth(30.0)
        return truth(0.4, LEARNED_M + 0.009) if 2 <= time_s < 3 or time_s >= 6 else truth(0.6, LEARNED_M)

    assert run(10, true=true).settled_s == pytest.approx(6.0)


@pytest.mark.parametrize(("bearing_deg", "off_m"), [(0.51, 0.0), (-0.51, 0.0), (0.0, 0.0101), (0.0, -0.0101)])
def test_just_off_at_the_end_is_not_settled(bearing_deg, off_m):
    summary = run(5, true=lambda time_s: truth(bearing_deg, LEARNED_M + off_m) if time_s > 4.9 else truth())
    assert summary.settled_s is None


def test_settling_is_counted_from_where_the_robot_was_set_down():
    """Learned at the goal, carried away at 2 s, back at the goal at 7 s."""

    def true(time_s: float) -> Truth:
        if time_s < 2:
            return truth()
        return truth(20.0, 1.0, x=-0.5) if time_s < 7 else truth(x=-0.49 + 0.001 * time_s)

    assert run(10, true=true).settled_s == pytest.approx(5.0)


def test_lost_is_timed_from_the_last_frame_in_view():
    summary = run(
        25,
        look=lambda time_s: lost("no resemblance") if time_s >= 20.4 else tracking(),
        true=lambda time_s: truth(in_view=time_s < 20.05),
    )
    assert summary.lost_said_after_s == pytest.approx(0.4)
    assert summary.lost_reason == "no resemblance"


def test_a_target_that_comes_back_into_view_is_not_gone_for_good():
    summary = run(
        10,
        look=lambda time_s: lost() if 4 <= time_s < 6 else tracking(),
        true=lambda time_s: truth(in_view=not 4 <= time_s < 6),
    )
    assert (summary.lost_said_after_s, summary.lost_reason) == (None, None)


def test_a_tracker_that_never_says_lost_has_no_time_for_it():
    assert run(10, true=lambda time_s: truth(in_view=time_s < 5)).lost_said_after_s is None


def test_collisions_are_those_at_the_end():
    assert run(10, true=lambda time_s: truth(collisions=2 if time_s > 5 else 0)).collisions == 2


def test_without_truth_what_needs_it_is_none_and_the_rest_is_there():
    summary = run(10, true=lambda time_s: None)
    for name in (
        "tracking_share", "bearing_error_deg_rms", "bearing_estimate_error_deg_rms", "distance_error_rel_rms",
        "final_distance_error_m", "final_bearing_error_deg", "settled_s", "lost_said_after_s", "collisions",
    ):  # fmt: skip
        assert getattr(summary, name) is None, name
    assert summary.frames == 101
    assert summary.tracker_ms_p50 == pytest.approx(0.4)


def test_a_scene_without_a_picture_has_no_ranges():
    """In `turn` there is a bearing (of the heading at the start) but no range."""
    summary = run(10, look=lambda time_s: tracking(math.radians(1)), true=lambda time_s: truth(2.0, None))
    assert summary.distance_error_rel_rms is None
    assert summary.final_distance_error_m is None
    assert summary.settled_s is None
    assert summary.bearing_estimate_error_deg_rms == pytest.approx(1.0, abs=1e-5)


def test_nothing_learned_and_no_frames_at_all_give_no_figures():
    log = LoopLog(tracker="t", behaviour="b")
    assert (summed(log).frames, summed(log).duration_s, summed(log).loop_hz) == (0, 0.0, None)
    log.note_step(step(1, 0.0, lost()))
    log.note_telemetry(telemetry(1, truth()))
    assert summed(log).tracking_share is None


def test_a_frame_s_truth_is_the_first_told_with_its_number():
    log = LoopLog(tracker="t", behaviour="b")
    log.note_telemetry(telemetry(1, truth(2.0)))
    log.note_telemetry(telemetry(1, truth(8.0)))  # a later message before the next frame: the robot has moved on
    log.note_step(step(1, 50.0, tracking(), learned=True))
    ((time_s, true),) = log.truths()
    assert time_s == 0.0
    assert true.bearing_rad == pytest.approx(math.radians(2.0))


def test_truth_of_another_connection_is_not_taken_for_this_one_s():
    log = LoopLog(tracker="t", behaviour="b")
    log.note_telemetry(dataclasses.replace(telemetry(1, truth()), station="127.0.0.1:6000"))
    log.note_step(step(1, 50.0, tracking(), learned=True))
    assert log.truths() == []


def test_costs_are_quantiles_and_learning_does_not_count_as_tracking():
    log = LoopLog(tracker="t", behaviour="b")
    log.note_step(step(1, 0.0, tracking(), learned=True, tracker_s=9.0, delay_s=9.0))
    for number in range(1, 101):
        log.note_step(step(number + 1, number / 10, tracking(), tracker_s=number * 1e-5, delay_s=number * 1e-4))
    log.note_step(step(102, 11.0, tracking(), tracker_s=50.5e-5, delay_s=None))
    summary = summed(log)
    assert summary.tracker_ms_p50 == pytest.approx(0.505, abs=1e-6)
    assert summary.frame_to_command_ms_p50 == pytest.approx(5.05, abs=1e-6)
    assert summary.frame_to_command_ms_p95 == pytest.approx(9.505, abs=1e-6)


def test_the_agent_s_processor_time_and_drops_come_from_telemetry():
    log = LoopLog(tracker="t", behaviour="b")
    log.note_telemetry(telemetry(1, None, cpu_s=2.0, dropped=0))
    log.note_telemetry(telemetry(2, None, cpu_s=3.5, dropped=7))
    log.note_step(step(1, 0.0, tracking(), learned=True))
    assert (summed(log).agent_cpu_s, summed(log).frames_dropped) == (1.5, 7)


def test_with_a_pan_tilt_the_sum_of_pan_and_bearing_is_compared_with_the_body_s_true_bearing():
    """The camera looks 10 degrees to the left and sees the target 2 degrees right of its axis; the truth is 9."""
    log = LoopLog(tracker="t", behaviour="b")
    for index in range(100):
        log.note_telemetry(telemetry(index + 1, truth(9.0)))
        seen = tracking(math.radians(-2.0))
        log.note_step(step(index + 1, index / 10, seen, learned=index == 0, pan_rad=math.radians(10.0)))
    summary = summed(log)
    assert summary.bearing_error_deg_rms == pytest.approx(9.0, abs=1e-5)
    assert summary.bearing_estimate_error_deg_rms == pytest.approx(1.0, abs=1e-5)
    assert summary.camera_error_deg_rms == pytest.approx(1.0, abs=1e-5)


def test_a_fixed_camera_has_no_error_of_its_own():
    assert run(10).camera_error_deg_rms is None


def test_a_real_robots_log_does_not_grow_with_its_frames():
    """Days without a truth: every frame is counted, and two times are kept of each, besides the last ten seconds."""
    log, result = LoopLog(tracker="t", behaviour="b"), tracking()
    for number in range(1, 1001):
        log.note_telemetry(telemetry(number, None))
        log.note_step(step(number, number / 30, result, learned=number == 1))
    tracemalloc.start()
    try:
        for number in range(1001, 11001):
            log.note_telemetry(telemetry(number, None))
            log.note_step(step(number, number / 30, result))
        grown_bytes, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert 0 < grown_bytes < 10_000 * 40
    summary = summed(log)
    assert (summary.frames, summary.frames_tracked) == (11_000, 11_000)
    assert summary.duration_s == pytest.approx((11_000 - 1) / 30, abs=1e-5)
    assert summary.tracking_share is None
