"""The mapper's process: what goes wrong in it is told, and it ends without a word when it is closed."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys

import pytest

from base_station.errors import StationError
from base_station.trackers.slam.mapper import Settle
from base_station.trackers.slam.mapper_process import MapperProcess
from base_station.trackers.slam.rehearsal import CAMERA
from base_station.trackers.slam.settings import SlamSettings


def test_what_fails_in_the_mapper_is_told_with_its_message():
    link = MapperProcess(CAMERA, SlamSettings())
    try:
        assert link.receive() == []
        link.send("no work")  # type: ignore[arg-type]
        with pytest.raises(StationError, match=r"mapper failed: AttributeError: .*no attribute 'reference'.*mapper.py"):
            link.receive(30.0)
        with pytest.raises(StationError, match=r"mapper failed"):
            link.receive(30.0)
        assert not link.alive()
    finally:
        link.close()
    assert link.receive() == []


def test_a_mapper_that_dies_with_nothing_to_do_is_noticed_at_the_next_look():
    link = MapperProcess(CAMERA, SlamSettings())
    mapper = multiprocessing.active_children()[-1]
    try:
        link.send(Settle(-1))
        assert [update.event for update in link.receive(30.0)] == ["left as it is"]
        os.kill(mapper.pid, signal.SIGKILL)
        mapper.join(5)
        with pytest.raises(StationError, match=r"mapper has ended .by signal 9"):
            link.receive()
    finally:
        link.close()


def test_what_ends_the_tracker_leaves_the_mapper_to_it():
    """Ctrl-C, `systemctl stop` and a closed terminal signal all of a command's processes; the map is still wanted."""
    link = MapperProcess(CAMERA, SlamSettings())
    mapper = multiprocessing.active_children()[-1]
    try:
        assert link.receive() == []
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(mapper.pid, number)
        link.send(Settle(-1))
        assert [update.event for update in link.receive(30.0)] == ["left as it is"]
    finally:
        link.close()
    assert not mapper.is_alive()


def test_sigterm_is_left_to_who_had_it_when_pycolmap_comes():
    program = (
        "import signal, os, sys, threading\n"
        "from base_station.trackers.slam import libraries\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(7))\n"
        "thread = threading.Thread(target=libraries.pycolmap); thread.start(); thread.join()\n"
        "os.kill(os.getpid(), signal.SIGTERM)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=60)
    assert (ended.returncode, ended.stderr) == (7, "")
