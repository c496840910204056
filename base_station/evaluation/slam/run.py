"""Shows a recorded sequence to a SLAM system, as fast as it can or at the sequence's own rate, and notes what it does.

In real time a picture is shown when it is due. A picture that would come when the next one is there already is dropped,
as a camera of which only the newest picture is read would drop it. Reading the file is not in the times.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from base_station.errors import StationError
from base_station.evaluation.slam.sequence import SlamSequence, read_gray
from base_station.evaluation.slam.trajectory import Trajectory
from base_station.evaluation.slam.trajectory_errors import errors
from base_station.trackers.own import FAILURES, told
from base_station.trackers.slam.sim3 import inverse
from base_station.trackers.slam.types import SlamFrame, SlamStatistics
from base_station.types import TrackingState

WARM_UP_PICTURES = 10
"""Not in the times: what is compiled or loaded when it is first needed."""
GROWTH_PICTURES = 200
"""So many at either end tell whether a picture takes longer as the map grows."""


class Slam(Protocol):
    """What is measured, see `trackers.slam.system.SlamSystem`."""

    def track(self, image: np.ndarray, time_s: float) -> SlamFrame: ...
    def finish(self) -> None: ...
    def trajectory(self) -> list[tuple[float, np.ndarray]]: ...
    def keyframes(self) -> list[tuple[float, np.ndarray]]: ...
    def points(self) -> np.ndarray: ...
    def statistics(self) -> SlamStatistics: ...
    def close(self) -> None: ...


class Outcome(Enum):
    """What became of a picture of the sequence."""

    TRACKING = "TRACKING"
    INITIALIZING = "INITIALIZING"
    LOST = "LOST"
    DROPPED = "DROPPED"
    """It came too late (real time only)."""
    UNREADABLE = "UNREADABLE"
    """There is no such file, or it is no picture."""


OUTCOMES = {
    TrackingState.TRACKING: Outcome.TRACKING,
    TrackingState.INITIALIZING: Outcome.INITIALIZING,
    TrackingState.LOST: Outcome.LOST,
}


@dataclass(frozen=True, kw_only=True)
class PictureOutcome:
    """One picture: what became of it, why it is not tracked, and how long it took (NaN when it was not shown)."""

    time_s: float
    outcome: Outcome
    reason: str = ""
    ms: float = float("nan")
    keyframe: bool = False


@dataclass(frozen=True, kw_only=True)
class SlamRun:
    """`online`: the poses as they were told at once. `trajectory`, `keyframes`, `points`: at the end, in the largest
    map's world."""

    shown: Sequence[PictureOutcome]
    online: Trajectory
    trajectory: Trajectory
    keyframes: Trajectory
    points: np.ndarray
    statistics: SlamStatistics
    finish_s: float
    """Until the mapper had done all its work after the last picture."""
    memory_mib: float | None
    """Of this process and its children at the end; None where the system does not tell."""


def show(
    sequence: SlamSequence,
    slam: Slam,
    *,
    realtime: bool = False,
    on_frame: Callable[[], None] = lambda: None,
    clock: Callable[[], float] = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
) -> SlamRun:
    """Show every picture. The system is not closed. Raises StationError when it fails."""
    due = sequence.times_s - sequence.times_s[0]
    shown: list[PictureOutcome] = []
    online: list[tuple[float, np.ndarray]] = []
    began = clock()
    for number, path in enumerate(sequence.pictures):
        time_s = float(sequence.times_s[number])
        on_frame()
        if realtime and number + 1 < len(due) and clock() - began >= due[number + 1]:
            shown.append(PictureOutcome(time_s=time_s, outcome=Outcome.DROPPED))
            continue
        image = read_gray(path)
        if image is None:
            shown.append(
                PictureOutcome(time_s=time_s, outcome=Outcome.UNREADABLE, reason=f"{path.name} cannot be read")
            )
            continue
        early_s = due[number] - (clock() - began)
        if realtime and early_s > 0:
            sleep(float(early_s))
        before = clock()
        frame = _tracked(slam, image, time_s, path.name)
        ms = (clock() - before) * 1e3
        shown.append(
            PictureOutcome(
                time_s=time_s, outcome=OUTCOMES[frame.state], reason=frame.reason, ms=ms, keyframe=frame.keyframe
            )
        )  # fmt: skip
        if frame.cam_from_world is not None:
            online.append((time_s, inverse(frame.cam_from_world)))
    before = clock()
    try:
        slam.finish()
        return SlamRun(
            shown=shown,
            online=Trajectory.of(online),
            trajectory=Trajectory.of(slam.trajectory()),
            keyframes=Trajectory.of(slam.keyframes()),
            points=np.asarray(slam.points(), float).reshape(-1, 3),
            statistics=slam.statistics(),
            finish_s=clock() - before,
            memory_mib=memory_mib(),
        )
    except StationError:
        raise
    except FAILURES as error:
        raise StationError(f"The tracker failed after the last picture: {told(error)}.") from error


def _tracked(slam: Slam, image: np.ndarray, time_s: float, name: str) -> SlamFrame:
    """A system of the user's own may fail in any way, and return anything. Raises StationError."""
    try:
        frame: object = slam.track(image, time_s)
    except StationError:
        raise
    except FAILURES as error:
        raise StationError(f"The tracker failed at {name}: {told(error)}.") from error
    if not isinstance(frame, SlamFrame):
        kind = type(slam).__name__
        raise StationError(f"{kind}.track returned {type(frame).__name__}, not a SlamFrame: the run ends here.")
    return frame


