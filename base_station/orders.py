"""What an operator may want of a running station, from a key, the console or a recording.

An order takes effect at the beginning of a frame, and the station tells with which: so a recording that holds orders
and frames can be run again, and gives the same results. `stop` and `release` alone do not wait for a frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from base_station.types import Box

KINDS = ("learn", "tracker", "shadow", "behaviour", "drive", "remember", "stop", "release")
LANDMARK = "landmark:"
"""A tracker named so and the landmark's name follows that landmark."""
LONGEST_NAME = 512


@dataclass(frozen=True, kw_only=True)
class Order:
    """One wish. Raises ValueError when it makes no sense.

    `learn`: the target in `box` (x, y, width, height in px of the whole frame), without it the whole view; `tracker`,
    `shadow`, `behaviour`: go on with the one called `name` (no name: no shadow); `drive`: in teleop, go `forward` and
    turn `left` (-1..1 of the fastest) for a moment; `remember`: what is in `box` as the landmark `name`; `stop`,
    `release`: the robot's emergency stop.
    """

    kind: str
    name: str = ""
    box: tuple[float, float, float, float] | None = None
    forward: float = 0.0
    left: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"there is no order {self.kind[:40]!r}; there are {', '.join(KINDS)}")
        if len(self.name) > LONGEST_NAME:
            raise ValueError(f"a name of {len(self.name)} letters; {LONGEST_NAME} are allowed")
        if not self.name and self.kind in ("tracker", "behaviour", "remember"):
            raise ValueError(f"the order {self.kind} needs a name")
        if not all(math.isfinite(share) and -1 <= share <= 1 for share in (self.forward, self.left)):
            raise ValueError(f"forward and left must be -1..1, not {self.forward} and {self.left}")
        if self.box is not None:
            Box(*self.box)

    @property
    def target(self) -> Box | None:
        """The box; None: the whole view."""
        return None if self.box is None else Box(*self.box)

    @classmethod
    def learn(cls, target: Box | None) -> Order:
        """To learn this target, or the whole view."""
        box = None if target is None else (target.x, target.y, target.width, target.height)
        return cls(kind="learn", box=box)
