"""What changes in a picture that stays where it is: light that is uneven, another tone curve, blur.

Each moves edges a little, and a step that does not know of them takes them for movement: a tone curve (gamma, a
camera's own) makes what is bright wider, since its edges are not steps but some pixels wide; light that grows from
one side to the other pulls to the brighter one; a streak carries what lies beside a block into it. So alignment
estimates how much there is of each, along with the step, and forgets it (Hager and Belhumeur, PAMI 1998). All that is
learned once: how the patch changes with each.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from base_station.trackers.ztransform.kernels import HEIGHT, WIDTH
from base_station.trackers.ztransform.pyramid import Pyramid

LIKELY_OFFSET = 60.0
"""Grey levels that light may well add from one side of the target to the other."""
BLUR_CELLS = 2.0
"""A streak as long as so many cells."""
_TONE = (np.arange(256) - 128) / 128
CURVES = tuple(np.round(shape).astype(np.uint8) for shape in (255 * np.square(_TONE), 128 + 127 * _TONE**3))
"""Of grey levels 0..255: with a gain and an offset these two make any tone curve up to the third order. They are laid
over pixels, before cells are made of them: over cells it would be another thing, and does not help."""

Read = Callable[[Pyramid], np.ndarray]


def appearances(pyramid: Pyramid, placement: np.ndarray, read: Read) -> list[np.ndarray]:
    """How the patch changes with each, float32 (cells, cells) for as much of it as may well be.

    `read`: the patch at the placement in a picture, here one that is undisturbed.
    """
    image, patch = pyramid.image, read(pyramid)
    cells = len(patch)
    across = np.broadcast_to(((np.arange(cells) + 0.5) / cells - 0.5).astype(np.float32), patch.shape)
    uneven = [even * ramp for ramp in (across, across.T) for even in (np.float32(LIKELY_OFFSET), patch)]
    toned = [read(Pyramid(cv2.LUT(image, curve))) for curve in CURVES]
    streaks = [_odd(placement[side] / cells * BLUR_CELLS) for side in (WIDTH, HEIGHT)]
    blurred = [read(Pyramid(cv2.blur(image, size))) - patch for size in ((streaks[0], 1), (1, streaks[1]))]
    return [*uneven, *toned, *blurred]


def _odd(length_px: float) -> int:
    """So that the middle stays where it is."""
    return 2 * max(round(length_px / 2), 1) + 1
