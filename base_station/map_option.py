"""`--map FILE`: SLAM goes on in the map of an earlier run, and leaves its own for the next one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from base_station.errors import StationError
from base_station.output_files import check_output
from base_station.trackers.base import KeepsMap, Tracker
from base_station.trackers.registry import make_tracker

MAPPING = "slam"


def check_map(path: Path | None, names: Iterable[str | None]) -> None:
    """Find mistakes of usage before anything is opened. `names`: of the trackers. Raises StationError."""
    if path is None:
        return
    mapping = list(names).count(MAPPING)
    if mapping == 0:
        raise StationError(
            f"--map goes with --tracker {MAPPING} or --shadow {MAPPING}: no other tracker has a map.", usage=True
        )
    if mapping > 1:
        raise StationError(f"--map is for one {MAPPING}: leave out --shadow {MAPPING}, or --map.", usage=True)
    check_output("--map", path)


def trackers_with_map(
    path: Path | None, say: Callable[[str], None], *, single_process: bool = False
) -> Callable[[str], Tracker]:  # fmt: skip
    """As `make_tracker`, but with the map where the tracker has one; `say` gets a line about it. `single_process`: one
    that maps does so within the frame, and the same frames then give the same results."""
    if path is None and not single_process:
        return make_tracker

    def make(name: str) -> Tracker:
        if name != MAPPING:
            return make_tracker(name)
        from base_station.trackers.slam.tracker import SlamTracker

        return SlamTracker(single_process=single_process, map_file=path, say=say)

    return make


def keep_maps(trackers: Iterable[Tracker]) -> None:
    """At the end, before they are closed. Raises StationError when a map cannot be written."""
    for tracker in trackers:
        if not isinstance(tracker, KeepsMap):
            continue
        try:
            tracker.keep_map()
        except StationError:
            raise
        except Exception as error:  # after a tracker has failed, in any way, its map may be no good either
            raise StationError(f"The map is not kept: {type(error).__name__}: {error}.") from error
