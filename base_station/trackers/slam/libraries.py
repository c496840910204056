"""The optional libraries of the SLAM tracker (extra `slam`), each imported in this one place, when it is needed.

pycolmap comes first: the other way round the two were seen to crash.
"""

from __future__ import annotations

from typing import Any

from base_station.errors import StationError

MISSING = "SLAM needs pycolmap and gtsam: pip install 'zservo[slam]'"


def pycolmap() -> Any:
    """Bundle adjustment. Raises StationError when it is not installed."""
    try:
        import pycolmap
    except ImportError:
        raise StationError(MISSING) from None
    return pycolmap


def gtsam() -> Any:
    """Pose graphs. Raises StationError when it, or pycolmap before it, is not installed."""
    pycolmap()
    try:
        import gtsam
    except ImportError:
        raise StationError(MISSING) from None
    return gtsam
