"""scripts/benchmark-landmarks: how surely, how fast and how exactly many landmarks are told apart.

Landmarks are boxes of random size and place in views of several worlds, none on top of another. Then one world after
the other is seen again, shifted, enlarged, in other light and with noise, and the memory is asked which landmarks it
sees. Found: of the landmarks whose box lies wholly in the view. False: any sighting in a world where nothing was
learned, and any sighting of a landmark of another world.
"""

from __future__ import annotations

import contextlib
import json
import math
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from threadpoolctl import threadpool_limits

from base_station.errors import StationError
from base_station.evaluation.benchmark_report import PLAIN_WIDTH, goal_table, machine_line
from base_station.evaluation.footprint import array_bytes
from base_station.evaluation.goals import bytes_goal, lookup_goal
from base_station.evaluation.tool import run_tool
from base_station.evaluation.worlds import VIEW_COLUMNS, VIEW_ROWS, World, generated_world, photographed_worlds
from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform.landmark_file import LANDMARK_BYTES
from base_station.trackers.ztransform.lookup import LandmarkMemory
from base_station.types import Box, Frame

ZOOMS = {"zoom 0.45-0.7": (0.45, 0.7), "zoom 0.7-1.4": (0.7, 1.4), "zoom 1.4-2.2": (1.4, 2.2)}
GAINS, OFFSETS, NOISE = (0.4, 1.6), (-40.0, 40.0), 3.0
CAMERA = PinholeCamera.with_fov(VIEW_COLUMNS, VIEW_ROWS)
PER_WORLD = 10
MOST_UNKNOWN = 10
"""Worlds in which nothing was learned."""
MOST_CLIPPED = 0.1
ROWS_PX = 2.0
"""How far a view may be off vertically: a robot that nods. Rows follow from the zoom, see `lookup`."""


@dataclass(frozen=True, kw_only=True)
class LandmarkBenchmark:
    """Recognition among many landmarks: found, false, exactness, time, memory."""

    landmarks: int = 500
    frames: int = 300
    """Views in which landmarks are to be found, and half as many again in which there are none."""
    images: Path | None = None
    """A folder of photographs to use as worlds: the even ones to learn from, the odd ones to show none."""
    seed: int = 0
    json: Path | None = None
    """Write the figures to this file."""


@dataclass(frozen=True, kw_only=True)
class RangeScore:
    """One range of zooms. Errors over the landmarks that were found."""

    expected: int
    found: float
    found_unclipped: float | None
    """Where the light leaves nine tenths of the pixels off the ends of the grey scale."""
    median_px: float | None
    zoom_err_median: float | None


@dataclass(frozen=True, kw_only=True)
class LandmarkScores:
    landmarks: int
    ranges: dict[str, RangeScore]
    wrong_sightings: int
    """Of landmarks that belong to another world."""
    frames: int
    false_frames: float
    """Share of the frames showing none in which some landmark was seen."""
    empty_frames: int
    lookup_ms_p10: float
    lookup_ms_p50: float
    empty_lookup_ms_p50: float
    """In frames that show none: nothing to verify to the end."""
    phase_correlation_ms_p50: float
    """cv2.phaseCorrelate of such a frame, in the same run: a yardstick for the machine."""
    learn_ms_p50: float
    bytes_per_landmark: int
    """What must be kept of each, see `landmark_file`."""
    running_bytes_per_landmark: int
    """All arrays of the memory after the look-ups, by the number of landmarks."""


@dataclass
class _Tally:
    found: list[bool] = field(default_factory=list)
    clipped: list[bool] = field(default_factory=list)
    off_px: list[float] = field(default_factory=list)
    off_zoom: list[float] = field(default_factory=list)


