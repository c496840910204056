"""How many bytes a tracker needs of one target: what must be kept to find it again, and what the tracker runs on.

The two differ. A running tracker holds work space and what it makes of a target once to be quick afterwards; none of it
needs keeping.
"""

from __future__ import annotations

import types
from collections.abc import Callable

import numpy as np

from base_station.trackers.base import Tracker

_LEAVES = (str, bytes, int, float, complex, bool, type(None), type, types.FunctionType, types.ModuleType, np.generic)


def landmark_bytes(tracker: Tracker, learn: Callable[[], bool]) -> int | None:
    """What must be kept so that a tracker started later finds this target: the tracker's `landmark_bytes` (an int),
    where it has a form for keeping; else what learning adds to its arrays. Calls `learn`; None when it returns False.
    """
    before = array_bytes(tracker)
    if not learn():
        return None
    own = getattr(tracker, "landmark_bytes", None)
    return own if isinstance(own, int) else max(array_bytes(tracker) - before, 0)


def array_bytes(thing: object) -> int:
    """Bytes of all numpy arrays that can be reached through attributes and containers, each memory counted once."""
    total, seen, pending = 0, set[int](), [thing]
    while pending:
        item = pending.pop()
        while isinstance(item, np.ndarray) and isinstance(item.base, np.ndarray):
            item = item.base
        if id(item) in seen or isinstance(item, _LEAVES):
            continue
        seen.add(id(item))
        if isinstance(item, np.ndarray):
            total += item.nbytes
        elif isinstance(item, dict):
            pending += item.values()
        elif isinstance(item, (list, tuple, set, frozenset)):
            pending += item
        else:
            pending += getattr(item, "__dict__", {}).values()
            pending += [getattr(item, name, None) for name in getattr(type(item), "__slots__", ())]
    return total
