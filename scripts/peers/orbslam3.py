"""ORB-SLAM3 on a recorded sequence, shown and scored exactly as base-station evaluate slam shows and scores ours.

A peer to compare with, never a part of zservo: ORB-SLAM3 is GPL-3. scripts/compare-slam runs this in an environment of
its own that has the wheel pyorbslam3, numpy and OpenCV:

    .venv-orbslam3/bin/python scripts/peers/orbslam3.py DIR --vocabulary FILE --settings FILE --json FILE [--realtime]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from base_station.errors import StationError
from base_station.evaluation.slam.run import figures, show
from base_station.evaluation.slam.sequence import read_sequence
from base_station.evaluation.slam.trajectory import Trajectory, read_tum
from base_station.trackers.slam.types import SlamFrame, SlamStatistics
from base_station.types import TrackingState

UNKNOWN = ("points", "maps", "loops", "merges", "relocalizations")
"""What it does not tell from outside."""
NS_PER_S = 1e9


class OrbSlam3:
    """The wheel's monocular system, with the methods that an evaluation calls."""

    def __init__(self, vocabulary: Path, settings: Path) -> None:
        import pyorbslam3

        self._slam: Any = pyorbslam3.Slam(str(vocabulary), str(settings), pyorbslam3.Sensor.MONOCULAR, False)
        self._has_tracked, self._is_closed = False, False
        self._trajectory = self._keyframes = Trajectory.of([])

    def track(self, image: np.ndarray, time_s: float) -> SlamFrame:
        result = self._slam.track_monocular(image, time_s)
        if result.pose_valid:
            self._has_tracked = True
            return SlamFrame(TrackingState.TRACKING, np.linalg.inv(np.array(result.pose_wc, float)))
        state = TrackingState.LOST if self._has_tracked else TrackingState.INITIALIZING
        return SlamFrame(state, reason="ORB-SLAM3 gives no pose")

    def finish(self) -> None:
        """Ends its threads; then its trajectories, which it writes to files only, are final."""
        self.close()
        with tempfile.TemporaryDirectory() as at:
            every, keyframes = Path(at) / "euroc.txt", Path(at) / "keyframes.txt"
            self._slam.save_trajectory_euroc(str(every))
            self._slam.save_keyframe_trajectory_tum(str(keyframes))
            lines = every.read_text().splitlines() if every.is_file() else []
            rows = (line.split() for line in lines)
            tum = Path(at) / "tum.txt"
            tum.write_text("\n".join(f"{float(stamp) / NS_PER_S:.6f} {' '.join(rest)}" for stamp, *rest in rows))
            self._trajectory, self._keyframes = (_read(path) for path in (tum, keyframes))

    def trajectory(self) -> list[tuple[float, np.ndarray]]:
        return list(zip(self._trajectory.times_s, self._trajectory.world_from_cam, strict=True))

    def keyframes(self) -> list[tuple[float, np.ndarray]]:
        return list(zip(self._keyframes.times_s, self._keyframes.world_from_cam, strict=True))

    def points(self) -> np.ndarray:
        return np.empty((0, 3))

    def statistics(self) -> SlamStatistics:
        return SlamStatistics(keyframes=len(self._keyframes))

    def close(self) -> None:
        if not self._is_closed:
            self._is_closed = True
            self._slam.shutdown()


def _read(path: Path) -> Trajectory:
    return read_tum(path) if path.is_file() and path.stat().st_size else Trajectory.of([])


def main() -> int:
    options = argparse.ArgumentParser(prog="orbslam3")
    options.add_argument("folder", type=Path)
    options.add_argument("--vocabulary", type=Path, required=True)
    options.add_argument("--settings", type=Path, required=True)
    options.add_argument("--json", type=Path, required=True)
    options.add_argument("--max-frames", type=int)
    options.add_argument("--realtime", action="store_true")
    given = options.parse_args()
    cv2.setNumThreads(1)
    try:
        sequence = read_sequence(given.folder, camera=str(given.settings), max_frames=given.max_frames)
        slam = OrbSlam3(given.vocabulary, given.settings)
        try:
            found = figures(sequence, show(sequence, slam, realtime=given.realtime))
        finally:
            slam.close()
    except StationError as error:
        print(f"orbslam3: {error}", file=sys.stderr)
        return 1
    given.json.write_text(json.dumps(found | dict.fromkeys(UNKNOWN) | {"tracker": "ORB-SLAM3"}), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
