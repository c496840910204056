"""What is written over a recorded picture: the boxes of what was seen in it, and a few words."""

from __future__ import annotations

from dataclasses import dataclass

from base_station.station import Step
from base_station.types import TrackerResult, TrackingState

COLOURS = {
    TrackingState.TRACKING: (0.24, 0.86, 0.52), TrackingState.LOST: (1.0, 0.42, 0.37),
    TrackingState.INITIALIZING: (1.0, 0.76, 0.28),
}  # fmt: skip
"""As the console has them; of what the steering tracker sees..."""
SHADOW_COLOUR = (0.35, 0.72, 1.0)
"""...and its shadow."""
LINE_PX = 20.0
"""Between two lines of text where there is no box to write at."""


@dataclass(frozen=True, kw_only=True)
class Label:
    """What is written over a picture, in its pixels: `at_px` is where the text begins; box as x, y, width, height."""

    text: str
    at_px: tuple[float, float]
    colour: tuple[float, float, float]
    """Red, green, blue from 0 to 1."""
    box: tuple[float, float, float, float] | None = None


def labels_of(step: Step) -> list[Label]:
    """What was seen, in the pixels of the picture that is recorded: of a band of rows, its own."""
    seen = [_label(step.result, step.tracker, step.frame.first_row, 0, COLOURS[step.result.state])]
    if step.shadow is not None:
        seen.append(_label(step.shadow, step.shadow_tracker or "", step.frame.first_row, 1, SHADOW_COLOUR))
    return seen


def _label(result: TrackerResult, tracker: str, first_row: int, line: int, colour: tuple[float, float, float]) -> Label:
    words = [tracker.rpartition("/")[2][:80], result.state.value.lower()]
    words += [] if result.zoom is None else [f"x{result.zoom:.3f}"]
    box = result.box
    if box is None:
        return Label(text=" ".join(words), at_px=(6.0, LINE_PX * (line + 1)), colour=colour)
    drawn = float(box.x), float(box.y) - first_row, float(box.width), float(box.height)
    return Label(text=" ".join(words), at_px=(drawn[0], drawn[1] - LINE_PX * line - 3), colour=colour, box=drawn)
