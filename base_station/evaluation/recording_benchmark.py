"""What recording costs the station's loop, and how large recordings are: the tracker on the frames of a run, at their
rate, with a recorder beside it and without, in alternating blocks of one process.

What counts is how long the loop is busy with a frame: the tracker, the call of the recorder, and whatever the writing
thread keeps them waiting (Python's lock, the processor's caches, the memory).
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np
import tyro

from base_station.errors import StationError
from base_station.evaluation.benchmark_report import machine, machine_line
from base_station.evaluation.tool import run_tool
from base_station.output_files import write_json
from base_station.recording.planning import kits_of, planned
from base_station.recording.recorder import Recorder
from base_station.recording.replay import one_thread, replay
from base_station.recording.sources import open_source
from base_station.station import Step
from base_station.types import Frame
from base_station.watcher import Watcher
from protocol import STOP

FPS = 30.0
BLOCK = 30
"""Frames with, then as many without a recorder."""
BARS = {"cost_ms_mean": 2.0, "gb_in_10_minutes": 1.2}
WAYS = ("jpeg", "raw")


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """What recording costs the station's loop, and how large recordings are."""

    recording: tyro.conf.Positional[Path]
    """A recording with --record-raw, whose frames are used."""
    seconds: float = 20.0
    """For each way of recording; half of it with a recorder."""
    tracker: str = "ztransform"
    json: Path | None = None
    """Write all figures to this file."""


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Milliseconds of a frame in the loop, with the recorder and without; sizes by the frames recorded."""

    way: str
    width: int
    height: int
    frames: int
    with_ms_p50: float
    without_ms_p50: float
    with_ms_p95: float
    without_ms_p95: float
    cost_ms_mean: float
    """Mean with less mean without."""
    call_ms_p50: float
    call_ms_max: float
    """Of the call of the recorder alone."""
    writer_ms: float
    """Processor time of the writing thread, per frame."""
    kb_per_frame: float
    gb_in_10_minutes: float
    """Extrapolated to 30 frames per second."""
    dropped: int


@dataclass
class _Times:
    busy_ms: list[float] = field(default_factory=list)
    call_ms: list[float] = field(default_factory=list)


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code."""
    return run_tool(Benchmark, "benchmark-recording", arguments, _run)


def _run(command: Benchmark, arguments: Sequence[str]) -> None:
    if not 2 <= command.seconds <= 600:
        raise StationError(f"--seconds must be 2..600, not {command.seconds:g}.", usage=True)
    steps = _steps(command)
    print(f"machine: {machine_line()}")
    with one_thread():
        costs = [_measure(command, steps, way) for way in WAYS]
    for cost in costs:
        _print(cost)
    if command.json is not None:
        write_json(command.json, {"costs": [asdict(cost) for cost in costs], "machine": machine()})


def _steps(command: Benchmark) -> list[Step]:
    """Of a few seconds, with results; the tracker is warm afterwards."""
    source = open_source(command.recording)
    plan = planned(source, command.tracker, None)
    with one_thread():
        found = [one.step for one in islice(replay(source, plan, kits_of(source, None)), 300)]
    if len(found) < BLOCK:
        raise StationError(f"{command.recording} has {len(found)} frames; at least {BLOCK} are needed.")
    return found


def _measure(command: Benchmark, steps: Sequence[Step], way: str) -> Cost:
    """The frames forwards and backwards, so that the target never jumps."""
    watcher = Watcher(kits_of(open_source(command.recording), None)(command.tracker))
    order = steps[0].orders[0] if steps[0].orders else None
    watcher.choose(order.target if order is not None else None)
    there_and_back = [*range(len(steps)), *range(len(steps) - 2, 0, -1)]
    on, off = _Times(), _Times()
    with tempfile.TemporaryDirectory() as folder, closing(watcher):
        recorder = Recorder(Path(folder) / "run.mcap", raw=way == "raw")
        began, thread_began, process_began = time.perf_counter(), time.thread_time(), time.process_time()
        for number in range(round(command.seconds * FPS)):
            recorded = steps[there_and_back[number % len(there_and_back)]]
            frame = _anew(recorded.frame, number)
            wait_s = began + number / FPS - time.perf_counter()
            if wait_s > 0:
                time.sleep(wait_s)
            recording = number // BLOCK % 2 == 1
            _one(watcher, recorded, frame, recorder if recording else None, on if recording else off)
        writer_s = time.process_time() - process_began - (time.thread_time() - thread_began)
        recorder.close()
        size = recorder.path.stat().st_size
    return _cost(way, steps[0].frame, recorder, on, off, size, writer_s)