def run_landmark_benchmark(
    known: Sequence[World], unknown: Sequence[World], *, landmarks: int, frames: int, seed: int
) -> LandmarkScores:
    """Learn in the first worlds, look in both. One thread's times."""
    rng = np.random.default_rng(seed)
    memory, boxes, learn_s = _learn(known, landmarks, rng)
    memory.find(_frame(_lit(known[0].view(), 1.0, 0.0, rng)))
    tallies: dict[str, _Tally] = defaultdict(_Tally)
    lookup_s: list[float] = []
    yardstick_s: list[float] = []
    wrong = 0
    for number in range(frames):
        name, zooms = list(ZOOMS.items())[number % len(ZOOMS)]
        world = int(rng.integers(len(known)))
        zoom = float(np.exp(rng.uniform(*np.log(zooms))))
        dx, dy = float(rng.uniform(-50, 50)), float(rng.uniform(-ROWS_PX, ROWS_PX))
        frame = _frame(
            _lit(known[world].view(dx, dy, zoom), float(rng.uniform(*GAINS)), float(rng.uniform(*OFFSETS)), rng)
        )
        begun_s = time.thread_time()
        sightings = {sighting.landmark.name: sighting for sighting in memory.find(frame)}
        lookup_s.append(time.thread_time() - begun_s)
        if number % 5 == 0:
            yardstick_s.append(_phase_correlation_s(frame.image))
        clipped = float(np.mean((frame.image == 0) | (frame.image == 255))) > MOST_CLIPPED
        wrong += sum(key not in boxes[world] for key in sightings)
        for key, box in boxes[world].items():
            seen = _moved(box, dx, dy, zoom)
            if not _is_inside(seen):
                continue
            tally, sighting = tallies[name], sightings.get(key)
            tally.found.append(sighting is not None)
            tally.clipped.append(clipped)
            if sighting is not None:
                tally.off_px.append(abs(sighting.box.center_px[0] - seen.center_px[0]))
                tally.off_zoom.append(abs(sighting.zoom / zoom - 1))
    false, empty = 0, frames // 2
    empty_s: list[float] = []
    for number in range(empty):
        zoom = float(np.exp(rng.uniform(math.log(0.45), math.log(2.2))))
        view = unknown[number % len(unknown)].view(float(rng.uniform(-200, 200)), float(rng.uniform(-50, 50)), zoom)
        frame = _frame(_lit(view, float(rng.uniform(*GAINS)), 0.0, rng))
        begun_s = time.thread_time()
        false += bool(memory.find(frame))
        empty_s.append(time.thread_time() - begun_s)
    return LandmarkScores(
        landmarks=len(memory),
        ranges={name: _range_score(tally) for name, tally in tallies.items()},
        wrong_sightings=wrong,
        frames=frames,
        false_frames=false / max(empty, 1),
        empty_frames=empty,
        lookup_ms_p10=float(np.quantile(lookup_s, 0.1)) * 1e3,
        lookup_ms_p50=float(np.median(lookup_s)) * 1e3,
        empty_lookup_ms_p50=float(np.median(empty_s)) * 1e3,
        phase_correlation_ms_p50=float(np.median(yardstick_s)) * 1e3,
        learn_ms_p50=float(np.median(learn_s)) * 1e3,
        bytes_per_landmark=LANDMARK_BYTES,
        running_bytes_per_landmark=array_bytes(memory) // len(memory),
    )


def _learn(
    worlds: Sequence[World], count: int, rng: np.random.Generator
) -> tuple[LandmarkMemory, list[dict[str, Box]], list[float]]:
    memory, boxes, took_s = LandmarkMemory(), [dict[str, Box]() for _ in worlds], []
    frames = [_frame(_lit(world.view(), 1.0, 0.0, rng)) for world in worlds]
    tries = 0
    while len(memory) < count:
        tries += 1
        if tries > 100 * count:
            raise StationError("The pictures have too little texture, or there are too few, for so many landmarks.")
        world = int(rng.integers(len(worlds)))
        box = _draw_box(rng)
        if any(_overlap(box, other) for other in boxes[world].values()):
            continue
        begun_s = time.thread_time()
        try:
            memory.learn(f"landmark {len(memory)}", frames[world], box)
        except ValueError:
            continue  # featureless
        took_s.append(time.thread_time() - begun_s)
        boxes[world][f"landmark {len(memory) - 1}"] = box
    return memory, boxes, took_s


def measure_lookup_ms(worlds: Sequence[World], *, landmarks: int, views: int, seed: int) -> float:
    """Median time of a look-up among so many landmarks, learned anywhere in these worlds, over views of them."""
    rng = np.random.default_rng([seed, 0x100C])
    memory = LandmarkMemory()
    frames = [_frame(_lit(world.view(), 1.0, 0.0, rng)) for world in worlds]
    for _ in range(10 * landmarks):
        with contextlib.suppress(ValueError):  # featureless
            memory.learn(f"landmark {len(memory)}", frames[int(rng.integers(len(frames)))], _draw_box(rng))
        if len(memory) == landmarks:
            break
    else:
        raise StationError("The pictures have too little texture for so many landmarks.")
    memory.find(frames[0])
    took_s = []
    for number in range(views):
        zoom, dx = float(np.exp(rng.uniform(math.log(0.45), math.log(2.2)))), float(rng.uniform(-50, 50))
        frame = _frame(_lit(worlds[number % len(worlds)].view(dx, 0.0, zoom), float(rng.uniform(*GAINS)), 0.0, rng))
        begun_s = time.thread_time()
        memory.find(frame)
        took_s.append(time.thread_time() - begun_s)
    return float(np.median(took_s)) * 1e3


def _draw_box(rng: np.random.Generator) -> Box:
    side, aspect = float(np.exp(rng.uniform(np.log(70), np.log(200)))), float(np.exp(rng.uniform(-0.35, 0.35)))
    width, height = side * math.sqrt(aspect), side / math.sqrt(aspect)
    x = float(rng.uniform(width / 2, VIEW_COLUMNS - width / 2))
    y = float(rng.uniform(height / 2, VIEW_ROWS - height / 2))
    return Box.around(x, y, width, height)


