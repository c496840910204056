"""What is drawn now and then in a terminal, and what is printed where there is none."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from base_station.live_text import LiveText


@pytest.mark.parametrize(("terminal", "own"), [(True, "drawn"), (False, "plain")])
def test_it_draws_now_and_then_and_at_once_when_asked(terminal: bool, own: str) -> None:
    out, made = StringIO(), []

    def text(kind: str, number: int) -> str:
        made.append((kind, number))
        return f"{kind} {number}"

    with LiveText(Console(file=out, force_terminal=terminal, width=80, color_system=None), 60.0) as live:
        for number in range(4):
            live.draw(lambda: text("drawn", number), lambda: text("plain", number), at_once=number == 3)  # noqa: B023
    assert made == [(own, 0), (own, 3)]
    assert f"{own} 0" in out.getvalue() and f"{own} 3" in out.getvalue()
