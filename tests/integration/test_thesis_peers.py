"""The thesis's own two programs as peers: listing A.2's drives our agent, our station drives listing A.1's robot.

Both stand-ins are processes that know the raw ports only (tests/thesis_station.py, tests/thesis_agent.py). What crosses
the wire is compared with golden files; after a change of `follow` or the tracker that is meant, write them anew with

    python -m tests.integration.test_thesis_peers --write
"""

from __future__ import annotations

import itertools
import json
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.helpers import ROOT, Program, Programs, TelemetryLog, free_ports, numbered_picture, picture_number

pytestmark = pytest.mark.timed

GOLDEN = Path(__file__).parent / "golden"
CYCLE_BYTES = (ROOT / "tests/protocol/golden/commands_listing_a2.bin").read_bytes()
WIDTH, HEIGHT = 160, 120
FRAME_BYTES = WIDTH * HEIGHT
STOP = b"\0\0"
"""The station's last word; the thesis's peers need not understand it."""


# -- listing A.2 drives our agent --------------------------------------------------------------------------------------


def thesis_station(programs: Programs, port: int, frames: Path, cycles: int = 1) -> Program:
    script = str(ROOT / "tests/thesis_station.py")
    return programs.start(sys.executable, script, *map(str, (port, WIDTH, HEIGHT, cycles, frames)))


@pytest.mark.parametrize("rhythm", ["free", "lockstep"])
def test_the_thesiss_station(
    programs: Programs, port: int, pictures: Path, listen: Callable[[], TelemetryLog], tmp_path: Path, rhythm: str
) -> None:
    """One frame, then two bytes: it works unchanged through two cycles, in either rhythm. Every frame it gets is a
    picture to the last byte; in lockstep every picture in turn, and each command is in force at the next frame."""
    programs.replay(port, pictures, "--rhythm", rhythm)
    telemetry = listen()
    station = thesis_station(programs, port, tmp_path / "frames.bin", cycles=2)
    assert station.exit_code() == 0, station.stderr

    data = (tmp_path / "frames.bin").read_bytes()
    frames = [data[start : start + FRAME_BYTES] for start in range(0, len(data), FRAME_BYTES)]
    numbers = [picture_number(frame) for frame in frames]
    assert len(frames) == 81
    for number, frame in zip(numbers, frames, strict=True):
        assert frame == numbered_picture(number).tobytes(), f"picture {number} is not whole"
    stamped = [message for message in telemetry.messages if message.station is not None and message.frame is not None]
    if rhythm == "lockstep":
        assert numbers == list(range(1, 82))
        in_force = {m.frame.number: m.wheels_asked for m in reversed(stamped) if m.frame is not None}  # as it left
        sent = np.frombuffer(CYCLE_BYTES * 2, np.int8).reshape(-1, 2).tolist()
        assert [list(in_force[number]) for number in range(2, 82)] == sent
    else:
        assert numbers == sorted(set(numbers))
    changes = runs(message.wheels_asked for message in stamped)
    assert [wheels for wheels in changes if wheels != (0, 0)] == [(100, 100), (-68, 100), (100, -68), (-100, -100)] * 2


