"""Makes what is published out of the station's steps: plain numbers, over the last two seconds where one is not enough.

Knows no socket. A replay makes the same out of recorded steps, with a `RobotView` that says so.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from base_station.publication.schema import (
    MOST_FEATURES,
    MOST_KEYFRAMES,
    MOST_POINTS,
    Head,
    Map,
    Notice,
    Seen,
    Signature,
    State,
)  # fmt: skip
from base_station.station import Step
from base_station.trackers.base import MapView, Shown, SignatureView
from base_station.types import TrackerResult, TrackingState
from protocol import Hello, Telemetry

WINDOW_S = 2.0
"""Rates and delays are those of so many seconds."""
QUIET_S = 0.5
"""Without frames for so long, nothing is seen any more."""
NOTICES = 8
"""So many are kept for a page that is opened later."""
LONGEST_NOTICE = 500


class RobotView(Protocol):
    """How the robot stands; a `Link` is one."""

    @property
    def state(self) -> str: ...
    @property
    def connected(self) -> bool: ...
    @property
    def telemetry(self) -> Telemetry | None: ...
    @property
    def hello(self) -> Hello | None: ...


@dataclass(frozen=True, kw_only=True)
class Choices:
    """The names that can be ordered."""

    trackers: tuple[str, ...] = ()
    behaviours: tuple[str, ...] = ()
    landmarks: tuple[str, ...] = ()
    tracker: str = ""
    behaviour: str = ""
    """By which the run begins: what is told until the first frame has come."""


class StateMaker:
    """From one thread, the loop's. `choices` and `outcome` are asked for each state."""

    def __init__(
        self,
        robot: RobotView,
        choices: Callable[[], Choices],
        *,
        outcome: Callable[[], str] = lambda: "",
        takes_orders: bool = True,
    ) -> None:
        self._robot, self._choices, self._outcome, self._takes_orders = robot, choices, outcome, takes_orders
        self.over = False
        """See `State.over`."""
        self._step: Step | None = None
        self._last: Step | None = None
        """The last one, however long ago: who steers does not change while no frame comes."""
        self._learned = False
        self._times: deque[tuple[float, float | None, float]] = deque()
        """Of the last steps: when (monotonic s), frame to command, tracker, both in s."""
        self._connection, self._number, self._passed_over = "", 0, 0
        self._pictures = 0
        self._notices: deque[Notice] = deque(maxlen=NOTICES)
        self._noticed = 0

    def note_step(self, step: Step) -> None:
        """A frame was dealt with, just now."""
        now_s = time.monotonic()
        self._step = self._last = step
        self._times.append((now_s, step.frame_to_command_s, step.tracker_s))
        while now_s - self._times[0][0] > WINDOW_S:
            self._times.popleft()
        self._count(step)
        self._learned = self._learned or step.learned
        for text in step.notices:
            self.notice(text)

    def note_wait(self) -> None:
        """No frame came."""
        if self._times and time.monotonic() - self._times[-1][0] > QUIET_S:
            self._step = None
            self._times.clear()

    def notice(self, text: str) -> None:
        """Tell this to a person."""
        self._noticed += 1
        self._notices.append(Notice(number=self._noticed, text=text[:LONGEST_NOTICE]))

    def _count(self, step: Step) -> None:
        """What the loop had no time for. What the robot itself left out has no number."""
        frame = step.frame
        if frame.connection != self._connection:
            self._connection, self._number, self._passed_over = frame.connection, frame.number, 0
        self._passed_over += max(frame.number - self._number - 1, 0)
        self._number = frame.number

    def head(self, step: Step, shown: Shown | None) -> Head:
        """What belongs to this step's picture."""
        self._pictures += 1
        frame, camera = step.frame, step.frame.camera
        rows, columns = frame.shape
        return Head(
            number=self._pictures,
            width=columns,
            height=rows,
            first_row=frame.first_row,
            rows=frame.image.shape[0],
            arrived_s=time.time() - (step.frame_to_command_s or 0.0),
            focal_px=camera.fx,
            center_px=camera.cx,
            seen=seen_of(step.result),
            shadow=seen_of(step.shadow) if step.shadow is not None else None,
            features=_features(shown, columns, rows),
            bands=shown.bands if shown is not None else 0,
        )

    def state(self, signature: SignatureView | None) -> State:
        """How all stands now."""
        step, last, robot, choices = self._step, self._last, self._robot, self._choices()
        hello = robot.hello
        delays_ms = [delay_s * 1e3 for _, delay_s, _ in self._times if delay_s is not None]
        trackers_ms = [tracker_s * 1e3 for _, _, tracker_s in self._times]
        return State(
            link=robot.state,
            connected=robot.connected,
            robot=_words(hello),
            controllable=hello is not None and self._takes_orders,
            telemetry=robot.telemetry if robot.connected or not self._takes_orders else None,
            speed_limit=hello.limits.max_units if hello is not None else 500,
            loop_hz=self._rate_hz(),
            frame_to_command_ms=float(np.median(delays_ms)) if delays_ms else None,
            frame_to_command_p95_ms=float(np.percentile(delays_ms, 95)) if delays_ms else None,
            tracker_ms=float(np.median(trackers_ms)) if trackers_ms else None,
            passed_over=self._passed_over,
            learned=self._learned,
            seen=seen_of(step.result) if step is not None else None,
            shadow=seen_of(step.shadow) if step is not None and step.shadow is not None else None,
            command=(step.command.left, step.command.right) if step is not None else (0, 0),
            pan_rad=step.pan_rad if step is not None else None,
            tracker=last.tracker if last is not None else choices.tracker,
            shadow_tracker=last.shadow_tracker if last is not None else None,
            behaviour=last.behaviour if last is not None else choices.behaviour,
            outcome=self._outcome(),
            trackers=choices.trackers,
            behaviours=choices.behaviours,
            landmarks=choices.landmarks,
            orders=self._takes_orders,
            over=self.over,
            signature=_signature(signature) if step is not None else None,
            notices=tuple(self._notices),
        )

    def _rate_hz(self) -> float:
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / max(self._times[-1][0] - self._times[0][0], 1e-6)


