"""Programs and ports for one test; whatever a test leaves running is killed here."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.helpers import ROOT, Operator, Programs, TelemetryLog, free_ports, write_pictures


@pytest.fixture(scope="session", autouse=True)
def compiled_kernels() -> None:
    """A fresh clone compiles the Z-transform's kernels on first use; no test's time limit is to pay for that."""
    make = "from base_station.trackers.registry import make_tracker; make_tracker('ztransform').close()"
    subprocess.run([sys.executable, "-c", make], cwd=ROOT, check=True, timeout=300)


@pytest.fixture
def port() -> int:
    """The first of four free ports."""
    return free_ports()


@pytest.fixture
def programs() -> Iterator[Programs]:
    started = Programs()
    yield started
    started.close()


@pytest.fixture
def listen(port: int) -> Iterator[Callable[[], TelemetryLog]]:
    """Listens to the telemetry of the agent that runs already; from the return on no message is missed."""
    logs: list[TelemetryLog] = []

    def begin() -> TelemetryLog:
        logs.append(TelemetryLog(port))
        return logs[-1].wait_until_live()

    yield begin
    for log in logs:
        log.close()


@pytest.fixture
def operator(port: int) -> Iterator[Operator]:
    client = Operator(port)
    yield client
    client.close()


@pytest.fixture
def folder() -> Iterator[Path]:
    """For temporary files, with a short path: a socket's may have 107 characters."""
    with tempfile.TemporaryDirectory(prefix="zs") as path:
        yield Path(path)


@pytest.fixture(scope="session")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 600 numbered pictures, 160x120: 20 s at 30 per second."""
    return write_pictures(tmp_path_factory.mktemp("pictures"), 600)
