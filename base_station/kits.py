"""Trackers by name, with what belongs to them: the registry's, a user's own, and landmarks from the memory's file."""

from __future__ import annotations

import atexit
import functools
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from base_station.landmarks_command import scale_of, unknown_text
from base_station.orders import LANDMARK
from base_station.scale import Scale
from base_station.trackers.base import Tracker
from base_station.trackers.registry import make_tracker
from base_station.watcher import Kit

if TYPE_CHECKING:
    from base_station.trackers.ztransform.landmark import Landmark


COMPILED = ("ztransform", "z-shift", "z-regions", "slam")
"""Trackers with kernels of their own, which a fresh clone has yet to compile."""
COMPILING_S = 300.0
COMPILE = (
    "import sys; from pathlib import Path; from base_station.kits import KitMaker; "
    "KitMaker(memory=Path(sys.argv[1]))(sys.argv[2]).tracker.close()"
)


@dataclass(frozen=True, kw_only=True)
class KitMaker:
    """Call it with a name that `make_tracker` knows, or with `landmark:NAME`. Raises ValueError, StationError.

    `target_width_m`, `learned_distance_m`: what is known of what trackers learn; their results then carry metres.
    """

    memory: Path
    """The file of landmarks."""
    target_width_m: float | None = None
    learned_distance_m: float | None = None
    trackers: Callable[[str], Tracker] = make_tracker
    """What makes a tracker of a name that is no landmark's."""

    def beside_a_run(self, name: str) -> Kit:
        """The same, for a loop that must go on: kernels are compiled in another process first. Here, that would hold
        the loop up for a minute as soon as it needed a kernel as well."""
        if name.startswith(LANDMARK) or name in COMPILED:
            child = subprocess.Popen(
                [sys.executable, "-c", COMPILE, str(self.memory), name],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            atexit.register(child.kill)
            try:
                child.wait(COMPILING_S)  # how it ends does not matter: what is wrong shows below
            except subprocess.TimeoutExpired:
                child.kill()
            atexit.unregister(child.kill)
        return self(name)

    def __call__(self, name: str) -> Kit:
        if name.startswith(LANDMARK):
            return _landmark_kit(name, _landmark(name.removeprefix(LANDMARK), self.memory))
        if self.target_width_m is None and self.learned_distance_m is None:
            return Kit(name=name, tracker=self.trackers(name))
        scale = functools.partial(scale_of, width_m=self.target_width_m, distance_m=self.learned_distance_m)
        return Kit(name=name, tracker=self.trackers(name), scale=scale)


def _landmark(name: str, memory: Path) -> Landmark:
    from base_station.trackers.ztransform.landmark_file import read_landmarks

    known = {landmark.name: landmark for landmark in read_landmarks(memory)}
    if name not in known:
        raise ValueError(unknown_text(name, memory, list(known)))
    return known[name]


def _landmark_kit(name: str, landmark: Landmark) -> Kit:
    from base_station.trackers.ztransform.recall import RecallTracker

    depth_m = landmark.learned_depth_m
    scale = None if depth_m is None else lambda box, camera: Scale(learned_depth_m=depth_m)
    return Kit(name=name, tracker=RecallTracker(landmark), scale=scale, knows_target=True)
