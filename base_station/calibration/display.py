"""What the person who holds the board sees in the terminal: where corners were seen, and what to do next."""

from __future__ import annotations

import math

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from base_station.calibration.collector import Collector, Verdict
from base_station.calibration.detection import BoardView
from base_station.calibration.solving import NAMES, Calibration
from base_station.live_text import LiveText

REFRESH_S = 0.1
CELL = "▄▄▄▄ "
SHADES = ((0, "grey30"), (1, "dark_green"), (6, "green3"), (20, "bright_green"))
"""From so many corners on."""


class CollectingDisplay(LiveText):
    """Call `show` with every picture: it draws now and then, and at once when a view is taken."""

    def __init__(self, console: Console, collector: Collector, hint: str) -> None:
        super().__init__(console, REFRESH_S)
        self._collector, self._hint = collector, hint

    def show(self, verdict: Verdict, view: BoardView | None = None) -> None:
        """What became of a picture."""
        self.draw(lambda: self._picture(verdict, view), lambda: self._line(verdict), at_once=verdict.taken)

    def _line(self, verdict: Verdict) -> str:
        found = self._collector
        return f"{len(found.views)} views, {found.covered:.0%} of the picture: {verdict.text}"

    def _picture(self, verdict: Verdict, view: BoardView | None) -> Group:
        found = self._collector
        marks = set()
        if view is not None:
            rows, columns = found.coverage.shape
            cells = (view.points_px / view.size_px * (columns, rows)).astype(int)
            marks = {(int(row), int(column)) for column, row in cells}
        lines = [Text("  where corners were seen (underlined: now)", style="dim")]
        for row, counts in enumerate(found.coverage):
            line = Text("  ")
            for column, count in enumerate(counts):
                shade = [style for least, style in SHADES if count >= least][-1]
                line.append(CELL, style=f"{shade} underline" if (row, column) in marks else shade)
            lines.append(line)
        sharp = f"edges {view.edge_px:.1f} px (sharp: <= {found.settings.sharp_px:g})" if view is not None else ""
        lines.append(Text(f"  {len(found.views)} of {found.settings.least_views} views  {sharp}"))
        lines.append(Text(f"  {verdict.text}", style="bold green" if verdict.taken else "bold yellow"))
        lines += [Text(f"  still to do: {lack}", style="dim") for lack in found.lacks()]
        lines.append(Text(f"  {self._hint}", style="dim"))
        return Group(*lines)


def calibration_table(found: Calibration, views: int) -> Table:
    """What a person wants to know of a calibration. `views`: how many were taken."""
    own, (width, height) = found.file.intrinsics, found.file.size or (0, 0)
    table = Table(title=f"camera of {width}x{height} px", show_header=False)
    values = dict(zip(NAMES, (own.fx, own.fy, own.cx, own.cy, *own.distortion), strict=False))
    for name, value in values.items():
        is_px = name[0] in "fc"
        form = "{:.2f} ± {:.2f} px" if is_px else "{:+.5f} ± {:.5f}"
        table.add_row(name, form.format(value, found.deviations.get(name, 0.0)))
    across, down = map(math.degrees, found.fov_rad)
    table.add_row("field of view", f"{across:.2f}° x {down:.2f}°")
    table.add_row("reprojection error, RMS", f"{found.rms_px:.3f} px")
    table.add_row("of each view", _wrapped([f"{error:.2f}" for error in found.errors_px]))
    table.add_row("views", f"{len(found.kept)} of {views}" + _left_out(found))
    return table


def _left_out(found: Calibration) -> str:
    if not found.left_out:
        return ""
    return f"; number {', '.join(str(number + 1) for number in found.left_out)} fitted badly"


def _wrapped(words: list[str], a_line: int = 10) -> str:
    return "\n".join(" ".join(words[start : start + a_line]) for start in range(0, len(words), a_line))
