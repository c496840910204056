"""Where the mapper runs: in the caller's process, at once; or in one of its own, while the tracker goes on.

Both are used alike: `send` work, `receive` updates of the map. In a process of its own the mapper works on while the
tracker goes on with a copy of the map that is some keyframes behind. The process ends with `close`, and by itself
when the tracker's process is gone.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from typing import Any, Protocol

from threadpoolctl import threadpool_limits

from base_station.errors import StationError
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import MapUpdate
from base_station.trackers.slam.mapper import Forget, Mapper, NewKeyframe, NewMap, Settle, TakeUp
from base_station.trackers.slam.rehearsal import rehearse_mapping
from base_station.trackers.slam.settings import SlamSettings

LOOK_EVERY_S = 0.5
READY_WITHIN_S = 90
READY_LOOKS = int(READY_WITHIN_S / LOOK_EVERY_S)
READY = "ready"
Work = NewMap | NewKeyframe | Forget | Settle | TakeUp


class MapperLink(Protocol):
    """How the tracker speaks with the mapper."""

    def send(self, work: Work) -> None: ...

    def receive(self, wait_s: float = 0.0) -> list[MapUpdate]:
        """The updates that have come, in order. `wait_s`: for the first one, at most."""
        ...

    def waiting(self) -> int:
        """Pieces of work that are not finished."""
        ...

    def alive(self) -> bool:
        """Whether unfinished work will be."""
        ...

    def close(self) -> None: ...


class MapperHere:
    """The mapper in this process: done when `send` returns. With the same work, the same map."""

    def __init__(self, camera: SlamCamera, settings: SlamSettings) -> None:
        self.mapper = Mapper(camera, settings)
        self._updates: list[MapUpdate] = []

    def send(self, work: Work) -> None:
        self._updates.append(do(self.mapper, work))

    def receive(self, wait_s: float = 0.0) -> list[MapUpdate]:
        updates, self._updates = self._updates, []
        return updates

    def waiting(self) -> int:
        return 0

    def alive(self) -> bool:
        return True

    def close(self) -> None:
        pass


def do(mapper: Mapper, work: Work, busy: Any = lambda: False) -> MapUpdate:
    """One piece of work."""
    if isinstance(work, NewMap):
        return mapper.begin(work)
    if isinstance(work, TakeUp):
        return mapper.take_up(work.saved)
    if isinstance(work, Settle):
        return mapper.settle(work.component)
    return mapper.forget(work.component) if isinstance(work, Forget) else mapper.insert(work, busy)


class MapperProcess:
    """The mapper in a process of its own."""

    def __init__(self, camera: SlamCamera, settings: SlamSettings, *, at_once: bool = True) -> None:
        """Starts the process and waits until it is ready; if not `at_once`, it gets ready while pictures are taken."""
        context = multiprocessing.get_context("spawn")
        self._work: Any = context.Queue()
        self._updates: Any = context.Queue()
        self._sent = self._received = 0
        self._process = context.Process(
            target=_run,
            args=(camera, settings, self._work, self._updates, os.getpid()),
            daemon=True,
            name="slam-mapper",
        )
        self._closed = False
        self._process.start()
        if at_once:
            self._wait_until_ready()

    def _wait_until_ready(self) -> None:
        for _ in range(READY_LOOKS):
            with contextlib.suppress(queue.Empty):
                self._updates.get(timeout=LOOK_EVERY_S)
                return
            if not self._process.is_alive():
                self.close()
                raise StationError(
                    "SLAM's mapper ended as it started. A program that uses SlamSystem must start under "
                    "`if __name__ == '__main__':`, because the mapper's process imports it again."
                )
        self.close()
        raise StationError(f"SLAM's mapper did not start within {READY_WITHIN_S} s: is the machine overloaded?")

    def send(self, work: Work) -> None:
        self._sent += 1
        self._work.put(work)

    def receive(self, wait_s: float = 0.0) -> list[MapUpdate]:
        updates = []
        while self._received < self._sent:
            try:
                update = self._updates.get(timeout=wait_s) if wait_s else self._updates.get_nowait()
            except queue.Empty:
                break
            if update == READY:
                continue
            updates.append(update)
            self._received += 1
            wait_s = 0.0
        return updates

    def waiting(self) -> int:
        return self._sent - self._received

    def alive(self) -> bool:
        return not self._closed and self._process.is_alive()

    def close(self) -> None:
        if self._closed:
            return
        if self.alive():
            self._process.terminate()  # what it is at concerns a map that nobody wants any more
            self._process.join()
        self._closed = True
        for channel in (self._work, self._updates):
            channel.close()
            channel.cancel_join_thread()


def _run(camera: SlamCamera, settings: SlamSettings, work: Any, updates: Any, parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the tracker's, which then ends this process in order
    threadpool_limits(1)  # for systems of some hundred unknowns a pool of threads only spins, on the tracker's core
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    rehearse_mapping()
    mapper = Mapper(camera, settings)
    updates.put(READY)
    while True:
        updates.put(do(mapper, work.get(), lambda: not work.empty()))


def _end_with(parent: int) -> None:
    """A mapper without a tracker has no use: its work would only wait."""
    ended = threading.Event()
    while os.getppid() == parent:
        ended.wait(LOOK_EVERY_S)
    os._exit(0)
