"""Where the target will be in the next frame, if it goes on as it did: constant velocity, by the frames' own times.

In plain numbers: for arrays of five, numpy takes ten times as long.
"""

from __future__ import annotations

import math

import numpy as np

LONGEST_GUESS_S = 0.5
SMOOTHING = 0.5


class Motion:
    """Last placement and its velocity; sizes go by their logarithm."""

    def __init__(self) -> None:
        self.start(np.array([0.0, 0.0, 1.0, 1.0, 0.0]), 0.0)

    def start(self, placement: np.ndarray, time_s: float) -> None:
        """Seen for the first time, or again: no velocity known."""
        self.last, self._time_s = placement.copy(), time_s
        """The placement last seen."""
        self._linear, self._velocity = _linear(placement), [0.0] * 4

    def observe(self, placement: np.ndarray, time_s: float) -> None:
        """Seen in the next frame."""
        elapsed_s, now, old = time_s - self._time_s, _linear(placement), self._linear
        if elapsed_s > 0:
            keep, take, v = 1 - SMOOTHING, SMOOTHING / elapsed_s, self._velocity
            self._velocity = [keep * v[i] + take * (now[i] - old[i]) for i in range(4)]
        self.last, self._linear, self._time_s = placement.copy(), now, time_s

    def age_s(self, time_s: float) -> float:
        """How long ago it was last seen."""
        return time_s - self._time_s

    def predict(self, time_s: float) -> np.ndarray:
        """The placement expected at this time; the guess does not reach further than half a second.

        The keystone stays: it is too noisy to extrapolate.
        """
        elapsed_s = min(max(time_s - self._time_s, 0.0), LONGEST_GUESS_S)
        (x, y, log_width, log_height), v = self._linear, self._velocity
        width, height = math.exp(log_width + v[2] * elapsed_s), math.exp(log_height + v[3] * elapsed_s)
        return np.array((x + v[0] * elapsed_s, y + v[1] * elapsed_s, width, height, self.last[4]))


def _linear(placement: np.ndarray) -> list[float]:
    """x, y and the logarithms of width and height."""
    x, y, width, height, _ = placement.tolist()
    return [x, y, math.log(width), math.log(height)]
