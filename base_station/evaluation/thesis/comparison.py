"""The thesis's comparison, chapters 4 and 5: every tracker on the same moving views, good and bad ones.

A target of 200 x 160 px is learned in the middle of the view; then the view sways by +-45 px. A tracker is right when
its bearing is within 1.5 px of the true one, wrong when it tells another, and honest when it says LOST. On a wall with
nothing to see, refusing to learn is the right answer.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from base_station.evaluation.thesis.pictures import CAMERA, COLUMNS, ROWS, SCENES, frame, view
from base_station.trackers.base import Tracker
from base_station.trackers.registry import make_tracker, tracker_names
from base_station.trackers.ztransform.thesis.z_shift import ZShiftSettings, ZShiftTracker
from base_station.types import Box, TrackingState

TARGET = Box.around((COLUMNS - 1) / 2, (ROWS - 1) / 2, 200, 160)
WITHIN_PX, SWAY_PX = 1.5, 45.0
THESIS_NAME = "z-shift, z = 0.9"


@dataclass(frozen=True, kw_only=True)
class Case:
    """One line of the comparison: a scene, and what the light and the sensor do. `gain` is that of the last frame."""

    name: str
    scene: str
    noise: float = 2.0
    gain: float = 1.0
    offset: float = 0.0


CASES = (
    Case(name="good light", scene="room"),
    Case(name="noise 10", scene="room", noise=10),
    Case(name="light falls to 0.3", scene="room", gain=0.3),
    Case(name="mine", scene="mine", noise=3),
    Case(name="desert", scene="desert"),
    Case(name="plain wall", scene="wall"),
)
GAINS = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15, 0.1, 0.06)
"""Of the light after learning, for the brightness curves."""


@dataclass
class Tally:
    """What one tracker did in one case."""

    right: int = 0
    wrong: int = 0
    lost: int = 0
    refused: int = 0
    """Frames of a target that it refused to learn."""
    errors_px: list[float] = field(default_factory=list)
    times_us: list[float] = field(default_factory=list)

    @property
    def frames(self) -> int:
        return self.right + self.wrong + self.lost + self.refused

    def share(self, what: str) -> float:
        """Of the frames, 0..1; what: right, wrong, lost or refused."""
        return float(getattr(self, what)) / max(self.frames, 1)


def contenders() -> dict[str, Callable[[], Tracker]]:
    """Every tracker of the registry, and z-shift as the thesis had it."""

    def by_name(name: str) -> Callable[[], Tracker]:
        return lambda: make_tracker(name)

    makers = {name: by_name(name) for name in tracker_names()}
    makers[THESIS_NAME] = lambda: ZShiftTracker(settings=ZShiftSettings.thesis())
    return makers


def run_case(
    case: Case,
    pictures: list[np.ndarray],
    trackers: dict[str, Callable[[], Tracker]],
    *,
    frames: int,
    seed: int,
    timer: Callable[[], float] = time.perf_counter,
) -> dict[str, Tally]:
    """All trackers over the same views of every picture."""
    tallies = {name: Tally() for name in trackers}
    for number, picture in enumerate(pictures):
        rng = np.random.default_rng((seed, number))
        first = frame(view(picture, noise=case.noise, rng=rng), 1)
        learned: dict[str, Tracker] = {}
        for name, make in trackers.items():
            tracker = make()
            try:
                tracker.learn(first, TARGET)
                learned[name] = tracker
            except ValueError:
                tallies[name].refused += frames
        for index in range(frames):
            part = (index + 1) / frames
            dx = SWAY_PX * math.sin(2 * math.pi * part * max(1, frames // 30))
            light = {"gain": 1 + (case.gain - 1) * part, "offset": case.offset}
            image = view(picture, dx, noise=case.noise, rng=rng, **light)
            for name, tracker in learned.items():
                _look(tracker, image, index + 2, dx, tallies[name], timer)
        for tracker in learned.values():
            tracker.close()
    return tallies


def _look(
    tracker: Tracker, image: np.ndarray, number: int, dx: float, tally: Tally, timer: Callable[[], float]
) -> None:
    now = frame(image, number)
    start = timer()
    result = tracker.update(now)
    tally.times_us.append(1e6 * (timer() - start))
    if result.state is not TrackingState.TRACKING or result.bearing_rad is None:
        tally.lost += 1
        return
    x = CAMERA.cx - CAMERA.fx * math.tan(result.bearing_rad)
    error = abs(x - (TARGET.center_px[0] + dx))
    tally.errors_px.append(error)
    if error <= WITHIN_PX:
        tally.right += 1
    else:
        tally.wrong += 1


def run_light(
    pictures: list[np.ndarray], trackers: dict[str, Callable[[], Tracker]], *, seed: int, jumps: int
) -> dict[str, list[float]]:
    """Share of right answers at each of GAINS: learned in good light, then seen in another, moved by up to 30 px."""
    right = {name: [0] * len(GAINS) for name in trackers}
    for number, picture in enumerate(pictures):
        rng = np.random.default_rng((seed, 100 + number))
        first = frame(view(picture, noise=2, rng=rng), 1)
        shifts = rng.uniform(-30, 30, jumps)
        views = [[view(picture, dx, gain=gain, noise=2, rng=rng) for dx in shifts] for gain in GAINS]
        for name, make in trackers.items():
            tracker = make()
            try:
                tracker.learn(first, TARGET)
            except ValueError:
                continue
            for index, images in enumerate(views):
                for dx, image in zip(shifts, images, strict=True):
                    tracker.update(first)  # back where it was learned, so that every move starts there
                    tally = Tally()
                    _look(tracker, image, 2 + index, float(dx), tally, time.perf_counter)
                    right[name][index] += tally.right
            tracker.close()
    total = len(pictures) * jumps
    return {name: [count / total for count in counts] for name, counts in right.items()}


def scene_pictures(case: Case, own: list[np.ndarray] | None, *, seed: int, count: int) -> list[np.ndarray]:
    """The pictures of a case: seeded, or in the room's place the user's own."""
    if case.scene == "room" and own:
        return own[:count]
    make = SCENES[case.scene][0]
    return [make(seed + 1000 * number) for number in range(count)]
