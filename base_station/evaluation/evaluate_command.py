"""base-station evaluate: trackers of boxes, or SLAM, on recorded sequences whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg, subcommand

from base_station.evaluation.slam.command import EvaluateSlam, evaluate_slam
from base_station.evaluation.tracking_command import EvaluateTracking, evaluate_tracking


@dataclass(frozen=True, kw_only=True)
class Evaluate:
    """Measure a tracker on recorded sequences: tracking (boxes) or slam (poses)."""

    kind: Annotated[
        Annotated[EvaluateTracking, subcommand("tracking")] | Annotated[EvaluateSlam, subcommand("slam")], arg(name="")
    ]


def evaluate(command: Evaluate) -> None:
    """Do it. Raises StationError."""
    if isinstance(command.kind, EvaluateSlam):
        evaluate_slam(command.kind)
    else:
        evaluate_tracking(command.kind)
