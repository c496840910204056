"""Files that a person names for what comes of a command: checked before the work is done, written after it."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import IO, Any

from base_station.errors import StationError


def check_output(flag: str, path: Path | None, kinds: Sequence[str] = ()) -> None:
    """Find out now, not after a long run, that a file cannot be written. `kinds`: what its name may end in.

    None is no file, and right. Raises StationError.
    """
    if path is None:
        return
    if path.is_dir():
        raise StationError(f"{flag}: {path} is a folder; name a file.", usage=True)
    if not path.parent.is_dir():
        raise StationError(f"{flag} {path}: there is no folder {path.parent}.", usage=True)
    if kinds and path.suffix.lower() not in kinds:
        raise StationError(f"{flag}: name a file that ends in {' or '.join(kinds)}, not {path.name}.", usage=True)
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise StationError(f"{flag}: {path} cannot be written.", usage=True)


def write_json(path: Path, figures: Any) -> None:
    """Raises StationError when it cannot be written."""
    write_bytes(path, (json.dumps(figures, indent=2) + "\n").encode())


def replace_file(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    """Let `write` fill a file that takes this one's place when it is whole. Raises StationError when it cannot."""
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                write(file)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error


def write_bytes(path: Path, data: bytes) -> None:
    """Raises StationError when it cannot be written."""
    try:
        path.write_bytes(data)
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error
