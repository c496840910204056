"""When a frame was taken: capture times brought to the station's clock, arrival times without telemetry."""

from __future__ import annotations

import itertools
import random
import threading
import time

import pytest

from base_station.frame_clock import KEPT, OFFSET_WINDOW, FrameClock


def key(number: int) -> tuple[str, int]:
    return ("127.0.0.1:5000", number)


def test_without_telemetry_a_frame_was_taken_when_it_arrived():
    clock = FrameClock()
    assert clock.time_s(key(1), 7.25) == 7.25


def test_the_smallest_delay_sets_the_offset_so_jitter_on_the_way_does_not_reach_the_times():
    """Frames taken every 1/30 s on a clock 1000 s behind, 5 ms on the way and up to 40 ms more by chance."""
    rng = random.Random(1)
    clock, times_s = FrameClock(), []
    for number in range(1, 200):
        capture_s = number / 30
        arrival_s = 1000.0 + capture_s + 0.005 + (0.0 if number == 5 else rng.uniform(0.001, 0.040))
        clock.note(key(number), capture_s)
        times_s.append(clock.time_s(key(number), arrival_s))
    steps_s = [after - before for before, after in itertools.pairwise(times_s[5:])]
    assert min(steps_s) == pytest.approx(1 / 30, abs=1e-9)
    assert max(steps_s) == pytest.approx(1 / 30, abs=1e-9)
    assert times_s[-1] == pytest.approx(1000.005 + 199 / 30, abs=1e-9)


def test_clocks_that_drift_apart_are_followed_within_the_window():
    """The agent's clock loses 1 ms a second: after a minute the times are still those of this clock."""
    clock, time_s = FrameClock(), 0.0
    frames = 6 * OFFSET_WINDOW
    for number in range(1, frames + 1):
        taken_s = number / 30
        clock.note(key(number), taken_s * 0.999)
        time_s = clock.time_s(key(number), taken_s + 0.004)
    assert time_s == pytest.approx(frames / 30 + 0.004, abs=OFFSET_WINDOW / 30 * 0.001 + 1e-6)
    assert time_s <= frames / 30 + 0.004


def test_time_never_runs_backwards():
    clock = FrameClock()
    clock.note(key(1), 5.0)
    clock.note(key(2), 5.1)
    assert clock.time_s(key(1), 105.5) == 105.5
    second_s = clock.time_s(key(2), 105.11)  # this one came faster, so the first one's time was 0.49 s late
    assert second_s == pytest.approx(105.55)
    assert clock.time_s(key(3), 50.0) == second_s


def test_times_that_were_late_are_caught_up_with_and_do_not_stand_still():
    """The first frame takes 0.5 s longer than the others: they would have its time for half a second."""
    clock, times_s = FrameClock(), []
    for number in range(1, 61):
        capture_s = number / 30
        clock.note(key(number), capture_s)
        times_s.append(clock.time_s(key(number), 100.0 + capture_s + (0.505 if number == 1 else 0.005)))
    steps_s = [after - before for before, after in itertools.pairwise(times_s)]
    assert min(steps_s) == pytest.approx(1 / 60, abs=1e-9)
    assert times_s[32:] == pytest.approx([100.005 + number / 30 for number in range(33, 61)])


def test_late_telemetry_of_one_frame_leaves_the_times_even_on_a_path_that_became_slower():
    clock, times_s = FrameClock(), []
    for number in range(1, 13):
        capture_s = number / 30
        if number != 5:
            clock.note(key(number), capture_s)
        times_s.append(clock.time_s(key(number), 100.0 + capture_s + (0.005 if number < 4 else 0.2)))
    steps_s = [after - before for before, after in itertools.pairwise(times_s)]
    assert steps_s == pytest.approx([1 / 30] * 11)


def test_a_frame_whose_telemetry_was_lost_gets_its_arrival_time_and_the_next_one_its_capture_time():
    clock = FrameClock()
    clock.note(key(1), 1.0)
    clock.note(key(3), 1.2)
    assert clock.time_s(key(1), 101.0) == 101.0
    assert clock.time_s(key(2), 101.15) == 101.15
    assert clock.time_s(key(3), 101.25) == pytest.approx(101.2)


def test_the_same_number_of_another_connection_is_another_frame():
    clock = FrameClock()
    clock.note(("127.0.0.1:5001", 1), 1.0)
    assert clock.time_s(("127.0.0.1:5000", 1), 50.0) == 50.0


PERIOD_S = 1 / 30


def lockstep_clock(wait_s: float = 0.0) -> FrameClock:
    clock = FrameClock()
    clock.begin(stepped_period_s=PERIOD_S, wait_s=wait_s)
    return clock


def test_in_lockstep_the_agents_own_times_count():
    clock = lockstep_clock()
    clock.note(key(1), 0.1)
    clock.note(key(2), 0.1333)
    assert clock.time_s(key(1), 5000.0) == 0.1
    assert clock.time_s(key(2), 5009.0) == 0.1333


def test_in_lockstep_a_frame_waits_for_its_telemetry():
    clock = lockstep_clock(wait_s=5.0)
    threading.Timer(0.05, clock.note, (key(1), 0.1)).start()
    begun_s = time.monotonic()
    assert clock.time_s(key(1), 5000.0) == 0.1
    assert 0.03 < time.monotonic() - begun_s < 2.0


def test_the_wait_has_an_end_and_a_frame_without_telemetry_is_a_period_after_the_one_before():
    """Never the arrival time, which is on another clock: time would then stand still for the rest of the run."""
    clock = lockstep_clock(wait_s=0.05)
    clock.note(key(1), 3.0)
    assert clock.time_s(key(1), 90000.0) == 3.0
    begun_s = time.monotonic()
    assert clock.time_s(key(2), 90000.1) == pytest.approx(3.0 + PERIOD_S)
    assert 0.045 < time.monotonic() - begun_s < 2.0
    clock.note(key(3), 3.0 + 2 * PERIOD_S)
    assert clock.time_s(key(3), 90000.2) == pytest.approx(3.0 + 2 * PERIOD_S)


def test_in_lockstep_time_goes_on_when_an_agent_starts_again_with_its_clock_at_zero():
    clock = lockstep_clock()
    clock.note(("first", 1), 1000.0)
    clock.note(("second", 1), 0.5)
    clock.note(("second", 2), 0.5 + PERIOD_S)
    assert clock.time_s(("first", 1), 1.0) == 1000.0
    clock.begin(stepped_period_s=PERIOD_S)
    assert clock.time_s(("second", 1), 2.0) == pytest.approx(1000.0 + PERIOD_S)
    assert clock.time_s(("second", 2), 2.1) == pytest.approx(1000.0 + 2 * PERIOD_S)


def test_captures_that_no_frame_asks_for_are_forgotten_oldest_first():
    clock = FrameClock()
    for number in range(KEPT + 1):
        clock.note(key(number), float(number))
    assert clock.time_s(key(0), 50.0) == 50.0, "forgotten: the arrival time"
    assert clock.time_s(key(1), 61.0) == 61.0
    assert clock.time_s(key(2), 99.0) == 62.0, "remembered: the capture time, brought to this clock"
