"""Wheels that lose grip: each wheel loses a fraction of its speed that wanders on its own."""

from __future__ import annotations

import math

import numpy as np

_CORRELATION_S = 0.5


class WheelSlip:
    """The fraction of its speed that each wheel keeps. The loss is spread evenly between 0 and twice its mean."""

    def __init__(self, *, mean: float, step_s: float, seed: int) -> None:
        """`mean`: mean loss, 0..0.5; `step_s`: time between calls of `step`."""
        self._mean = mean
        self._rng = np.random.default_rng(seed)
        self._memory = math.exp(-step_s / _CORRELATION_S)
        self._fresh = math.sqrt(1.0 - self._memory**2)
        self._state = [float(value) for value in self._rng.standard_normal(2)]

    def step(self) -> None:
        """Let one time step pass."""
        if self._mean > 0.0:
            fresh = self._rng.standard_normal(2)
            pairs = zip(self._state, fresh, strict=True)
            self._state = [self._memory * old + self._fresh * float(new) for old, new in pairs]

    @property
    def kept(self) -> tuple[float, float]:
        """Left and right, 1 without loss."""
        left, right = (1.0 - 2.0 * self._mean * _normal_cdf(value) for value in self._state)
        return left, right


def _normal_cdf(value: float) -> float:
    """Makes the Gaussian wandering an even spread over 0..1."""
    return 0.5 * (1.0 + math.erf(value / math.sqrt(2.0)))
