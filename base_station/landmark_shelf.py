"""The file of landmarks while a station runs: remember, forget, and which there are. From any thread."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING

from base_station.errors import StationError
from base_station.types import Box, Frame

if TYPE_CHECKING:
    from base_station.trackers.ztransform.landmark import Landmark


class LandmarkShelf:
    """`memory`: the file; made with the first landmark."""

    def __init__(self, memory: Path) -> None:
        self._memory = memory
        self._lock = threading.Lock()
        self._names: tuple[str, ...] = ()
        self._state: tuple[int, int] | None = None
        """Of the file that the names were read from: time of change, size."""
        self.problem = ""
        """Why the file cannot be read; empty when it can."""

    @property
    def names(self) -> tuple[str, ...]:
        """As of the last `refresh`. Returns at once."""
        return self._names

    def refresh(self) -> None:
        """Read the file's names again if it has changed. An unreadable file has none."""
        with self._lock:
            state = self._stat()
            if state == self._state:
                return
            self._state = state
            try:
                self._names = tuple(landmark.name for landmark in self._read())
                self.problem = ""
            except StationError as error:
                self._names, self.problem = (), str(error)

    def remember(self, name: str, frame: Frame, target: Box | None) -> bool:
        """Keep what is in the box, or with None the whole view; whether another of this name was there and is replaced.
        Takes a moment. Raises ValueError, StationError."""
        from base_station.trackers.ztransform.landmark_file import write_landmarks
        from base_station.trackers.ztransform.lookup import LandmarkMemory

        if not frame.is_whole:
            raise ValueError("the robot sends a band of rows only just now; try again")
        with self._lock:
            memory = LandmarkMemory()
            for landmark in self._read():
                memory.add(landmark)
            replaced = name in {landmark.name for landmark in memory.landmarks}
            memory.learn(name, frame, target)
            write_landmarks(self._memory, memory.landmarks)
        self.refresh()
        return replaced

    def forget(self, name: str) -> None:
        """Raises ValueError when there is none of this name, StationError."""
        from base_station.trackers.ztransform.landmark_file import write_landmarks

        with self._lock:
            kept = self._read()
            if name not in {landmark.name for landmark in kept}:
                raise ValueError(f"there is no landmark {name!r} in {self._memory}")
            write_landmarks(self._memory, [landmark for landmark in kept if landmark.name != name])
        self.refresh()

    def _read(self) -> list[Landmark]:
        from base_station.trackers.ztransform.landmark_file import read_landmarks

        return read_landmarks(self._memory) if self._memory.exists() else []

    def _stat(self) -> tuple[int, int] | None:
        try:
            found = self._memory.stat()
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size
