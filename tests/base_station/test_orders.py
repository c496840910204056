"""Orders from outside: what makes sense, and what is refused."""

from __future__ import annotations

import math

import pytest

from base_station.orders import LONGEST_NAME, Order
from base_station.types import Box
from protocol import ProtocolError
from protocol.records import from_bytes, to_bytes


@pytest.mark.parametrize(
    "order",
    [
        Order(kind="learn", box=(1.5, 2, 30, 40)),
        Order(kind="tracker", name="slam"),
        Order(kind="shadow"),
        Order(kind="drive", forward=-1, left=0.25),
        Order(kind="stop"),
    ],
)
def test_an_order_crosses_a_wire(order):
    assert from_bytes(Order, to_bytes(order)) == order


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"kind": "dance"}, "dance"),
        ({"kind": "tracker"}, "needs a name"),
        ({"kind": "behaviour", "name": "x" * (LONGEST_NAME + 1)}, "letters"),
        ({"kind": "learn", "box": (0, 0, -1, 4)}, "not a box"),
        ({"kind": "learn", "box": (0, math.nan, 1, 4)}, "not a box"),
        ({"kind": "drive", "forward": 1.5}, "-1..1"),
        ({"kind": "drive", "left": math.inf}, "-1..1"),
    ],
)
def test_nonsense_is_refused_in_words(fields, said):
    with pytest.raises(ValueError, match=said):
        Order(**fields)


def test_nonsense_from_the_wire_is_refused():
    with pytest.raises(ProtocolError, match="dance"):
        from_bytes(Order, b"\x81\xa4kind\xa5dance")


def test_the_whole_view_has_no_box():
    assert Order.learn(None).target is None
    assert Order.learn(Box(1, 2, 3, 4)).target == Box(1, 2, 3, 4)
