"""Runs trackers on the frames of a source as the station would have: the same watcher, the same orders at the same
frames, and no robot.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

import cv2
from threadpoolctl import threadpool_limits

from base_station.errors import StationError
from base_station.orders import Order
from base_station.recording.reader import Recording
from base_station.recording.sources import RecordedRun, Source, SourceFrame
from base_station.station import Step
from base_station.trackers.base import Tracker
from base_station.trackers.own import FAILURES, told
from base_station.types import Frame, TrackerResult
from base_station.watcher import Kit, Sighting, Watcher
from protocol import STOP, Hello, Telemetry

Kits = Callable[[str], Kit]
"""A tracker by its name. Raises ValueError, StationError."""


class ReplayedRobot:
    """How the robot stood when the frame was taken that is replayed now: to whoever shows it, as a `Link` is."""

    def __init__(self, source: Source) -> None:
        self._recording: Recording | None = source.recording if isinstance(source, RecordedRun) else None
        self.state = f"replay of {source.name}"
        self.connected = True
        self.tracker: Tracker | None = None
        """That steers now; None before the first frame."""

    @property
    def telemetry(self) -> Telemetry | None:
        return self._recording.telemetry if self._recording is not None else None

    @property
    def hello(self) -> Hello | None:
        return self._recording.hello if self._recording is not None else None


@dataclass(frozen=True, kw_only=True)
class ReplayPlan:
    """With which trackers to look. Names as `--tracker` has them."""

    tracker: str
    shadow: str | None = None
    keep_tracker: bool = False
    """Whatever tracker was ordered while the run was recorded: look with this one to the end."""
    keep_shadow: bool = False
    target_rows: int | None = None
    """Of the target's box learn no more than so many rows, those in the middle."""


@dataclass(frozen=True, kw_only=True)
class Replayed:
    """One frame of a replay. `place`: in the source, from 0. `tracker`: the one that steered."""

    place: int
    step: Step
    shown: SourceFrame
    tracker: Tracker


def replay(
    source: Source,
    plan: ReplayPlan,
    kits: Kits,
    *,
    speed: float | None = None,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Generator[Replayed, None, None]:
    """Frame by frame. `speed`: 1 is the rate at which the frames were taken, None as fast as it goes.

    Frames without a picture are passed over, but what was ordered with them is done. Raises StationError.
    """
    shadow = _kit(kits, plan.shadow) if plan.shadow is not None else None
    watcher = Watcher(_kit(kits, plan.tracker), shadow=shadow, target_rows=plan.target_rows)
    pace = _Pace(speed, clock, sleep)
    with closing(watcher):
        complaint = ""
        for place, shown in enumerate(source):
            orders = tuple(order for order in shown.orders if _obey(watcher, order, plan, kits))
            if shown.frame is None:
                continue
            pace.wait(shown.frame.time_s)
            seen, shadow_result = _looked(watcher, shown.frame)
            new = watcher.complaint and watcher.complaint != complaint
            notices = (f"cannot learn this target: {watcher.complaint}",) if new else ()
            complaint = watcher.complaint
            recorded = shown.recorded
            step = Step(
                frame=shown.frame,
                result=seen.result,
                shadow=shadow_result,
                command=recorded.command if recorded is not None else STOP,
                pan_rad=recorded.pan_rad if recorded is not None else None,
                learned=seen.learned,
                tracker_s=seen.tracker_s,
                frame_to_command_s=None,
                tracker=watcher.name,
                shadow_tracker=watcher.shadow_name,
                behaviour=recorded.behaviour if recorded is not None else "idle",
                orders=orders,
                notices=notices,
            )
            yield Replayed(place=place, step=step, shown=shown, tracker=watcher.tracker)


def _looked(watcher: Watcher, frame: Frame) -> tuple[Sighting, TrackerResult | None]:
    try:
        seen = watcher.look(frame)
        return seen, watcher.look_in_shadow(frame, seen)
    except StationError:
        raise
    except FAILURES as error:
        raise StationError(f"The tracker failed at frame {frame.number}: {told(error)}.") from error


@contextmanager
def one_thread() -> Iterator[None]:
    """As in the station: small matrices, for which more threads only wait for each other."""
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(1)
        with threadpool_limits(1):
            yield
    finally:
        cv2.setNumThreads(threads)


def _obey(watcher: Watcher, order: Order, plan: ReplayPlan, kits: Kits) -> bool:
    """Whether it is as it was ordered. What moved the robot has no effect on what is seen now."""
    if (plan.keep_tracker and order.kind == "tracker") or (plan.keep_shadow and order.kind == "shadow"):
        return False
    if order.kind == "learn":
        watcher.choose(order.target)
    elif order.kind == "tracker":
        watcher.exchange(_kit(kits, order.name))
    elif order.kind == "shadow":
        watcher.exchange_shadow(_kit(kits, order.name) if order.name else None)
    return True


def _kit(kits: Kits, name: str) -> Kit:
    try:
        return kits(name)
    except ValueError as error:
        raise StationError(str(error), usage=True) from error


class _Pace:
    """Waits until a frame is due."""

    def __init__(self, speed: float | None, clock: Callable[[], float], sleep: Callable[[float], None]) -> None:
        self._speed, self._clock, self._sleep = speed, clock, sleep
        self._began: tuple[float, float] | None = None

    def wait(self, time_s: float) -> None:
        if self._speed is None:
            return
        if self._began is None:
            self._began = self._clock(), time_s
        began_s, first_s = self._began
        early_s = began_s + (time_s - first_s) / self._speed - self._clock()
        if early_s > 0:
            self._sleep(early_s)
