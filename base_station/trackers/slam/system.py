"""The SLAM system as the outside sees it: pictures in, poses out; a map and a trajectory at the end."""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.types import SlamFrame, SlamStatistics

__all__ = ["SlamCamera", "SlamFrame", "SlamSettings", "SlamStatistics", "SlamSystem"]


@dataclass(frozen=True, kw_only=True)
class SlamSettings:
    """The settings of all stages."""


class SlamSystem:
    """Monocular SLAM. A context manager: `close()` ends the mapper's process."""

    def __init__(
        self,
        camera: SlamCamera,
        *,
        settings: SlamSettings | None = None,
        single_process: bool = False,
        seed: int = 0,
    ) -> None:
        raise NotImplementedError

    def track(self, image: np.ndarray, time_s: float) -> SlamFrame:
        """The pose of this gray uint8 picture. Never raises for a bad picture: LOST, with the reason."""
        raise NotImplementedError

    def finish(self) -> None:
        """Let the mapper work off its queue; then `trajectory` and `keyframes` are final."""
        raise NotImplementedError

    def trajectory(self) -> list[tuple[float, np.ndarray]]:
        """(time_s, world_from_cam 4x4) of every tracked frame of the largest map, from its keyframe's final pose."""
        raise NotImplementedError

    def keyframes(self) -> list[tuple[float, np.ndarray]]:
        """(time_s, world_from_cam 4x4) of the largest map's keyframes."""
        raise NotImplementedError

    def points(self) -> np.ndarray:
        """(n, 3) points of the largest map, metres up to scale."""
        raise NotImplementedError

    def statistics(self) -> SlamStatistics:
        raise NotImplementedError

    def close(self) -> None:
        """End the mapper's process. May be called twice."""

    def __enter__(self) -> SlamSystem:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