def figures(sequence: SlamSequence, run: SlamRun) -> dict[str, Any]:
    """All that a run tells, for JSON. Lengths are in the truth's unit; None where it cannot be measured."""
    outcomes = [one.outcome for one in run.shown]
    took = np.array([one.ms for one in run.shown])
    warm = took[WARM_UP_PICTURES:] if len(took) > 2 * WARM_UP_PICTURES else took
    warm = warm[np.isfinite(warm)]
    statistics, seconds = run.statistics, float(sequence.times_s[-1] - sequence.times_s[0])
    tracked = outcomes.count(Outcome.TRACKING)
    shown = len(outcomes) - outcomes.count(Outcome.DROPPED) - outcomes.count(Outcome.UNREADABLE)
    found: dict[str, Any] = {
        "sequence": sequence.name,
        "layout": sequence.layout,
        "camera": sequence.camera_source,
        "seconds": seconds,
        "frames": len(outcomes),
        "tracked_frames": tracked,
        "tracked_share": tracked / len(outcomes),
        "tracked_share_of_shown": tracked / shown if shown else 0.0,
        "lost_frames": outcomes.count(Outcome.LOST),
        "initializing_frames": outcomes.count(Outcome.INITIALIZING),
        "dropped_frames": outcomes.count(Outcome.DROPPED),
        "unreadable_frames": outcomes.count(Outcome.UNREADABLE),
        "longest_gap_frames": _longest_gap(outcomes),
        "trajectory_poses": len(run.trajectory),
    }
    found |= _errors_of(sequence.truth, run)
    found |= {f"ms_{name}": value for name, value in _spread(warm).items()}
    found["ms_first_200_p50"], found["ms_last_200_p50"] = _growth(warm)
    found |= {
        "keyframes": statistics.keyframes,
        "keyframes_per_s": statistics.keyframes / seconds,
        "points": statistics.points,
        "maps": statistics.maps,
        "loops": statistics.loops,
        "loops_corrected": statistics.loops_corrected,
        "merges": statistics.merges,
        "relocalizations": statistics.relocalizations,
        "focal_length_px": (statistics.camera or sequence.camera).fx,
        "distortion": list((statistics.camera or sequence.camera).distortion),
        "closures": [asdict(closure) for closure in statistics.closures],
        "finish_s": run.finish_s,
        "memory_mib": run.memory_mib,
        "stages_ms": {
            stage: _spread(np.array(times)) | {"runs": len(times)} for stage, times in statistics.timings_ms.items()
        },
    }
    return found


def _errors_of(truth: Trajectory | None, run: SlamRun) -> dict[str, Any]:
    """ATE of every frame's final pose, of the keyframes, and of the poses as they were told at once; RPE."""
    names = ("ate_rmse", "ate_mean", "ate_median", "ate_max", "rpe_trans_rmse", "rpe_rot_deg_rmse",
             "rpe_1s_trans_rmse", "rpe_1s_rot_deg_rmse", "scale")  # fmt: skip
    every, keyframes, online = (
        errors(one, truth) if truth is not None else None for one in (run.trajectory, run.keyframes, run.online)
    )
    found: dict[str, Any] = {name: getattr(every, name, None) for name in names}
    return found | {
        "ate_poses": every.poses if every is not None else 0,
        "ate_keyframes_rmse": keyframes.ate_rmse if keyframes is not None else None,
        "ate_online_rmse": online.ate_rmse if online is not None else None,
        "path_length": truth.length if truth is not None else None,
    }


def _spread(milliseconds: np.ndarray) -> dict[str, float | None]:
    if not len(milliseconds):
        return {"p50": None, "p95": None, "max": None}
    p50, p95 = np.percentile(milliseconds, (50, 95))
    return {"p50": float(p50), "p95": float(p95), "max": float(milliseconds.max())}


def _growth(milliseconds: np.ndarray) -> tuple[float | None, float | None]:
    if len(milliseconds) < 2 * GROWTH_PICTURES:
        return None, None
    return float(np.median(milliseconds[:GROWTH_PICTURES])), float(np.median(milliseconds[-GROWTH_PICTURES:]))


def _longest_gap(outcomes: Sequence[Outcome]) -> int:
    """Of pictures without a pose in a row, once there has been one."""
    longest = current = 0
    known = False
    for outcome in outcomes:
        known |= outcome is Outcome.TRACKING
        current = 0 if outcome is Outcome.TRACKING or not known else current + 1
        longest = max(longest, current)
    return longest


def memory_mib() -> float | None:
    """Proportional set size of this process and its children, memory that they share counted once (Linux)."""
    total_kb, pending = 0, [os.getpid()]
    try:
        while pending:
            process = Path("/proc") / str(pending.pop())
            rollup = (process / "smaps_rollup").read_text(encoding="ascii")
            total_kb += next(int(line.split()[1]) for line in rollup.splitlines() if line.startswith("Pss:"))
            for task in (process / "task").iterdir():
                pending += [int(child) for child in (task / "children").read_text(encoding="ascii").split()]
    except (OSError, StopIteration, ValueError):
        return None
    return total_kb / 1024
