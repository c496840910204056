"""Text that a terminal shows in one place, drawn anew now and then; elsewhere (a file, a log) a line at times."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Self

from rich.console import Console, RenderableType
from rich.live import Live

PLAIN_REFRESH_S = 2.0
"""Without a terminal: a line of text this often."""


class LiveText:
    """Use as a context manager. `refresh_s`: in a terminal, so often at the most."""

    def __init__(self, console: Console, refresh_s: float) -> None:
        self._console = console
        self._live = Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        self._refresh_s = refresh_s if self._live is not None else PLAIN_REFRESH_S
        self._drawn_s = float("-inf")

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def draw(self, drawn: Callable[[], RenderableType], plain: Callable[[], str], *, at_once: bool = False) -> None:
        """As often as one likes. `plain`: the line without a terminal; neither is made when it is not yet time."""
        now_s = time.monotonic()
        if not at_once and now_s - self._drawn_s < self._refresh_s:
            return
        self._drawn_s = now_s
        if self._live is not None:
            self._live.update(drawn(), refresh=True)
        else:
            self._console.print(plain(), soft_wrap=True, markup=False, highlight=False)
