"""What every command does before it computes."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(scope="session", autouse=True)
def one_thread_for_small_matrices() -> Iterator[None]:
    """More threads than free cores wait for each other: a test of SLAM took three times as long."""
    with threadpool_limits(1):
        yield
