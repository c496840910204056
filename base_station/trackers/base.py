"""What a tracker is. The station knows trackers only through these three methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from base_station.types import Box, Frame, TrackerResult


@runtime_checkable
class Tracker(Protocol):
    """Remembers a target (or a view) and says in later frames where it is and how large.

    A tracker is used from one thread. It keeps no clock of its own: time is `frame.time_s`. It may keep a frame's
    image, and must not write to it. With the same frames it gives the same results.
    """

    def learn(self, frame: Frame, target: Box | None) -> None:
        """Remember what is in the box, or with None the whole view (a place). Replaces what was learned before.

        Raises ValueError, with the reason in words, when the box is outside of the frame, too small or featureless.
        """
        ...

    def update(self, frame: Frame) -> TrackerResult:
        """Look for the target in this frame. Before `learn`: state INITIALIZING."""
        ...

    def close(self) -> None:
        """Let go of everything. May be called twice."""
        ...


@dataclass(frozen=True, kw_only=True)
class Survey:
    """What a mapping tracker knows at the end. `trajectory`: (time_s, world_from_cam 4x4) of the frames with a pose in
    the largest map, as corrected since; its unit and origin are the map's own. `loops`: places
    recognised anew and tied together; `confirmed`: those of them that the map had right already, so that no error was
    left to spread; `loop_times_s`: of each."""

    trajectory: list[tuple[float, np.ndarray]]
    loops: int
    keyframes: int
    maps: int
    confirmed: int = 0
    loop_times_s: tuple[float, ...] = ()


@runtime_checkable
class Surveyor(Tracker, Protocol):
    """A tracker that maps."""

    def survey(self) -> Survey | None:
        """After the last frame; waits until the map is finished. None before anything was learned."""
        ...


@runtime_checkable
class KeepsMap(Tracker, Protocol):
    """A tracker whose map outlives it."""

    def keep_map(self) -> None:
        """After the last frame, before `close`: write the map to its file, where it has one; waits until it is
        finished. Raises StationError."""
        ...


@runtime_checkable
class WantsRows(Tracker, Protocol):
    """A tracker that can work on a band of rows (see `Frame.first_row`): the robot then needs not send the rest.

    It must be ready for whole frames at any time, and for a band that it did not ask for or asked for some frames ago:
    `Frame.first_row` tells. `learn` always gets a whole frame.
    """

    def wanted_rows(self) -> tuple[int, int] | None:
        """The rows of the whole frame, first and past-last, that the next frames must have, with room for how far the
        target moves and grows in a tenth of a second; None: all. They may stick out of the frame."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """What a tracker shows of itself, of the last frame: for people to look at, never for control."""

    features_px: np.ndarray | None = None
    """(n, 2), x and y in the whole frame: what it follows."""
    bands: int = 0
    """It reads the target's box in so many bands of rows; 0: it does not."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SignatureView:
    """By what a tracker knows its target: (n,) numbers as they are now, and as they were learned."""

    now: np.ndarray
    learned: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class MapView:
    """A map, in its own unit and origin: x right, y down, z ahead of the camera in its first picture."""

    points: np.ndarray
    """(n, 3)."""
    keyframes: np.ndarray
    """(n, 3), where the remembered pictures were taken, the oldest first."""
    world_from_cam: np.ndarray | None = None
    """4x4, of the last frame; None when its pose is not known."""


@runtime_checkable
class Shows(Tracker, Protocol):
    """A tracker that can show something. It is asked after each frame, and must not take long: a millisecond."""

    def show(self) -> Shown:
        """Of the last `update`."""
        ...


@runtime_checkable
class Signs(Tracker, Protocol):
    """A tracker with a signature to show. It is asked some times a second, after a frame."""

    def show_signature(self) -> SignatureView | None:
        """Of the last `update`; None while the target is not seen."""
        ...


@runtime_checkable
class Maps(Tracker, Protocol):
    """A tracker with a map to show."""

    def show_map(self) -> MapView | None:
        """After the last `update`; None before there is a map. Copies, or arrays that do not change."""
        ...
