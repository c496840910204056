"""Whether there is anything to see: texture above the noise."""

from __future__ import annotations

import numpy as np

NOISE_FACTOR = 3.0


def texture_of(image: np.ndarray, block: int) -> float:
    """Texture in grey levels: root mean square of second differences of block means, less what noise would give.

    Second differences do not see an even light, nor one that falls off evenly across a wall. The noise is estimated
    from the differences inside of blocks. `image`: (height, width), `block`: px; 0 if the image has under 3x3 blocks.
    """
    rows, columns = image.shape[0] // block, image.shape[1] // block
    if min(rows, columns) < 3:
        return 0.0
    cut = image[: rows * block, : columns * block]
    means = cut.reshape(rows, block, columns, block).mean((1, 3), dtype=np.float32)
    across = means[:, 2:] - 2 * means[:, 1:-1] + means[:, :-2]
    down = means[2:] - 2 * means[1:-1] + means[:-2]
    power = float(max((across**2).mean(), (down**2).mean()))
    if block > 1:
        fine = cut[:: block // 2, 1:].astype(np.float32) - cut[:: block // 2, :-1]
        noise = 1.4826 * float(np.median(np.abs(fine))) / np.sqrt(2)
        if noise * NOISE_FACTOR * np.sqrt(6) / block > np.sqrt(power):
            return 0.0
    return float(np.sqrt(power))
