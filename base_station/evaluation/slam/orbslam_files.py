"""What ORB-SLAM3 reads: its settings for a camera of ours, and our vocabulary in the text format of DBoW2."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.vocabulary import Vocabulary

ORB_LEVELS = 6
"""ORB-SLAM matches within nodes that are four levels above the deepest possible word: of our tree, in its second."""
SETTINGS = """%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: {fx}
Camera1.fy: {fy}
Camera1.cx: {cx}
Camera1.cy: {cy}
Camera1.k1: {k1}
Camera1.k2: {k2}
Camera1.p1: {p1}
Camera1.p2: {p2}
{k3}Camera.width: {width}
Camera.height: {height}
Camera.fps: {fps}
Camera.RGB: 0
ORBextractor.nFeatures: 1000
ORBextractor.scaleFactor: 1.2
ORBextractor.nLevels: 8
ORBextractor.iniThFAST: 20
ORBextractor.minThFAST: 7
Viewer.KeyFrameSize: 0.05
Viewer.KeyFrameLineWidth: 1.0
Viewer.GraphLineWidth: 0.9
Viewer.PointSize: 2.0
Viewer.CameraSize: 0.08
Viewer.CameraLineWidth: 3.0
Viewer.ViewpointX: 0.0
Viewer.ViewpointY: -0.7
Viewer.ViewpointZ: -1.8
Viewer.ViewpointF: 500.0
"""


def write_settings(path: Path, camera: SlamCamera, fps: float) -> None:
    """ORB-SLAM3's YAML for this camera, with the settings that its monocular examples have."""
    k1, k2, p1, p2, k3 = (*camera.distortion, *(0.0,) * (5 - len(camera.distortion)))
    text = SETTINGS.format(
        fx=float(camera.fx), fy=float(camera.fy), cx=float(camera.cx), cy=float(camera.cy), k1=k1, k2=k2, p1=p1, p2=p2,
        k3=f"Camera1.k3: {k3}\n" if k3 else "", width=camera.width_px, height=camera.height_px, fps=max(round(fps), 1),
    )  # fmt: skip
    path.write_text(text, encoding="ascii")


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
