"""The trackers by name, and trackers out of a user's own file.

A new tracker is one entry here. Loaders import late: choosing one tracker does not load another's libraries.
"""

from __future__ import annotations

import difflib
import importlib.util
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from base_station.trackers.base import Tracker
from base_station.trackers.own import FAILURES

DEFAULT_TRACKER = "ztransform"


class UnknownTracker(ValueError):
    """No tracker of this name; the text lists those that there are."""


def _ztransform() -> Tracker:
    from base_station.trackers.ztransform.tracker import ZTransformTracker

    return ZTransformTracker()


def _z_shift() -> Tracker:
    from base_station.trackers.ztransform.thesis.z_shift import ZShiftTracker

    return ZShiftTracker()


def _z_regions() -> Tracker:
    from base_station.trackers.ztransform.thesis.z_regions import ZRegionsTracker

    return ZRegionsTracker()


def _phase() -> Tracker:
    from base_station.trackers.baselines.phase import PhaseTracker

    return PhaseTracker()


def _phase_row() -> Tracker:
    from base_station.trackers.baselines.phase_row import PhaseRowTracker

    return PhaseRowTracker()


def _ncc() -> Tracker:
    from base_station.trackers.baselines.ncc import NccTracker

    return NccTracker()


def _ratslam() -> Tracker:
    from base_station.trackers.baselines.ratslam import RatSlamTracker

    return RatSlamTracker()


def _klt() -> Tracker:
    from base_station.trackers.baselines.klt import KltTracker

    return KltTracker()


def _ecc() -> Tracker:
    from base_station.trackers.baselines.ecc import EccTracker

    return EccTracker()


def _orb() -> Tracker:
    from base_station.trackers.baselines.orb import OrbTracker

    return OrbTracker()


def _slam() -> Tracker:
    from base_station.trackers.slam.tracker import SlamTracker

    return SlamTracker()


_LOADERS: dict[str, Callable[[], Tracker]] = {
    "ztransform": _ztransform,
    "z-shift": _z_shift,
    "z-regions": _z_regions,
    "phase": _phase,
    "phase-row": _phase_row,
    "ncc": _ncc,
    "ratslam": _ratslam,
    "klt": _klt,
    "ecc": _ecc,
    "orb": _orb,
    "slam": _slam,
}


def tracker_names() -> list[str]:
    """The names that `make_tracker` knows, the default first."""
    return list(_LOADERS)


def make_tracker(name: str = DEFAULT_TRACKER) -> Tracker:
    """A new tracker: by its name, or from a file as `path/to/file.py:ClassName`.

    Such a class takes no constructor arguments and has the methods of `base.Tracker`.
    Raises UnknownTracker for a name that is not known, ValueError for a file that does not give a tracker.
    """
    if ".py:" in name:
        return _from_file(name)
    if name not in _LOADERS:
        raise UnknownTracker(_unknown_text(name))
    return _LOADERS[name]()


def _unknown_text(name: str) -> str:
    near = difflib.get_close_matches(name, _LOADERS, n=1)
    hint = f"; did you mean {near[0]}?" if near else "."
    return f"no tracker {name!r}{hint} There are: {', '.join(_LOADERS)}; or your own as path/to/file.py:ClassName"


def _from_file(name: str) -> Tracker:
    made: Tracker = made_from_file(name, ("learn", "update", "close"))
    return made


def made_from_file(name: str, methods: Sequence[str], *arguments: Any, **options: Any) -> Any:
    """One of the class that `path/to/file.py:ClassName` names, made with these arguments, which has these methods.
    Raises ValueError, which says what is missing or failed."""
    kind = _class_in_file(name)
    try:
        made = kind(*arguments, **options)
    except FAILURES as error:
        said = f"{type(error).__name__}: {error}"
        raise ValueError(f"tracker {name!r}: {kind.__name__}() failed: {said}") from error
    missing = [method for method in methods if not callable(getattr(made, method, None))]
    if missing:
        raise ValueError(f"tracker {name!r}: {kind.__name__} is not a tracker: it has no method {', '.join(missing)}")
    return made


def _class_in_file(name: str) -> type[Any]:
    path_text, _, class_name = name.rpartition(":")
    path = Path(path_text)
    if not path.is_file():
        raise ValueError(f"tracker {name!r}: there is no file {path}")
    module = _import(path, name)
    if not class_name:
        raise ValueError(f"tracker {name!r}: say which class after the colon")
    kind = getattr(module, class_name, None)
    if not isinstance(kind, type):
        classes = [key for key, value in vars(module).items() if isinstance(value, type) and key.endswith("Tracker")]
        raise ValueError(
            f"tracker {name!r}: {path.name} has no class {class_name!r}; it has {', '.join(classes) or 'none'}"
        )
    return kind


def _import(path: Path, name: str) -> ModuleType:
    module_name = f"user_tracker_{path.stem}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"tracker {name!r}: {path} cannot be imported")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses in the file look themselves up there
    try:
        spec.loader.exec_module(module)
    except FAILURES as error:
        del sys.modules[module_name]
        raise ValueError(f"tracker {name!r}: importing {path} failed: {type(error).__name__}: {error}") from error
    return module
