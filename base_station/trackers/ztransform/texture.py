"""Whether there is anything to see: texture above the noise."""

from __future__ import annotations

import cv2
import numpy as np

NOISE_FACTOR = 3.0


def texture_of(
    image: np.ndarray, block: int, *, noise_factor: float = NOISE_FACTOR, noise_lines: int | None = None
) -> float:
    """Texture in grey levels: root mean square of second differences of block means, less what noise would give.

    Second differences do not see an even light, nor one that falls off evenly across a wall. The noise is estimated
    from second differences of pixels, so that a block of 1 px knows none. `image`: (height, width), uint8 unless the
    block is 1 px; `block`: px; 0 if the image has under 3x3 blocks, or less texture than `noise_factor` times what
    noise alone gives. `noise_lines`: in how many rows the noise is measured; None: two per block.
    """
    rows, columns = image.shape[0] // block, image.shape[1] // block
    if min(rows, columns) < 3:
        return 0.0
    cut = image[: rows * block, : columns * block]
    sums = cv2.integral(cut)[::block, ::block]
    means = np.diff(np.diff(sums, axis=0), axis=1).astype(np.float32) / np.float32(block * block)
    across = means[:, 2:] - 2 * means[:, 1:-1] + means[:, :-2]
    down = means[2:] - 2 * means[1:-1] + means[:-2]
    power = float(max((across**2).mean(), (down**2).mean()))
    if block > 1:
        step = block // 2 if noise_lines is None else max(block // 2, len(cut) // noise_lines)
        lines = cut[::step].astype(np.int16)
        fine = lines[:, 2:] - 2 * lines[:, 1:-1] + lines[:, :-2]
        noise = 1.4826 * float(np.median(np.abs(fine))) / np.sqrt(6)
        if noise * noise_factor * np.sqrt(6) / block > np.sqrt(power):
            return 0.0
    return float(np.sqrt(power))
