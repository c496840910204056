"""What the station shows in the terminal: a live status line, and a table at the end."""

from __future__ import annotations

import math
import time
from collections import deque

from rich.console import Console
from rich.table import Table
from rich.text import Text

from base_station.evaluation.closed_loop import Summary
from base_station.link import Link
from base_station.live_text import LiveText
from base_station.station import Step
from base_station.types import TrackerResult, TrackingState

REFRESH_S = 0.2
STYLES = {TrackingState.TRACKING: "bold green", TrackingState.LOST: "bold red", TrackingState.INITIALIZING: "yellow"}


class StatusLine(LiveText):
    """Call `step` and `wait` as often as one likes: it draws now and then."""

    def __init__(self, console: Console, link: Link, tracker: str, behaviour: str, hint: str = "") -> None:
        super().__init__(console, REFRESH_S)
        self._link = link
        self._names = _names(tracker, behaviour)
        self._hint = hint
        self._walls_s: deque[float] = deque(maxlen=60)
        self._result: TrackerResult | None = None
        self._shadow: TrackerResult | None = None
        self._pan_rad: float | None = None

    def step(self, step: Step) -> None:
        """A frame was dealt with."""
        self._walls_s.append(time.monotonic())
        self._names = _names(step.tracker, step.behaviour)
        self._result, self._shadow, self._pan_rad = step.result, step.shadow, step.pan_rad
        self._draw()

    def wait(self) -> None:
        """No frame came."""
        self._result = None
        self._draw()

    def _draw(self) -> None:
        self.draw(self._line, lambda: self._line().plain)

    def _line(self) -> Text:
        line = Text(f"{self._names}  ", style="cyan")
        if self._result is None:
            line.append(self._link.state, style="yellow")
        else:
            line.append(f"{self._result.state.value} ", style=STYLES[self._result.state])
            line.append(describe(self._result), style="default")
            if self._pan_rad is not None:
                line.append(f"  pan {math.degrees(self._pan_rad):+6.1f}°", style="default")
            if self._shadow is not None:
                line.append(f"  [shadow {self._shadow.state.value} {describe(self._shadow)}]", style="dim")
        line.append(f"  {self._rate_hz():.1f} Hz", style="default")
        telemetry = self._link.telemetry
        if self._link.connected and telemetry is not None and telemetry.reason:
            line.append(f"  wheels {telemetry.safety}: {telemetry.reason}", style="bold magenta")
        line.append(f"  {self._hint}", style="dim")
        return line

    def _rate_hz(self) -> float:
        if len(self._walls_s) < 2:
            return 0.0
        return (len(self._walls_s) - 1) / max(self._walls_s[-1] - self._walls_s[0], 1e-6)


def _names(tracker: str, behaviour: str) -> str:
    return f"{short_name(tracker)} · {behaviour}"


def short_name(tracker: str) -> str:
    """A tracker's name without the folders of its file."""
    return tracker.rpartition("/")[2]


def describe(result: TrackerResult) -> str:
    """A result in a few words: bearing, zoom, what else is known, and confidence, or why there are none."""
    if result.state is not TrackingState.TRACKING:
        return f"- {result.reason}"
    parts = []
    if result.bearing_rad is not None:
        parts.append(f"bearing {math.degrees(result.bearing_rad):+6.2f}°")
    if result.zoom is not None:
        parts.append(f"zoom {result.zoom:.3f}")
    if result.view_angle_rad is not None:
        parts.append(f"seen at {math.degrees(result.view_angle_rad):+5.1f}°")
    if result.range_m is not None:
        parts.append(f"range {result.range_m:.3f} m")
    parts.append(f"confidence {result.confidence:.2f}")
    return "  ".join(parts)


def summary_table(summary: Summary) -> Table:
    """What a person wants to know after a run; lines that do not apply are left out."""
    table = Table(
        title=f"{short_name(summary.tracker)} · {summary.behaviour} · {summary.duration_s:.1f} s", show_header=False
    )
    lines = (
        ("frames", summary.frames, "{:d}"),
        ("target tracked in", summary.frames_tracked, "{:d} frames"),
        ("shadow: tracked in", summary.shadow_frames_tracked, "{:d} frames"),
        ("loop", summary.loop_hz, "{:.1f} Hz"),
        ("pictures", _megabits(summary.frame_bytes_per_s), "{:.1f} Mbit/s"),
        ("tracker, median", summary.tracker_ms_p50, "{:.3f} ms"),
        ("frame to command, median", summary.frame_to_command_ms_p50, "{:.2f} ms"),
        ("frame to command, 95 %", summary.frame_to_command_ms_p95, "{:.2f} ms"),
        ("tracked while in view", _percent(summary.tracking_share), "{:.1f} %"),
        ("bearing error, RMS", summary.bearing_error_deg_rms, "{:.2f}°"),
        ("bearing estimate error, RMS", summary.bearing_estimate_error_deg_rms, "{:.2f}°"),
        ("camera's bearing error, RMS", summary.camera_error_deg_rms, "{:.2f}°"),
        ("shadow: tracked while in view", _percent(summary.shadow_tracking_share), "{:.1f} %"),
        ("shadow: bearing estimate error, RMS", summary.shadow_bearing_estimate_error_deg_rms, "{:.2f}°"),
        ("distance error, RMS", _percent(summary.distance_error_rel_rms), "{:.2f} %"),
        ("at the end: distance error", summary.final_distance_error_m, "{:.3f} m"),
        ("at the end: bearing error", summary.final_bearing_error_deg, "{:.2f}°"),
        ("at the end: aside", summary.final_lateral_error_m, "{:.3f} m"),
        ("at the end: heading error", summary.final_heading_error_deg, "{:.2f}°"),
        ("view angle estimate error, RMS", summary.view_angle_estimate_error_deg_rms, "{:.2f}°"),
        ("range estimate error, RMS", _percent(summary.range_estimate_error_rel_rms), "{:.2f} %"),
        ("compass error, RMS", summary.compass_error_deg_rms, "{:.2f}°"),
        ("compass error without a pose, RMS", summary.compass_error_without_pose_deg_rms, "{:.2f}°"),
        ("compass knows the heading in", _percent(summary.compass_share), "{:.1f} %"),
        ("laps driven", summary.laps, "{:d}"),
        ("path driven", summary.path_m if summary.laps is not None else None, "{:.2f} m"),
        ("keyframes", summary.keyframes, "{:d}"),
        ("maps", summary.maps, "{:d}"),
        ("loops closed", summary.loops_closed, "{:d}"),
        ("loops confirmed", summary.loops_confirmed, "{:d}"),
        ("frames with a pose in the map", _percent(summary.trajectory_share), "{:.1f} %"),
        ("trajectory error, ATE", summary.ate_rmse_m, "{:.3f} m"),
        ("trajectory error, share of the path", _percent(summary.ate_share_of_path), "{:.2f} %"),
        ("settled after", summary.settled_s, "{:.1f} s"),
        ("LOST said after", summary.lost_said_after_s, "{:.2f} s"),
        ("because", summary.lost_reason, "{}"),
        ("collisions", summary.collisions, "{:d}"),
    )
    for name, value, form in lines:
        if value is not None:
            table.add_row(name, form.format(value))
    return table


def _megabits(bytes_per_s: float | None) -> float | None:
    return None if bytes_per_s is None else bytes_per_s * 8e-6


def _percent(share: float | None) -> float | None:
    return None if share is None else share * 100
