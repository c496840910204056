"""The summary of a run: how often the target was tracked, how well the robot saw and followed it, what it cost.

The truth comes from the simulator's telemetry and is used here only, after the fact. Without it those fields are None.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from base_station.evaluation import drive_errors, pose_errors
from base_station.evaluation.true_rows import Reading, TrueRow, TrueRows
from base_station.station import Step
from base_station.trackers.base import Survey
from base_station.types import TrackerResult, TrackingState
from protocol import Telemetry, Truth

SETTLING_S = 5.0
"""The first seconds do not count for the errors: the robot has yet to get there."""
FINAL_S = 1.0
SETTLED_DISTANCE_M, SETTLED_BEARING_DEG = 0.01, 0.5
SET_DOWN_M = 0.2
"""A robot that moves further than this between two frames was carried."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """One run. Errors in degrees, metres or relative to the learned range; None where it does not apply."""

    scenario: str | None
    tracker: str
    behaviour: str
    seed: int | None
    rhythm: str | None
    duration_s: float
    frames: int
    frames_tracked: int
    """In state TRACKING, of all frames since the target was learned; needs no truth."""
    shadow_frames_tracked: int | None
    frames_dropped: int | None
    """By the agent, because the station was slow."""
    frame_bytes_per_s: float | None
    """Of the frames looked at, by the frames' time."""
    loop_hz: float | None
    tracker_ms_p50: float | None
    frame_to_command_ms_p50: float | None
    frame_to_command_ms_p95: float | None
    agent_cpu_s: float | None
    station_cpu_s: float
    tracking_share: float | None
    """Frames in state TRACKING of those after learning with the picture in view."""
    shadow_tracker: str | None
    shadow_tracking_share: float | None
    shadow_bearing_estimate_error_deg_rms: float | None
    """The second tracker, which saw the same frames."""
    bearing_error_deg_rms: float | None
    """True bearing of the picture's centre from the robot's heading: how well it follows. The heading is the optical
    axis of a fixed camera."""
    bearing_estimate_error_deg_rms: float | None
    """Reported (the pan as the robot knows it, plus the bearing seen) against true bearing: how well it sees."""
    camera_error_deg_rms: float | None
    """With a pan-tilt: true bearing less pan, that is from the optical axis. How well the camera follows."""
    distance_error_rel_rms: float | None
    final_distance_error_m: float | None
    final_bearing_error_deg: float | None
    final_lateral_error_m: float | None
    """Aside of where the target was learned, in the target's coordinates; None unless the target stands."""
    final_heading_error_deg: float | None
    view_angle_estimate_error_deg_rms: float | None
    range_estimate_error_rel_rms: float | None
    """Reported against true distance, where the scale is known."""
    compass_error_deg_rms: float | None
    """Heading since learning as the tracker's compass has it, against the true one; in all states."""
    compass_error_without_pose_deg_rms: float | None
    """The same, of the frames without `cam_from_world`."""
    compass_share: float | None
    """Of the frames since learning, those in which the compass knew the heading; None for a tracker without one."""
    path_m: float | None
    """Truly driven since learning."""
    laps: int | None
    """Driven to their end, with behaviour route."""
    loops_closed: int | None
    """By a tracker that maps (so are the next ones): returns to a mapped place that were recognised and tied to it."""
    loops_confirmed: int | None
    """Those of them that the map had right already: no error was left to spread. The others corrected the map."""
    loops_at_m: list[float] | None
    """Truly driven when each loop was closed."""
    keyframes: int | None
    maps: int | None
    trajectory_share: float | None
    """Of the frames since learning, those with a pose in the largest map."""
    ate_rmse_m: float | None
    """Absolute trajectory error, as corrected at the end, after the similarity that fits best."""
    ate_share_of_path: float | None
    settled_s: float | None
    """From learning (or from when the robot was set down) until within 1 cm and 0.5 degrees for good."""
    lost_said_after_s: float | None
    """From the target's last frame in view to the first LOST, when it was out of view at the end."""
    lost_reason: str | None
    collisions: int | None

    def as_dict(self) -> dict[str, object]:
        return asdict(self)


