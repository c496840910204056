"""Which views are kept and what is said: still, sharp and new ones, until the picture is covered from all sides."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from base_station.calibration.board import CalibrationBoard
from base_station.calibration.collector import Collector, CollectorSettings
from base_station.calibration.detection import BoardView
from tests.base_station.calibration.boards import SIZE, drawn_view, seen

BOARD = CalibrationBoard()
ONE_BY_ONE = CollectorSettings(still_px=None)


def view_at(x: float, y: float, depth_m: float = 0.45, rotation=(0.0, 0.0, 0.0), edge_px: float = 2.0) -> BoardView:
    """The board's middle at x, y (m) from the axis."""
    points = seen(BOARD, np.array(rotation), np.array([x - 0.105, y - 0.075, depth_m]))
    inside = np.flatnonzero(((points >= 0) & (points < SIZE)).all(axis=1))
    return BoardView(
        board=BOARD, size_px=SIZE, ids=inside, points_px=points[inside].astype(np.float32), edge_px=edge_px
    )


def test_a_view_is_taken_when_it_stands_still_is_sharp_and_new():
    collector = Collector()
    assert collector.consider(None).text.startswith("no board in view")
    first = view_at(0, 0)
    assert collector.consider(first).text == "hold still", "nobody knows yet"
    assert collector.consider(first).taken
    assert not collector.consider(first).taken, "the same again"
    assert collector.consider(view_at(0.08, 0)).text == "hold still"
    blurred = view_at(0.08, 0, edge_px=9.0)
    assert "too blurred (edges of 9.0 px)" in collector.consider(blurred).text
    assert collector.consider(view_at(0.08, 0)).taken
    assert len(collector.views) == 2


def test_still_means_less_than_a_pixel():
    for step_m, still in ((0.0003, True), (0.003, False)):
        collector = Collector()
        collector.consider(view_at(0, 0))
        assert collector.consider(view_at(step_m, 0)).taken == still


def test_it_says_where_nothing_was_seen():
    """Everything but one corner of the picture is covered: it asks for that one."""
    for x, y, said in ((-1, -1, "upper left"), (1, -1, "upper right"), (-1, 1, "lower left"), (1, 1, "lower right")):
        collector = Collector(ONE_BY_ONE)
        collector.consider(view_at(0, 0))
        collector.coverage[:] = 1
        rows = slice(0, 2) if y < 0 else slice(2, 4)
        columns = slice(0, 2) if x < 0 else slice(4, 6)
        collector.coverage[rows, columns] = 0
        assert collector.lacks()[0] == f"move it to the {said} of the picture"


def test_it_asks_for_tilts_and_for_another_distance():
    collector = Collector(ONE_BY_ONE)
    collector.consider(view_at(0, 0))
    assert [lack for lack in collector.lacks() if "tilt" in lack] == [
        f"tilt it: its {side} side away" for side in ("right", "left", "upper", "lower")
    ]
    assert collector.lacks()[-1] == "bring it nearer"
    for turn in ((0, -0.35, 0), (0, -0.6, 0), (0, 0.4, 0), (0.4, 0, 0)):
        assert collector.consider(view_at(-0.02 * turn[1], 0, rotation=turn)).taken
    assert [lack for lack in collector.lacks() if "tilt" in lack] == [
        f"tilt it: its {side} side away" for side in ("left", "upper", "lower")
    ]


def test_random_views_are_enough_in_the_end():
    """With all that it asks for it ends by itself, and not before the least number of views."""
    rng, collector = np.random.default_rng(2), Collector(ONE_BY_ONE)
    for _ in range(300):
        collector.consider(drawn_view(rng, BOARD))
        if collector.enough:
            break
    assert collector.settings.least_views <= len(collector.views) <= collector.settings.most_views
    assert collector.covered >= 0.85 and collector.lacks() == []


def test_it_ends_even_when_something_is_never_shown():
    collector = Collector(dataclasses.replace(ONE_BY_ONE, most_views=4, new=0.0))
    for _ in range(4):
        assert not collector.enough
        collector.consider(view_at(0, 0))
    assert collector.enough and collector.lacks()


def test_pictures_of_other_sizes_are_no_motion():
    collector = Collector()
    collector.consider(dataclasses.replace(view_at(0, 0), size_px=(320, 240)))
    assert collector.consider(view_at(0, 0)).text == "hold still"


@pytest.mark.parametrize("count", [1, 5])
def test_coverage_counts_corners(count):
    collector = Collector(dataclasses.replace(ONE_BY_ONE, new=0.0))
    view = view_at(0, 0)
    for _ in range(count):
        collector.consider(view)
    assert collector.coverage.sum() == count * len(view.ids)