def runs(values: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """The values without repetitions in a row."""
    return [value for value, _ in itertools.groupby(values)]


# -- our station drives listing A.1 ------------------------------------------------------------------------------------


def thesis_agent(programs: Programs, port: int, frames: Path, period_s: float = 0.0, *proximity: str) -> Program:
    script = str(ROOT / "tests/thesis_agent.py")
    agent = programs.start(sys.executable, script, *map(str, (port, WIDTH, HEIGHT, frames, period_s)), *proximity)
    agent.says("waiting for a station")
    return agent


def drive(programs: Programs, port: int, frames: int, *options: str, tracker: str = "phase") -> Program:
    size = ("--width", str(WIDTH), "--height", str(HEIGHT))
    return programs.station(port, *size, "--max-frames", str(frames), *options, tracker=tracker)


def exchanges(agent: Program) -> list[dict]:
    """What the robot was told, when its station has gone."""
    assert agent.exit_code() == 0, agent.stderr
    return [json.loads(line) for line in agent.stdout.splitlines()]


def stream(told: list[dict]) -> bytes:
    return b"".join(bytes(exchange["bytes"]) for exchange in told)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures in which the target moves aside and back, comes nearer and goes away, as raw bytes."""
    path = tmp_path_factory.mktemp("scene") / "frames.bin"
    write_scene(path)
    return path


def test_pattern_to_the_thesiss_robot(programs: Programs, scene: Path) -> None:
    """One command per frame. It reads bytes unsigned, so what is backwards is sent as 0 and said; with --signed-peer
    the bytes are listing A.2's, and the robot drives forwards at 156, as the thesis's did."""
    ports = free_ports(), free_ports()
    robots = [thesis_agent(programs, port, scene) for port in ports]
    stations = [
        drive(programs, port, 80, "--behaviour", "pattern", *options)
        for port, options in zip(ports, ((), ("--signed-peer",)), strict=True)
    ]
    for station in stations:
        assert station.exit_code() == 0, station.stderr
    unsigned, signed = (exchanges(robot) for robot in robots)
    assert stream(unsigned) == (GOLDEN / "pattern_to_unsigned_peer.bin").read_bytes() * 2 + STOP
    assert stream(signed) == CYCLE_BYTES * 2 + STOP
    assert signed[39]["targets"] == [[156, 156]]
    assert "cut to 0..127" in stations[0].stderr and "--signed-peer" in stations[0].stderr
    assert "commands signed" in stations[1].stderr


def test_the_thesiss_obstacle_rule(programs: Programs, port: int, scene: Path) -> None:
    """What the robot does by itself when it sees an obstacle changes nothing in what it is told."""
    clear, left, middle, behind_the_rule = (
        [0] * 5,
        [0, 0, 1001, 0, 0],
        [0, 0, 0, 2001, 0],
        [4000, 4000, 1000, 2000, 1000],
    )
    robot = thesis_agent(programs, port, scene, 0.0, json.dumps([clear, left, middle, behind_the_rule, clear]))
    assert drive(programs, port, 6, "--behaviour", "pattern").exit_code() == 0
    told = exchanges(robot)
    assert stream(told) == CYCLE_BYTES[:12] + STOP
    stopped = [exchange["targets"][-1] == [0, 0] for exchange in told[:6]]
    assert stopped == [False, False, True, True, False, False]


def test_follow_to_the_thesiss_robot(programs: Programs, scene: Path) -> None:
    """The station follows a target over the thesis's wire; the robot blocks for each command.

    Two units (0.65 mm/s) are allowed for processors and OpenCV versions that round differently.
    """
    signed, unsigned = follow_streams(programs, scene)
    golden = (GOLDEN / "follow_to_signed_peer.bin").read_bytes()
    assert len(signed) == len(unsigned) == len(golden) == 2 * FRAMES + len(STOP)
    for told, lowest in ((signed, -128), (unsigned, 0)):
        wanted = np.frombuffer(golden, np.int8).astype(int).clip(lowest)
        got = np.frombuffer(told, np.int8).astype(int)
        assert np.abs(got - wanted).max() <= 2, (
            f"{got.reshape(-1, 2).tolist()}\ninstead of {wanted.reshape(-1, 2).tolist()}"
        )
    assert np.frombuffer(golden, np.int8).min() < -20, "nothing to cut"


FRAMES = 24
PERIOD_S = 0.22
"""A slow robot: above 0.2 s `follow` counts a pause as 0.2 s, so that its integrals do not depend on the clock."""
TARGET = (50, 30, 60, 60)


def write_scene(path: Path) -> None:
    """FRAMES pictures: a patch in front of a background, seeded, moved by up to 3 px and scaled by up to 1.5 %."""
    rng = np.random.default_rng(7)

    def texture(height: int, width: int) -> np.ndarray:
        noise = cv2.GaussianBlur(rng.uniform(0, 255, (height, width)).astype(np.float32), (0, 0), 2.5)
        return cv2.normalize(noise, None, 20, 235, cv2.NORM_MINMAX).astype(np.uint8)

    background, patch = texture(HEIGHT, WIDTH) // 2 + 60, texture(60, 60)
    pictures = []
    for phase in np.arange(FRAMES) * (2 * np.pi / FRAMES):
        zoom, shift_px = 1.0 + 0.015 * np.sin(2 * phase), 3.0 * np.sin(3 * phase)
        centre_x, centre_y = TARGET[0] + 29.5, TARGET[1] + 29.5
        image_from_patch = np.array([[zoom, 0, centre_x + shift_px - 29.5 * zoom], [0, zoom, centre_y - 29.5 * zoom]])
        cv2.warpAffine(
            patch,
            image_from_patch,
            (WIDTH, HEIGHT),
            dst=(picture := background.copy()),
            flags=cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_TRANSPARENT,
        )
        pictures.append(picture.tobytes())
    path.write_bytes(b"".join(pictures))


def follow_streams(programs: Programs, scene: Path) -> tuple[bytes, bytes]:
    """What two stations send on the same pictures, to a peer taken for signed and to one taken for unsigned."""
    robots, stations = [], []
    for options in (("--signed-peer",), ()):
        port = free_ports()
        robots.append(thesis_agent(programs, port, scene, PERIOD_S))
        target = ",".join(map(str, TARGET))
        stations.append(drive(programs, port, FRAMES, "--target", target, *options, tracker="ztransform"))
    for station in stations:
        assert station.exit_code(40) == 0, station.stderr
    signed, unsigned = (stream(exchanges(robot)) for robot in robots)
    return signed, unsigned


def write_golden_files() -> None:
    """The files anew: the pattern by its rule, the follower by what it does now."""
    cut = np.frombuffer(CYCLE_BYTES, np.int8).clip(0)
    (GOLDEN / "pattern_to_unsigned_peer.bin").write_bytes(cut.tobytes())
    programs = Programs()
    try:
        with tempfile.TemporaryDirectory() as folder:
            write_scene(Path(folder) / "frames.bin")
            signed, _ = follow_streams(programs, Path(folder) / "frames.bin")
    finally:
        programs.close()
    (GOLDEN / "follow_to_signed_peer.bin").write_bytes(signed)


if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit(__doc__)
    write_golden_files()
