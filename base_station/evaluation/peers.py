"""OpenCV's own trackers of loose targets, as peers to compare with: MOSSE, KCF, CSRT.

They are in OpenCV's contrib wheel, which shares its module's name with the wheel that the station uses. So this runs as
a program, in an environment of its own (`scripts/benchmark-otb --peers` makes it), and needs numpy and OpenCV
only:

    python -m base_station.evaluation.peers DIR --json FILE

They get colour pictures and a box in whole pixels, as they would be used.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from base_station.errors import StationError
from base_station.evaluation.sequences import find_sequences, run_sequence
from base_station.types import Box

PEERS = ("mosse", "kcf", "csrt")


class PeerFollower:
    """One of OpenCV's trackers as a `sequences.Follower`."""

    flags = cv2.IMREAD_COLOR

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make = make

    def start(self, image: np.ndarray, box: Box) -> None:
        """Raises ValueError for a box that is empty in whole pixels."""
        sides = tuple(round(side) for side in (box.x, box.y, box.width, box.height))
        if min(sides[2:]) < 1:
            raise ValueError(f"it is {sides[2]}x{sides[3]} px")
        self._peer = self._make()
        self._peer.init(image, sides)

    def next(self, image: np.ndarray) -> Box | None:
        """The box, or None when it says that it failed."""
        found, (x, y, width, height) = self._peer.update(image)
        return Box(float(x), float(y), float(width), float(height)) if found and min(width, height) > 0 else None


def make_peer(name: str) -> PeerFollower:
    """By its name in PEERS. Raises StationError when this OpenCV does not have it."""
    home = getattr(cv2, "legacy", None) if name == "mosse" else cv2
    make = getattr(home, f"Tracker{name.upper()}_create", None)
    if make is None:
        raise StationError(f"OpenCV {cv2.__version__} here has no {name}: the contrib wheel is needed.")
    return PeerFollower(make)


def main() -> int:
    """Scores of every peer on every sequence, as JSON {peer: [score, ...]}."""
    options = argparse.ArgumentParser(prog="peers")
    options.add_argument("folder", type=Path)
    options.add_argument("--max-frames", type=int)
    options.add_argument("--json", type=Path, required=True)
    given = options.parse_args()
    cv2.setNumThreads(1)
    scores: dict[str, list[dict[str, Any]]] = {name: [] for name in PEERS}
    try:
        for sequence in find_sequences(given.folder, given.max_frames):
            for name in PEERS:
                scores[name].append(asdict(run_sequence(sequence, make_peer(name))))
                print(f"{sequence.name}: {name} done", file=sys.stderr)
    except StationError as error:
        print(f"peers: {error}", file=sys.stderr)
        return 1
    given.json.write_text(json.dumps(scores), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
