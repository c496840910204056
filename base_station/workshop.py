"""Work beside the loop, one piece after the other: trackers that take seconds to be made or closed.

A thread that nothing waits for for ever: a program that is told to end does not wait until something is made that
nobody wants any more.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

T = TypeVar("T")


class Workshop(Generic[T]):
    """`submit` from any thread; what comes of it is in the future."""

    def __init__(self) -> None:
        self._tasks: queue.SimpleQueue[tuple[Callable[[], T], Future[T]] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="workshop", daemon=True)
        self._thread.start()

    def submit(self, task: Callable[[], T]) -> Future[T]:
        """Do this when all that was submitted before is done."""
        future: Future[T] = Future()
        self._tasks.put((task, future))
        return future

    def close(self, patience_s: float) -> bool:
        """Wait so long at the most for what is still to be done; whether it was. Nothing may be submitted after it."""
        self._tasks.put(None)
        self._thread.join(patience_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while (item := self._tasks.get()) is not None:
            task, future = item
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(task())
            except BaseException as error:  # the future's holder learns of it
                future.set_exception(error)
