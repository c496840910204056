"""Behaviours that look at nothing: idle, and the drive of the thesis's PC program."""

from __future__ import annotations

from base_station.types import TrackerResult
from protocol import STOP, Command

CYCLE = (Command(100, 100),) * 15 + (Command(-68, 100),) * 5 + (Command(100, -68),) * 5 + (Command(-100, -100),) * 15
"""Listing A.2, one command per frame, 40 a cycle; its 2*16-100 is -68 (-100 was probably meant)."""


class Idle:
    """Stands still."""

    def command(self, result: TrackerResult | None, time_s: float) -> Command:
        """See Behaviour.command."""
        return STOP


class Pattern:
    """Drives listing A.2's cycle, over and over."""

    def __init__(self) -> None:
        self._step = 0

    def command(self, result: TrackerResult | None, time_s: float) -> Command:
        """See Behaviour.command."""
        command = CYCLE[self._step % len(CYCLE)]
        self._step += 1
        return command
