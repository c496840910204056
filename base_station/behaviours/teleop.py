"""Teleop: drive with the keys of the terminal, or with the console's keys and gamepad.

A terminal tells of keys only by repeating them, and begins to repeat late; so a key counts as held for a short while
after each repeat, and for longer after the first. The console says how to go as long as something is held. Then the
robot stands.
"""

from __future__ import annotations

import queue
from dataclasses import dataclass

from base_station.behaviours.base import Drive
from base_station.types import TrackerResult
from protocol import STOP, Command

DIRECTIONS = {
    "w": (1, 0), "up": (1, 0),
    "s": (-1, 0), "down": (-1, 0),
    "a": (0, 1), "left": (0, 1),
    "d": (0, -1), "right": (0, -1),
}  # fmt: skip
"""Key to (forward, left)."""


@dataclass(frozen=True, kw_only=True)
class TeleopSettings:
    forward_m_s: float = 0.08
    turn_rad_s: float = 1.0
    first_hold_s: float = 0.6
    """A key pressed once counts as held for this long: a terminal's delay before the first repeat."""
    repeat_hold_s: float = 0.15
    """After each repeat."""
    steer_hold_s: float = 0.25
    """After each word of the console, which comes ten times a second."""


class Teleop:
    """`keys` receives the names of pressed keys: w a s d, up down left right; any other key stops."""

    def __init__(self, drive: Drive, keys: queue.SimpleQueue[str], settings: TeleopSettings | None = None) -> None:
        self._drive, self._keys, self._settings = drive, keys, settings or TeleopSettings()
        self._held: str | None = None
        self._direction = (0.0, 0.0)
        self._until_s = float("-inf")

    def steer(self, forward: float, left: float, time_s: float) -> None:
        """See `Steered.steer`."""
        self._held, self._direction = None, (forward, left)
        self._until_s = time_s + self._settings.steer_hold_s

    def command(self, result: TrackerResult | None, time_s: float) -> Command:
        """See Behaviour.command."""
        while not self._keys.empty():
            key = self._keys.get_nowait()
            repeated = key == self._held and time_s <= self._until_s
            self._held, self._direction = key, DIRECTIONS.get(key, (0, 0))
            self._until_s = time_s + (self._settings.repeat_hold_s if repeated else self._settings.first_hold_s)
        forward, left = self._direction
        if not (forward or left) or time_s > self._until_s:
            return STOP
        return self._drive.command(forward * self._settings.forward_m_s, left * self._settings.turn_rad_s)
