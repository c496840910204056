"""Which rows go out: what a station chose, for its connection only, and never beyond what hello names."""

from __future__ import annotations

import pytest

from protocol import FrameFormat, ProtocolError
from robot_agent.bands import Bands

WIDEST = FrameFormat(width=640, height=200, first_row=100, full_height=480)


def test_a_choice_ends_with_its_connection():
    bands = Bands(WIDEST)
    assert bands.of(1) is WIDEST
    bands.choose((150, 180), 1)
    assert bands.of(1).rows == (150, 180)
    assert bands.of(2) is WIDEST
    bands.choose(None, 1)
    assert bands.of(1) is WIDEST


@pytest.mark.parametrize("rows", [(99, 200), (150, 301), (150, 150), (180, 150), (-5, 10)])
def test_rows_that_are_not_there_are_refused_and_change_nothing(rows):
    bands = Bands(WIDEST)
    bands.choose((150, 180), 1)
    with pytest.raises(ProtocolError, match=f"rows {rows[0]}:{rows[1]} cannot be sent: the frames have rows 100:300"):
        bands.choose(rows, 1)
    assert bands.of(1).rows == (150, 180)