def seen_of(result: TrackerResult) -> Seen:
    """The result as it is published."""
    box = result.box
    return Seen(
        state=result.state.value,
        reason=result.reason,
        shift_px=result.shift_px,
        bearing_rad=result.bearing_rad,
        zoom=result.zoom,
        view_angle_rad=result.view_angle_rad,
        range_m=result.range_m,
        compass_rad=result.compass_rad,
        confidence=result.confidence if result.state is TrackingState.TRACKING else 0.0,
        box=(float(box.x), float(box.y), float(box.width), float(box.height)) if box is not None else None,
    )


def map_of(view: MapView | None, tracker: str = "") -> Map:
    """The map, thinned to what is published: evenly, and the same points each time while it does not grow."""
    if view is None:
        return Map(tracker=tracker)
    points, keyframes = view.points, view.keyframes
    return Map(
        tracker=tracker,
        points=_thinned(points, MOST_POINTS).astype("<f4").tobytes(),
        keyframes=_thinned(keyframes, MOST_KEYFRAMES).astype("<f4").tobytes(),
        camera=tuple(map(float, view.world_from_cam.ravel())) if view.world_from_cam is not None else None,
        keyframe_count=len(keyframes),
        point_count=len(points),
    )


def _thinned(rows: np.ndarray, most: int) -> np.ndarray:
    finite = rows[np.isfinite(rows).all(1)]
    return finite[:: -(-len(finite) // most)] if len(finite) > most else finite


def _features(shown: Shown | None, columns: int, rows: int) -> bytes:
    if shown is None or shown.features_px is None:
        return b""
    return np.clip(shown.features_px[:MOST_FEATURES], 0, (columns - 1, rows - 1)).round().astype("<u2").tobytes()


def _signature(view: SignatureView | None) -> Signature | None:
    if view is None:
        return None
    return Signature(now=view.now.astype("<f4").tobytes(), learned=view.learned.astype("<f4").tobytes())


def _words(hello: Hello | None) -> str:
    if hello is None:
        return ""
    scene = f", {hello.scenario.name}" if hello.scenario is not None else ""
    return f"{hello.robot}{scene}, {hello.width}x{hello.height} at {hello.fps:g}/s"