class LoopLog:
    """Collects steps and telemetry while a run goes on (from two threads), and sums them up.

    Of a frame are kept two times, and in a simulation its row.
    """

    def __init__(self, *, tracker: str, behaviour: str, shadow: str | None = None, from_memory: bool = False) -> None:
        """`from_memory`: what is followed was learned before this run, so nothing tells from where."""
        self._tracker, self._behaviour, self._shadow = tracker, behaviour, shadow
        self._from_memory = from_memory
        self._lock = threading.Lock()
        self._rows = TrueRows()
        self._frames = self._tracked = self._shadow_tracked = 0
        self._first_time_s: float | None = None
        self._last_time_s = 0.0
        self._learned_at: int | None = None
        self._tracker_s, self._delays_s = array("d"), array("d")
        self._first_wall_s = self._last_wall_s = 0.0
        self._frame_bytes = 0
        self._dropped: int | None = None
        self._first_telemetry: Telemetry | None = None
        self._last_telemetry: Telemetry | None = None
        self._cpu_zero_s = time.process_time()
        self._survey: Survey | None = None
        self.laps: int | None = None
        """Driven, if laps are what the behaviour drives."""

    def note_survey(self, survey: Survey | None) -> None:
        """What the tracker mapped, after the run."""
        self._survey = survey

    def note_telemetry(self, telemetry: Telemetry) -> None:
        """Keep the truth of the frame that the message stamps."""
        with self._lock:
            if self._first_telemetry is None:
                self._first_telemetry = telemetry
            self._last_telemetry = telemetry
            stamp = telemetry.frame
            if stamp is not None:
                self._dropped = stamp.dropped
            if telemetry.truth is not None and stamp is not None and telemetry.station is not None:
                self._rows.note_truth((telemetry.station, stamp.number), telemetry.truth)

    def note_step(self, step: Step) -> None:
        """Keep what matters of a step; not its picture."""
        now_s = time.monotonic()
        if self._first_time_s is None:
            self._cpu_zero_s = time.process_time()
            self._first_time_s, self._first_wall_s = step.frame.time_s, now_s
        self._last_time_s, self._last_wall_s = step.frame.time_s, now_s
        self._frames += 1
        self._frame_bytes += step.frame.image.size
        with self._lock:
            if step.learned and self._learned_at is None:
                self._learned_at = self._rows.seen
            key = (step.frame.connection, step.frame.number)
            self._rows.note_frame(key, step.frame.time_s, step.result, step.shadow, step.pan_rad)
        if self.learned:
            self._tracked += _is_tracking(step.result)
            self._shadow_tracked += _is_tracking(step.shadow)
        if step.learned:
            return  # learning is no tracking, its time would hide that of the frames
        self._tracker_s.append(step.tracker_s)
        if step.frame_to_command_s is not None:
            self._delays_s.append(step.frame_to_command_s)

    def wait_for_truth(self, timeout_s: float = 0.5) -> None:
        """Telemetry may come after its frame: wait for that of the last one."""
        deadline_s = time.monotonic() + timeout_s
        while not self._rows.complete:
            if time.monotonic() > deadline_s:
                return
            time.sleep(0.005)

    @property
    def learned(self) -> bool:
        """Whether a target was ever learned."""
        return self._learned_at is not None

    def truths(self) -> list[tuple[float, Truth]]:
        """(time in s since the first frame, truth) of the frames seen, for plots."""
        with self._lock:
            zero_s = self._first_time_s or 0.0
            return [(row.time_s - zero_s, row.truth) for row in self._rows.rows()]

    def summary(self, *, scenario: str | None, seed: int | None, rhythm: str | None) -> Summary:
        """Sum up. Call after the run."""
        with self._lock:
            rows = [] if self._learned_at is None else self._rows.rows(self._learned_at)
        knows_where = rows and rows[0].index == self._learned_at and not self._from_memory
        learned = rows[0].truth if knows_where else None
        first, last = self._first_telemetry, self._last_telemetry
        wall_s = self._last_wall_s - self._first_wall_s
        zero_s = self._first_time_s or 0.0
        duration_s = self._last_time_s - zero_s
        settled = [row for row in rows if row.time_s - zero_s >= SETTLING_S]
        final = [row for row in rows if row.time_s > rows[-1].time_s - FINAL_S]
        learned_range_m = learned.range_m if learned is not None else None
        said_s, reason = _lost_said(rows)
        return Summary(
            scenario=scenario,
            tracker=self._tracker,
            behaviour=self._behaviour,
            seed=seed,
            rhythm=rhythm,
            duration_s=_rounded(duration_s) or 0.0,
            frames=self._frames,
            frames_tracked=self._tracked,
            shadow_frames_tracked=self._shadow_tracked if self._shadow else None,
            frames_dropped=self._dropped,
            frame_bytes_per_s=_rounded(self._frame_bytes / duration_s) if duration_s > 0 else None,
            loop_hz=_rounded((self._frames - 1) / wall_s) if wall_s > 0 else None,
            tracker_ms_p50=_quantile_ms(self._tracker_s, 50),
            frame_to_command_ms_p50=_quantile_ms(self._delays_s, 50),
            frame_to_command_ms_p95=_quantile_ms(self._delays_s, 95),
            agent_cpu_s=_rounded(last.cpu_s - first.cpu_s) if first is not None and last is not None else None,
            station_cpu_s=_rounded(time.process_time() - self._cpu_zero_s) or 0.0,
            tracking_share=_tracking_share(rows, _steering),
            shadow_tracker=self._shadow,
            shadow_tracking_share=_tracking_share(rows, _shadow),
            shadow_bearing_estimate_error_deg_rms=_rms(_estimate_errors_deg(settled, _shadow)),
            bearing_error_deg_rms=_rms(_true_bearings_deg(settled)) if learned_range_m else None,
            bearing_estimate_error_deg_rms=_rms(_estimate_errors_deg(settled, _steering)),
            camera_error_deg_rms=_rms(_camera_errors_deg(settled)),
            distance_error_rel_rms=_rms(_distance_errors(settled, learned_range_m)),
            final_distance_error_m=_mean_abs(_distance_errors(final, learned_range_m), learned_range_m),
            final_bearing_error_deg=_mean_abs(_true_bearings_deg(final)) if learned_range_m else None,
            final_lateral_error_m=_mean_abs(_against(final, learned, pose_errors.lateral_error_m)),
            final_heading_error_deg=_mean_abs(_against(final, learned, pose_errors.heading_error_rad), math.degrees(1)),
            view_angle_estimate_error_deg_rms=_rms(_view_angle_errors_deg(settled, learned)),
            range_estimate_error_rel_rms=_rms(_range_errors(settled)),
            compass_error_deg_rms=_rms(_compass_errors_deg(rows, learned)),
            compass_error_without_pose_deg_rms=_rms(_compass_errors_deg(rows, learned, without_pose=True)),
            compass_share=_compass_share(rows),
            path_m=_path_m(rows),
            laps=self.laps,
            **drive_errors.mapped(self._survey, [(row.time_s, row.truth) for row in rows], _path_m(rows)),
            settled_s=_settled_s(rows, learned_range_m),
            lost_said_after_s=said_s,
            lost_reason=reason,
            collisions=rows[-1].truth.collisions if rows else None,
        )


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 6)


