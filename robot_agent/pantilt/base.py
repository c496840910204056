"""What the agent asks of a pan-tilt: turn the camera, tell where it looked. Servos and simulation are twins behind
it."""

from __future__ import annotations

from typing import Protocol

from protocol import PanTiltLimits


class PanTilt(Protocol):
    """Two axes that turn the camera, one above the other: pan about the vertical (left positive), tilt about the
    camera's horizontal axis (up positive), both 0 straight ahead. Any thread may call; no call blocks for longer than
    some milliseconds, except `close`."""

    limits: PanTiltLimits

    def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Turn there, at the slew rate; returns at once. Angles beyond the limits are cut to them. Raises PanTiltError
        when the servos cannot be reached."""
        ...

    def angles_at(self, time_s: float) -> tuple[float, float]:
        """Pan and tilt (rad) at a time of the near past, on the clock of the camera's captures. Hobby servos do not
        tell: this is what was asked of them, at their pace."""
        ...

    def close(self) -> None:
        """Centre the camera, wait until it is there, and let go."""
        ...
