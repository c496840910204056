"""Pictures as JPEG that keep to a budget: good ones where the camera is quiet, coarser ones where it is noisy.

Noise is most of what a JPEG of a dark room holds. At a fixed quality ten minutes would be anything from 0.6 to 2 GB.
"""

from __future__ import annotations

import cv2
import numpy as np

BEST, WORST = 90, 40
BYTES_PER_PX = 0.2
"""The mean that is kept to: 61 kB for 640x480, 1.1 GB in ten minutes at 30 per second."""
FINE_SHARE = 0.9
"""With less than this of the budget the quality rises again."""


class JpegEncoder:
    """For the pictures of one camera, in their order."""

    def __init__(self) -> None:
        self.quality = BEST
        """Of the next picture."""

    def encode(self, image: np.ndarray) -> bytes:
        """A gray picture, uint8 (height, width). The quality follows from one picture to the next, by a little."""
        data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, self.quality))[1].tobytes()
        budget = BYTES_PER_PX * image.size
        if len(data) > budget:
            self.quality = max(WORST, self.quality - 1)
        elif len(data) < FINE_SHARE * budget:
            self.quality = min(BEST, self.quality + 1)
        return data
