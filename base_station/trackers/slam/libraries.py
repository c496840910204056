"""The optional libraries of the SLAM tracker (extra `slam`), each imported in this one place, when it is needed.

pycolmap comes first: the other way round the two were seen to crash.
"""

from __future__ import annotations

import ctypes
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from base_station.errors import StationError

MISSING = "SLAM needs pycolmap and gtsam: pip install 'zservo[slam]'"


def pycolmap() -> Any:
    """Bundle adjustment. Raises StationError when it is not installed."""
    try:
        with _sigterm_kept():
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


@contextmanager
def _sigterm_kept() -> Iterator[None]:
    """pycolmap takes SIGTERM for a crash: it prints a stack, and leaves no turn to who wants to end in order. Python's
    own `signal.signal` works in the main thread only, and a tracker may be made in another."""
    handler_of, set_handler = ctypes.pythonapi.PyOS_getsig, ctypes.pythonapi.PyOS_setsig
    handler_of.restype = set_handler.restype = ctypes.c_void_p
    handler_of.argtypes, set_handler.argtypes = [ctypes.c_int], [ctypes.c_int, ctypes.c_void_p]
    before = handler_of(signal.SIGTERM)
    try:
        yield
    finally:
        set_handler(signal.SIGTERM, before)