def _quantile_ms(values_s: Sequence[float], percent: float) -> float | None:
    return _rounded(float(np.percentile(values_s, percent)) * 1e3) if values_s else None


def _rms(values: list[float]) -> float | None:
    return _rounded(math.sqrt(float(np.mean(np.square(values))))) if values else None


def _mean_abs(values: list[float], scale: float | None = 1.0) -> float | None:
    return _rounded(float(np.mean(np.abs(values))) * scale) if values and scale else None


def _is_tracking(result: TrackerResult | None) -> bool:
    return result is not None and result.state is TrackingState.TRACKING


def _steering(row: TrueRow) -> Reading | None:
    return row.shown


def _shadow(row: TrueRow) -> Reading | None:
    return row.shadow


Which = Callable[[TrueRow], Reading | None]
"""Whose result of a row is meant."""


def _tracking_share(rows: list[TrueRow], which: Which) -> float | None:
    results = [which(row) for row in rows if row.truth.in_view]
    tracked = [result.tracking for result in results if result is not None]
    return _rounded(float(np.mean(tracked))) if tracked else None


def _true_bearings_deg(rows: list[TrueRow]) -> list[float]:
    return [math.degrees(row.truth.bearing_rad) for row in rows if row.truth.bearing_rad is not None]


def _estimate_errors_deg(rows: list[TrueRow], which: Which) -> list[float]:
    """What is seen is measured from the optical axis, the truth from the robot's heading: the pan lies between."""
    seen = [(row, result.bearing_rad) for row in rows if (result := which(row)) is not None]
    return [
        math.degrees(math.remainder((row.pan_rad or 0.0) + bearing - row.truth.bearing_rad, 2 * math.pi))
        for row, bearing in seen
        if bearing is not None and row.truth.bearing_rad is not None
    ]


