"""Work beside the loop: one after the other, and nothing waits for ever for it."""

from __future__ import annotations

import threading
import time

import pytest

from base_station.workshop import Workshop


def test_tasks_are_done_in_order_and_errors_are_the_futures():
    workshop: Workshop[int] = Workshop()
    done: list[int] = []

    def task(number: int) -> int:
        done.append(number)
        if number == 1:
            raise ValueError("no such thing")
        return number

    works = [workshop.submit(lambda number=number: task(number)) for number in range(3)]
    assert workshop.close(5.0)
    assert done == [0, 1, 2] and works[2].result() == 2
    with pytest.raises(ValueError, match="no such thing"):
        works[1].result()


def test_what_is_cancelled_is_not_begun_and_closing_does_not_wait_for_ever():
    workshop: Workshop[None] = Workshop()
    go_on, begun = threading.Event(), threading.Event()

    def slow() -> None:
        begun.set()
        go_on.wait(30)

    long, never = workshop.submit(slow), workshop.submit(lambda: pytest.fail("cancelled"))
    assert begun.wait(5) and never.cancel() and not long.cancel()
    since_s = time.monotonic()
    assert not workshop.close(0.1)
    assert time.monotonic() - since_s < 5
    go_on.set()
    assert long.result(5) is None
