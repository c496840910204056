"""Tracker results as a CSV file: one row per frame, for spreadsheets and for scoring against a truth."""

from __future__ import annotations

import contextlib
import csv
import logging
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from base_station.errors import StationError
from base_station.station import Step

log = logging.getLogger(__name__)

COLUMNS = (
    "frame", "time_s", "state", "reason", "x", "y", "width", "height",
    "shift_px", "shift_y_px", "bearing_deg", "elevation_deg", "zoom", "confidence", "left", "right",
    "view_angle_deg", "range_m",
    "shadow_state", "shadow_bearing_deg", "shadow_zoom", "shadow_confidence",
    "pan_deg", "compass_deg",
)  # fmt: skip


class ResultsFile:
    """Opened at once, so that a path that cannot be written is known before the robot moves. Raises StationError.

    A disk that is full later ends the file, with a word, and not the run.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._file: TextIO | None = path.open("w", newline="", encoding="utf-8")
        except OSError as error:
            raise StationError(f"{path} cannot be written ({error.strerror}).", usage=True) from error
        self._path = path
        self._writer = csv.writer(self._file)
        self._put(COLUMNS)

    def write(self, step: Step) -> None:
        """One row; what the tracker could not tell stays empty."""
        result, box, shadow = step.result, step.result.box, step.shadow
        sides = (box.x, box.y, box.width, box.height) if box is not None else (None,) * 4
        angles = (_degrees(result.bearing_rad), _degrees(result.elevation_rad))
        numbers = (*sides, result.shift_px, result.shift_y_px, *angles, result.zoom, result.confidence)
        seen_in_shadow = (
            (shadow.state.value, _text(_degrees(shadow.bearing_rad)), _text(shadow.zoom), _text(shadow.confidence))
            if shadow is not None
            else ("",) * 4
        )
        self._put(
            [
                step.frame.number,
                f"{step.frame.time_s:.6f}",
                result.state.value,
                result.reason,
                *(_text(number) for number in numbers),
                step.command.left,
                step.command.right,
                _text(_degrees(result.view_angle_rad)),
                _text(result.range_m),
                *seen_in_shadow,
                _text(_degrees(step.pan_rad)),
                _text(_degrees(result.compass_rad)),
            ]
        )

    def close(self) -> None:
        """Write what is not written yet."""
        try:
            if self._file is not None:
                self._file.close()
        except OSError as error:
            self._give_up(error)
        self._file = None

    def _put(self, cells: Sequence[object]) -> None:
        try:
            if self._file is not None:
                self._writer.writerow(cells)
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        log.error("%s cannot be written any more (%s): it ends here, the run goes on", self._path, error.strerror)
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()
        self._file = None


def _degrees(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else math.degrees(angle_rad)


def _text(number: float | None) -> str:
    return "" if number is None else f"{number:.4f}"
