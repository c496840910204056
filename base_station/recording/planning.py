"""What a replay needs to know of the recorded run: its trackers, its landmarks, the scale of its target."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from base_station.errors import StationError
from base_station.kits import KitMaker
from base_station.landmarks_command import DEFAULT_MEMORY
from base_station.map_option import trackers_with_map
from base_station.orders import LANDMARK
from base_station.recording.replay import ReplayPlan
from base_station.recording.sources import RecordedRun, Source
from base_station.trackers.registry import DEFAULT_TRACKER

log = logging.getLogger(__name__)


def recorded_tracker(source: Source) -> str:
    """The one that steered at first; of a folder or video the default."""
    if not isinstance(source, RecordedRun):
        return DEFAULT_TRACKER
    landmark = source.recording.option("landmark")
    return LANDMARK + landmark if landmark else source.recording.option("tracker") or DEFAULT_TRACKER


def planned(source: Source, tracker: str | None, shadow: str | None) -> ReplayPlan:
    """With the trackers that are named, or those that were recorded, with their changes. Raises StationError."""
    recording = source.recording if isinstance(source, RecordedRun) else None
    rows = recording.length("target_rows") if recording is not None else None
    if rows is not None and not (rows >= 1 and rows == int(rows)):
        raise StationError(f"{source.name}: target_rows is {rows:g}, not a number of rows.")
    recorded_shadow = recording.option("shadow") if recording is not None and tracker is None else None
    return ReplayPlan(
        tracker=tracker or recorded_tracker(source),
        shadow=shadow or recorded_shadow,
        keep_tracker=tracker is not None,
        keep_shadow=tracker is not None or shadow is not None,
        target_rows=None if rows is None else int(rows),
    )


def kits_of(
    source: Source, memory: Path | None, map_file: Path | None = None, say: Callable[[str], None] = log.info
) -> KitMaker:
    """Trackers with the scale that was told to the recorded run, the same frames giving the same results; `map_file`,
    `say`: see `trackers_with_map`."""
    trackers = trackers_with_map(map_file, say, single_process=True)
    if not isinstance(source, RecordedRun):
        return KitMaker(memory=memory or DEFAULT_MEMORY, trackers=trackers)
    recording = source.recording
    return KitMaker(
        memory=memory or Path(recording.option("memory") or DEFAULT_MEMORY),
        target_width_m=recording.length("target_width_m"),
        learned_distance_m=recording.length("learned_distance_m"),
        trackers=trackers,
    )
