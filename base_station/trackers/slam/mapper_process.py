"""Where the mapper runs: in the caller's process, at once; or in one of its own, while the tracker goes on.

Both are used alike: `send` work, `receive` updates of the map. In a process of its own the mapper works on while the
tracker goes on with a copy of the map that is some keyframes behind. The process ends with `close`, and by itself
when the tracker's process is gone. When it ends otherwise, `receive` says so: a map that stands still while the tracker
goes on in it would be told as if it were whole. They speak through pipes, of which an ended process leaves its end
open to nobody; a queue would wait for the rest of what was half sent.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Protocol

from threadpoolctl import threadpool_limits

from base_station.errors import StationError
from base_station.trackers.own import told
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.map import MapUpdate
from base_station.trackers.slam.mapper import Forget, Mapper, NewKeyframe, NewMap, Settle, TakeUp
from base_station.trackers.slam.rehearsal import rehearse_mapping
from base_station.trackers.slam.settings import SlamSettings

LOOK_EVERY_S = 0.5
READY_WITHIN_S = 90
READY = "ready"
Work = NewMap | NewKeyframe | Forget | Settle | TakeUp


@dataclass(frozen=True)
class Failure:
    """What ended the mapper, in words."""

    text: str


class MapperLink(Protocol):
    """How the tracker speaks with the mapper."""

    def send(self, work: Work) -> None: ...

    def receive(self, wait_s: float = 0.0) -> list[MapUpdate]:
        """The updates that have come, in order. `wait_s`: for the first one, at most. Raises StationError when the
        mapper has ended of itself: no more will come."""
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
        work, self._work = context.Pipe(duplex=False)
        self._updates, updates = context.Pipe(duplex=False)
        self._outbox: queue.SimpleQueue[Work | None] = queue.SimpleQueue()
        self._sent = self._received = 0
        self._ready = self._closed = False
        self._failure = ""
        self._process = context.Process(
            target=_run, args=(camera, settings, work, updates, os.getpid()), daemon=True, name="slam-mapper"
        )
        self._process.start()
        work.close()
        updates.close()  # the mapper's is the only one now: it closes when the mapper ends
        threading.Thread(target=_post, args=(self._outbox, self._work), daemon=True).start()
        if at_once:
            self._wait_until_ready()

    def _wait_until_ready(self) -> None:
        try:
            if not self._updates.poll(READY_WITHIN_S):
                raise StationError(f"SLAM's mapper did not start within {READY_WITHIN_S} s: is the machine overloaded?")
            self._said()
        except StationError:
            self.close()
            raise

    def send(self, work: Work) -> None:
        self._sent += 1
        self._outbox.put(work)

    def receive(self, wait_s: float = 0.0) -> list[MapUpdate]:
        updates: list[MapUpdate] = []
        while not self._closed and self._updates.poll(wait_s if self.waiting() else 0.0):
            update = self._said()
            if update is not None:
                updates.append(update)
                self._received += 1
                wait_s = 0.0
        return updates

    def _said(self) -> MapUpdate | None:
        """What has come from the mapper; None: it is ready."""
        try:
            said = self._updates.recv()
        except (EOFError, OSError):
            self._process.join(LOOK_EVERY_S)
            raise StationError(self._failure or self._end()) from None
        if isinstance(said, Failure):
            self._failure = said.text
            raise StationError(said.text)
        if said == READY:
            self._ready = True
            return None
        assert isinstance(said, MapUpdate)
        return said

    def _end(self) -> str:
        if not self._ready:
            return (
                "SLAM's mapper ended as it started. A program that uses SlamSystem must start under "
                "`if __name__ == '__main__':`, because the mapper's process imports it again."
            )
        code = self._process.exitcode or 0
        how = f"by signal {-code}" if code < 0 else f"with exit code {code}"
        return (
            f"SLAM's mapper has ended ({how}), so the map would stay as it is: start again. Out of memory? "
            "The kernel's log (`dmesg`) tells."
        )

    def waiting(self) -> int:
        return self._sent - self._received

    def alive(self) -> bool:
        return not self._closed and self._process.is_alive()

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._process.kill()  # what it is at concerns a map that nobody wants any more
        self._process.join()
        self._outbox.put(None)
        self._updates.close()


def _post(outbox: queue.SimpleQueue[Work | None], pipe: Connection) -> None:
    """A mapper at work does not read: the tracker would wait."""
    with pipe, contextlib.suppress(OSError):  # an ended mapper reads nothing; who receives is told
        while (work := outbox.get()) is not None:
            pipe.send(work)


def _run(camera: SlamCamera, settings: SlamSettings, work: Connection, updates: Connection, parent: int) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # they are the tracker's, which then ends this process in order
    threadpool_limits(1)  # for systems of some hundred unknowns a pool of threads only spins, on the tracker's core
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    rehearse_mapping()
    mapper = Mapper(camera, settings)
    updates.send(READY)
    with contextlib.suppress(EOFError, BrokenPipeError):  # the tracker is gone
        while True:
            asked = work.recv()
            try:
                answer: MapUpdate | Failure = do(mapper, asked, work.poll)
            except Exception as error:  # whatever it was, who waits for the map must be told
                answer = Failure(f"SLAM's mapper failed: {told(error)}.")
            updates.send(answer)
            if isinstance(answer, Failure):
                return


def _end_with(parent: int) -> None:
    """A mapper without a tracker has no use: its work would only wait."""
    ended = threading.Event()
    while os.getppid() == parent:
        ended.wait(LOOK_EVERY_S)
    os._exit(0)