def _camera_errors_deg(rows: list[TrueRow]) -> list[float]:
    return [
        math.degrees(math.remainder(row.truth.bearing_rad - row.pan_rad, 2 * math.pi))
        for row in rows
        if row.pan_rad is not None and row.truth.bearing_rad is not None
    ]


def _distance_errors(rows: list[TrueRow], learned_range_m: float | None) -> list[float]:
    """Relative to the learned range."""
    if not learned_range_m:
        return []
    return [row.truth.range_m / learned_range_m - 1.0 for row in rows if row.truth.range_m is not None]


def _against(rows: list[TrueRow], learned: Truth | None, error: Callable[[Truth, Truth], float | None]) -> list[float]:
    errors = [error(row.truth, learned) for row in rows] if learned is not None else []
    return [value for value in errors if value is not None]


def _view_angle_errors_deg(rows: list[TrueRow], learned: Truth | None) -> list[float]:
    if learned is None:
        return []
    pairs = [(row.shown.view_angle_rad, pose_errors.view_angle_rad(row.truth, learned)) for row in rows]
    return [math.degrees(seen - true) for seen, true in pairs if seen is not None and true is not None]


def _compass_errors_deg(rows: list[TrueRow], learned: Truth | None, *, without_pose: bool = False) -> list[float]:
    if learned is None:
        return []
    return [
        math.degrees(math.remainder(seen.compass_rad + row.truth.robot[2] - learned.robot[2], 2 * math.pi))
        for row in rows
        if (seen := row.shown).compass_rad is not None and not (without_pose and seen.posed)
    ]


def _compass_share(rows: list[TrueRow]) -> float | None:
    known = [row.shown.compass_rad is not None for row in rows]
    return _rounded(float(np.mean(known))) if any(known) else None


def _path_m(rows: list[TrueRow]) -> float | None:
    """Of the robot; where it was carried does not count."""
    steps = [math.dist(a.truth.robot[:2], b.truth.robot[:2]) for a, b in itertools.pairwise(rows)]
    return _rounded(sum(step for step in steps if step <= SET_DOWN_M)) if steps else None


def _range_errors(rows: list[TrueRow]) -> list[float]:
    pairs = [(row.shown.range_m, row.truth.range_m) for row in rows]
    return [seen / true - 1 for seen, true in pairs if seen is not None and true]


def _settled_s(rows: list[TrueRow], learned_range_m: float | None) -> float | None:
    if not learned_range_m or not rows:
        return None
    begin_s, since_s = rows[0].time_s, None
    for before, row in zip([rows[0], *rows], rows, strict=False):
        moved_m = math.dist(before.truth.robot[:2], row.truth.robot[:2])
        if moved_m > SET_DOWN_M:
            begin_s, since_s = row.time_s, None
        if row.truth.range_m is None or row.truth.bearing_rad is None:
            return None
        there = (
            abs(row.truth.range_m - learned_range_m) <= SETTLED_DISTANCE_M
            and abs(math.degrees(row.truth.bearing_rad)) <= SETTLED_BEARING_DEG
        )
        since_s = (row.time_s if since_s is None else since_s) if there else None
    return _rounded(since_s - begin_s) if since_s is not None else None


def _lost_said(rows: list[TrueRow]) -> tuple[float | None, str | None]:
    """How long after the target left for good LOST was said, and with which reason."""
    last_seen = max((i for i, row in enumerate(rows) if row.truth.in_view), default=None)
    if last_seen is None or last_seen == len(rows) - 1:
        return None, None
    lost = next((row for row in rows[last_seen + 1 :] if not row.shown.tracking), None)
    if lost is None:
        return None, None
    return _rounded(lost.time_s - rows[last_seen].time_s), lost.shown.reason