def _overlap(one: Box, other: Box) -> bool:
    (x, y), (other_x, other_y) = one.center_px, other.center_px
    return (
        abs(x - other_x) < 0.4 * (one.width + other.width) / 2
        and abs(y - other_y) < 0.4 * (one.height + other.height) / 2
    )


def _moved(box: Box, dx: float, dy: float, zoom: float) -> Box:
    x, y = box.center_px
    middle_x, middle_y = (VIEW_COLUMNS - 1) / 2, (VIEW_ROWS - 1) / 2
    return Box.around(
        middle_x + zoom * (x - middle_x) + dx,
        middle_y + zoom * (y - middle_y) + dy,
        zoom * box.width,
        zoom * box.height,
    )


def _is_inside(box: Box) -> bool:
    return box.x >= 0 and box.y >= 0 and box.x + box.width <= VIEW_COLUMNS and box.y + box.height <= VIEW_ROWS


def _lit(view: np.ndarray, gain: float, offset: float, rng: np.random.Generator) -> np.ndarray:
    noisy = gain * view + offset + rng.normal(0, NOISE, view.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def _frame(image: np.ndarray) -> Frame:
    return Frame(image=image, number=1, time_s=0.0, camera=CAMERA)


def _phase_correlation_s(image: np.ndarray) -> float:
    picture = image.astype(np.float32)
    begun_s = time.thread_time()
    cv2.phaseCorrelate(picture, picture)
    return time.thread_time() - begun_s


def _range_score(tally: _Tally) -> RangeScore:
    unclipped = [found for found, clipped in zip(tally.found, tally.clipped, strict=True) if not clipped]
    return RangeScore(
        expected=len(tally.found),
        found_unclipped=float(np.mean(unclipped)) if unclipped else None,
        found=float(np.mean(tally.found)),
        median_px=float(np.median(tally.off_px)) if tally.off_px else None,
        zoom_err_median=float(np.median(tally.off_zoom)) if tally.off_zoom else None,
    )


def _print(scores: LandmarkScores) -> None:
    print(
        f"{scores.landmarks} landmarks, {scores.bytes_per_landmark} bytes each to keep"
        f" ({scores.running_bytes_per_landmark} while looking), learned in {scores.learn_ms_p50:.0f} ms"
    )
    for name, score in scores.ranges.items():
        errors = (
            f"median error {score.median_px:.2f} px, zoom {score.zoom_err_median:.2%}"
            if score.median_px is not None and score.zoom_err_median is not None
            else "none found"
        )
        clear = f" ({score.found_unclipped:.1%} in unclipped light)" if score.found_unclipped is not None else ""
        print(f"{name}: found {score.found:.1%} of {score.expected}{clear}; {errors}")
    print(f"wrong sightings in {scores.frames} frames: {scores.wrong_sightings}")
    print(f"frames that show none, {scores.empty_frames}: some landmark seen in {scores.false_frames:.1%}")
    print(
        f"look-up, processor time: median {scores.lookup_ms_p50:.2f} ms (tenth percentile {scores.lookup_ms_p10:.2f}), "
        f"in frames that show none {scores.empty_lookup_ms_p50:.2f} ms; "
        f"cv2.phaseCorrelate beside it {scores.phase_correlation_ms_p50:.2f} ms"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 done, 1 failed, 2 wrong usage."""
    return run_tool(LandmarkBenchmark, "benchmark-landmarks", arguments, _run)


def _run(run: LandmarkBenchmark, _arguments: Sequence[str]) -> None:
    if not 1 <= run.landmarks <= 4096 or not 3 <= run.frames <= 100_000:
        raise StationError("--landmarks must be 1..4096, --frames 3..100000.", usage=True)
    cv2.setNumThreads(1)
    with threadpool_limits(1):
        known, unknown = _worlds(run)
        print(f"{machine_line()}; seed {run.seed}")
        scores = run_landmark_benchmark(known, unknown, landmarks=run.landmarks, frames=run.frames, seed=run.seed)
    _print(scores)
    goals = [lookup_goal(scores.landmarks, scores.lookup_ms_p50), bytes_goal(scores.bytes_per_landmark)]
    console = Console()
    if not console.is_terminal:
        console.width = PLAIN_WIDTH
    console.print(goal_table(goals, "landmarks"))
    if run.json is not None:
        run.json.write_text(json.dumps(asdict(scores), indent=2) + "\n", encoding="utf-8")


def _worlds(run: LandmarkBenchmark) -> tuple[Sequence[World], Sequence[World]]:
    if run.images is not None:
        worlds = photographed_worlds(run.images, run.seed)
        if len(worlds) < 2:
            raise StationError(f"{run.images} has one picture; at least two are needed.", usage=True)
        return worlds[::2], worlds[1::2]
    known, unknown = math.ceil(run.landmarks / PER_WORLD), min(run.frames // 2, MOST_UNKNOWN)
    first = 1000 * run.seed
    return [generated_world(first + n) for n in range(known)], [
        generated_world(first + 500 + n) for n in range(unknown)
    ]


if __name__ == "__main__":
    sys.exit(main())
