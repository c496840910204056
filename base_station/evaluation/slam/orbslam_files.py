"""What ORB-SLAM3 reads: its settings for a camera of ours, and our vocabulary in the text format of DBoW2."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.vocabulary import Vocabulary
from protocol import Intrinsics
from protocol.camera_file import CameraFile, write_camera_file

ORB_LEVELS = 6
"""ORB-SLAM matches within nodes that are four levels above the deepest possible word: of our tree, in its second."""


def write_settings(path: Path, camera: SlamCamera, fps: float) -> None:
    """ORB-SLAM3's YAML for this camera, with the settings that its monocular examples have."""
    own = Intrinsics(fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy, distortion=tuple(camera.distortion))
    file = CameraFile(intrinsics=own, size=(camera.width_px, camera.height_px))
    path.write_text(write_camera_file(file, fps=fps), encoding="ascii")


def write_vocabulary(path: Path, vocabulary: Vocabulary) -> None:
    """A line per node, parents first: its parent's number, 1 for a word, 32 bytes, the word's weight."""
    branching, depth = vocabulary.branching, vocabulary.depth
    rows = vocabulary.centers.view(np.uint8).reshape(-1, 32)
    lines, first_parent, row = [f"{branching} {ORB_LEVELS} 0 0"], 0, 0
    for level in range(1, depth + 1):
        for place in range(branching**level):
            weight = vocabulary.weights[place] if level == depth else 0.0
            descriptor = " ".join(map(str, rows[row].tolist()))
            lines.append(f"{first_parent + place // branching} {int(level == depth)} {descriptor} {weight:.6g}")
            row += 1
        first_parent += branching ** (level - 1)
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
