"""The optional libraries of the console (extra `console`), each imported in this one place, when it is needed."""

from __future__ import annotations

import importlib.util
from types import ModuleType

from base_station.errors import StationError

MISSING = "The console needs NiceGUI: pip install 'zservo[console]' (or go on without --console)."


def check_installed() -> None:
    """Without loading it. Raises StationError when it is not installed."""
    try:
        found = importlib.util.find_spec("nicegui")
    except ModuleNotFoundError:
        found = None
    if found is None:
        raise StationError(MISSING, usage=True)


def nicegui() -> ModuleType:
    """Pages. Raises StationError when it is not installed."""
    try:
        import nicegui
    except ImportError:
        raise StationError(MISSING, usage=True) from None
    return nicegui


def fastapi() -> ModuleType:
    """What NiceGUI's pages are served by; it comes with it. Raises StationError."""
    nicegui()
    import fastapi
    import fastapi.staticfiles

    return fastapi


def starlette() -> ModuleType:
    """What FastAPI is made of. Raises StationError."""
    nicegui()
    import starlette
    import starlette.routing

    return starlette


def uvicorn() -> ModuleType:
    """The server; it comes with NiceGUI. Raises StationError."""
    nicegui()
    import uvicorn

    return uvicorn
