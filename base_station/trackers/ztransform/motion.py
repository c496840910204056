"""Where the target will be in the next frame, if it goes on as it did: constant velocity, by the frames' own times."""

from __future__ import annotations

import numpy as np

from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH

LONGEST_GUESS_S = 0.5
SMOOTHING = 0.5


class Motion:
    """Last placement and its velocity; sizes go by their logarithm."""

    def __init__(self) -> None:
        self.last = np.zeros(5)
        """The placement last seen."""
        self._velocity = np.zeros(5)
        self._time_s = 0.0

    def start(self, placement: np.ndarray, time_s: float) -> None:
        """Seen for the first time, or again: no velocity known."""
        self.last, self._time_s = placement.copy(), time_s
        self._velocity = np.zeros(5)

    def observe(self, placement: np.ndarray, time_s: float) -> None:
        """Seen in the next frame."""
        elapsed_s = time_s - self._time_s
        if elapsed_s > 0:
            now = (_linear(placement) - _linear(self.last)) / elapsed_s
            self._velocity = (1 - SMOOTHING) * self._velocity + SMOOTHING * now
            self._velocity[4] = 0  # the keystone is too noisy to extrapolate
        self.last, self._time_s = placement.copy(), time_s

    def age_s(self, time_s: float) -> float:
        """How long ago it was last seen."""
        return time_s - self._time_s

    def predict(self, time_s: float) -> np.ndarray:
        """The placement expected at this time; the guess does not reach further than half a second."""
        elapsed_s = min(max(time_s - self._time_s, 0.0), LONGEST_GUESS_S)
        ahead = _linear(self.last) + self._velocity * elapsed_s
        ahead[[WIDTH, HEIGHT]] = np.exp(ahead[[WIDTH, HEIGHT]])
        return ahead


def _linear(placement: np.ndarray) -> np.ndarray:
    out = placement.copy()
    out[[WIDTH, HEIGHT]] = np.log(out[[WIDTH, HEIGHT]])
    return out
