"""Trackers of a user's own may fail in any way: what is then said and done, the same for every command."""

from __future__ import annotations

import logging
import traceback
from pathlib import Path
from typing import Any, Protocol

from base_station.errors import StationError
from base_station.types import Box, TrackerResult

log = logging.getLogger(__name__)

FAILURES = (Exception, SystemExit)
"""A file that calls sys.exit has failed as well; Ctrl-C is the user's."""


class Closable(Protocol):
    """All that can be let go of."""

    def close(self) -> None: ...


def told(error: BaseException) -> str:
    """What was raised, with its text and the line that raised it: "KeyError: 'x' (mine.py, line 3)"."""
    text = f"{type(error).__name__}: {error}".removesuffix(": ")
    frames = traceback.extract_tb(error.__traceback__)
    return f"{text} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else text


def checked(tracker: Any, result: object) -> TrackerResult:
    """What `update` returned, which may be anything. Raises StationError when it is no result."""
    kind = type(tracker).__name__
    if not isinstance(result, TrackerResult):
        raise StationError(f"{kind}.update returned {type(result).__name__}, not a TrackerResult: the run ends here.")
    if result.box is not None and not isinstance(result.box, Box):
        raise StationError(f"{kind}.update gave a {type(result.box).__name__} for the box, no Box: the run ends here.")
    return result


def close_tracker(tracker: Closable) -> None:
    """Let go of it. One that fails here is told of, and buries no other error."""
    try:
        tracker.close()
    except FAILURES as error:
        log.warning("the tracker did not close cleanly: %s", told(error))