def _anew(frame: Frame, number: int) -> Frame:
    """As it comes from the link: in memory of its own, which no cache holds."""
    return replace(frame, image=frame.image.copy(), number=number + 1, time_s=number / FPS)


def _one(watcher: Watcher, step: Step, frame: Frame, recorder: Recorder | None, times: _Times) -> None:
    begun_s = time.perf_counter()
    seen = watcher.look(frame)
    looked_s = time.perf_counter()
    told = replace(step, frame=frame, result=seen.result, learned=seen.learned, command=STOP, orders=())
    if recorder is not None:
        recorder.note_step(told)
    done_s = time.perf_counter()
    times.busy_ms.append((done_s - begun_s) * 1e3)
    times.call_ms.append((done_s - looked_s) * 1e3)


def _cost(
    way: str, frame: Frame, recorder: Recorder, on: _Times, off: _Times, size: int, writer_s: float
) -> Cost:  # fmt: skip
    frames, (height, width) = recorder.frames, frame.image.shape
    busy, idle = np.array(on.busy_ms), np.array(off.busy_ms[BLOCK:])  # the first block is not warm yet
    return Cost(
        way=way,
        width=width,
        height=height,
        frames=frames,
        with_ms_p50=float(np.median(busy)),
        without_ms_p50=float(np.median(idle)),
        with_ms_p95=float(np.percentile(busy, 95)),
        without_ms_p95=float(np.percentile(idle, 95)),
        cost_ms_mean=float(busy.mean() - idle.mean()),
        call_ms_p50=float(np.median(on.call_ms)),
        call_ms_max=float(np.max(on.call_ms)),
        writer_ms=writer_s * 1e3 / frames,
        kb_per_frame=size / frames / 1e3,
        gb_in_10_minutes=size / frames * FPS * 600 / 1e9,
        dropped=recorder.frames_without_picture + recorder.steps_dropped,
    )


def _print(cost: Cost) -> None:
    print(f"\n{cost.way}, {cost.width}x{cost.height}, {cost.frames} frames recorded, {cost.dropped} dropped")
    print(f"  a frame in the loop, median   {cost.without_ms_p50:7.3f} ms without, {cost.with_ms_p50:7.3f} ms with")
    print(f"                       95 %     {cost.without_ms_p95:7.3f} ms without, {cost.with_ms_p95:7.3f} ms with")
    _judge("recording costs, mean", cost.cost_ms_mean, "ms", BARS["cost_ms_mean"])
    print(f"  the recorder's call           {cost.call_ms_p50:7.3f} ms, at the most {cost.call_ms_max:.3f} ms")
    print(f"  the writing thread            {cost.writer_ms:7.3f} ms of processor time a frame")
    print(f"  size                          {cost.kb_per_frame:7.1f} kB a frame")
    if cost.way == "jpeg":
        _judge("10 minutes at 30 Hz, extrapolated", cost.gb_in_10_minutes, "GB", BARS["gb_in_10_minutes"])
    else:
        print(f"  10 minutes at 30 Hz, extrapolated {cost.gb_in_10_minutes:.3f} GB")


def _judge(name: str, value: float, unit: str, bar: float) -> None:
    verdict = "reached" if value <= bar else "MISSED"
    print(f"  {name:29} {value:7.3f} {unit} (at most {bar:g}: {verdict})")


if __name__ == "__main__":
    raise SystemExit(main())
