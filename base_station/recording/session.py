"""The recording of a run of the station: what is told of the run, and how the recording comes to its end."""

from __future__ import annotations

import contextlib
import logging
import platform
from collections.abc import Iterator
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from base_station.link import Link
from base_station.recording.recorder import Recorder

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

log = logging.getLogger(__name__)

PACKAGES = ("zservo", "numpy", "opencv-python-headless", "numba", "pycolmap", "gtsam", "foxglove-sdk")
"""Whose versions are told: with others a replay may give other results."""


@contextlib.contextmanager
def recording_of(run: DataclassInstance, path: Path, link: Link, *, raw: bool) -> Iterator[Recorder]:
    """A recorder of this run, closed at the end. `run`: its options. Raises StationError as `Recorder` does."""
    recorder = Recorder(path, raw=raw, run=told_of(run), hello=lambda: link.hello, driven=link.driven)
    try:
        yield recorder
    finally:
        recorder.close()
        log.info("recorded %s", recorder.described())


def told_of(run: DataclassInstance) -> dict[str, Any]:
    """The run's options and the versions of what it runs on."""
    options = {name: str(value) if isinstance(value, Path) else value for name, value in asdict(run).items()}
    return {"options": options, "versions": _versions()}


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        with contextlib.suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
