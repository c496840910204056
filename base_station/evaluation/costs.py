"""What a frame of 640x480 costs, measured side by side in one process: tracking, finding again, and the usual methods.

The blocks alternate, so that whatever slows the machine down slows all of them. One thread, everything warm.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from base_station.evaluation.conditions import TARGET, Disturbance, disturbed_view, reference_view
from base_station.evaluation.tracker_benchmark import WITHIN_PX, Sitting
from base_station.evaluation.worlds import VIEW_COLUMNS, VIEW_ROWS, World
from base_station.types import TrackerResult, TrackingState

VIEWS = 50
NEAREST_ZOOM, FARTHEST_ZOOM = 2.2, 0.45
"""Of targets to be found again without a prediction."""
ORB_FEATURES = 1000


@dataclass(frozen=True, kw_only=True)
class Costs:
    """Medians over `updates` calls each, microseconds."""

    tracker: str
    updates: int
    tracking_us: float
    """Following a target that moves by up to 3 px and 1 % a frame."""
    reacquisition_us: float
    """One frame after it was LOST: anywhere along the row, zoom 0.45 to 2.2."""
    reacquired_share: float
    """Of those, found again in that one frame, within 1.5 px for each unit of zoom."""
    phase_correlate_us: float
    """cv2.phaseCorrelate of two whole frames (float32 already, Hann window)."""
    orb_us: float
    """cv2.ORB, 1000 features, detected and described in a whole frame; nothing matched yet."""


def measure_costs(tracker: str, world: World, *, rounds: int = 5, seed: int = 0) -> Costs:
    """50 calls of each kind per round."""
    rng = np.random.default_rng([seed, 0xC057])
    moving = [_view(world, _course(number), rng) for number in range(VIEWS)]
    places = [_anywhere(rng) for _ in range(VIEWS)]
    found_again = [_view(world, place, rng) for place in places]
    reference = reference_view(world)
    first, second = (image.astype(np.float32) for image in moving[:2])
    window = cv2.createHanningWindow((VIEW_COLUMNS, VIEW_ROWS), cv2.CV_32F)
    orb = cv2.ORB.create(nfeatures=ORB_FEATURES)
    cv2.phaseCorrelate(first, second, window)
    orb.detectAndCompute(moving[0], None)
    times: dict[str, list[float]] = {name: [] for name in ("tracking", "again", "phase", "orb")}
    hits = []
    with Sitting(tracker, reference) as sitting:
        for _ in range(rounds):
            sitting.surprise(moving[0])
            times["tracking"] += [sitting.show(image)[1] for image in moving]
            for place, image in zip(places, found_again, strict=True):
                result, us = _find_again(sitting, image)
                times["again"].append(us)
                hits.append(_is_hit(result, place))
            times["phase"] += _timed(lambda number: cv2.phaseCorrelate(first, second, window))
            times["orb"] += _timed(lambda number: orb.detectAndCompute(moving[number], None))
    return Costs(
        tracker=tracker,
        updates=len(times["tracking"]),
        tracking_us=float(np.median(times["tracking"])),
        reacquisition_us=float(np.median(times["again"])),
        reacquired_share=float(np.mean(hits)),
        phase_correlate_us=float(np.median(times["phase"])),
        orb_us=float(np.median(times["orb"])),
    )


def _timed(call: Callable[[int], object]) -> Sequence[float]:
    times = []
    for number in range(VIEWS):
        begin = time.perf_counter_ns()
        call(number)
        times.append((time.perf_counter_ns() - begin) / 1000)
    return times


def _view(world: World, disturbance: Disturbance, rng: np.random.Generator) -> np.ndarray:
    return disturbed_view(world, disturbance, rng)


def _course(number: int) -> Disturbance:
    """A round trip of 50 frames."""
    angle = 2 * math.pi * number / VIEWS
    return Disturbance(dx=24 * math.sin(angle), dy=4 * math.sin(2 * angle), zoom=1.08 ** math.sin(angle), noise=2)


def _anywhere(rng: np.random.Generator) -> Disturbance:
    """Wholly in the view, or as much of it as there is room for."""
    zoom = math.exp(rng.uniform(math.log(FARTHEST_ZOOM), math.log(NEAREST_ZOOM)))
    room = max((VIEW_COLUMNS - TARGET.width * zoom) / 2, 0.0)
    return Disturbance(dx=rng.uniform(-room, room), zoom=zoom, noise=2)


def _find_again(sitting: Sitting, image: np.ndarray) -> tuple[TrackerResult, float]:
    """Settle, show nothing, wait until nobody expects it where it was, then show the target."""
    sitting.surprise(np.full_like(image, 128))
    sitting.wait()
    return sitting.show(image)


def _is_hit(result: TrackerResult, place: Disturbance) -> bool:
    if result.state is not TrackingState.TRACKING or result.shift_px is None:
        return False
    return abs(result.shift_px - place.dx) <= WITHIN_PX * max(place.zoom, 1)
