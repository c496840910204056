"""What may go wrong in the simulated world, as plain numbers; all of it off by default."""

from __future__ import annotations

from dataclasses import dataclass

from robot_agent.errors import AgentError

_MAX_MEAN_SLIP = 0.45
"""Slip fluctuates up to twice its mean; a wheel must keep some of its speed."""


@dataclass(frozen=True, kw_only=True)
class Faults:
    """Faults of the simulated robot and camera. Raises AgentError for a value out of its range."""

    wheel_slip: float = 0.0
    """Mean fraction of its speed that each wheel loses, 0..0.45. Each wheel's loss fluctuates between 0 and twice
    that. The wheels' own measurement knows nothing of it."""
    noise_sigma: float = 2.0
    """Standard deviation of the camera's noise in gray levels, 0..60. 2 is an ordinary camera."""
    blur_s: float = 0.0
    """Exposure time; 0 is an instant. Shorter than the frame period."""
    lost_frames: float = 0.0
    """Fraction of frames that never arrive, 0..0.9."""
    camera_hangs_at_s: float | None = None
    """Scenario time from which the camera delivers nothing any more."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("wheel_slip", 0.0, _MAX_MEAN_SLIP),
            ("noise_sigma", 0.0, 60.0),
            ("blur_s", 0.0, 1.0),
            ("lost_frames", 0.0, 0.9),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise AgentError(f"The fault {name} must be from {low} to {high}, not {value}.")

    @classmethod
    def standard(cls) -> Faults:
        """A bad day: slipping wheels, a noisy camera with a long exposure, every fifth frame lost."""
        return cls(wheel_slip=0.2, noise_sigma=8.0, blur_s=0.030, lost_frames=0.2)
