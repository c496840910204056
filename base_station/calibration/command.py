"""base-station calibrate: find out what camera it is, from a board that is held in front of it."""

from __future__ import annotations

import dataclasses
import queue
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from threadpoolctl import threadpool_limits
from tyro.conf import arg

from base_station.calibration.board import BoardOptions, CalibrationBoard
from base_station.calibration.collector import Collector, CollectorSettings, Verdict
from base_station.calibration.detection import BoardFinder
from base_station.calibration.display import CollectingDisplay, calibration_table
from base_station.calibration.pictures import is_video, read_pictures
from base_station.calibration.printing import write_board
from base_station.calibration.solving import Calibration, calibrate
from base_station.errors import StationError
from base_station.link import Link
from base_station.output_files import check_output
from base_station.session import LinkSettings
from base_station.terminal import pressed_keys
from protocol import FRAME_PORT, STOP
from protocol.camera_file import write_camera_file

PATIENCE_S = 10.0
FPS = 30.0
"""Written for cameras whose rate nobody knows."""
DONE_KEYS, QUIT_KEYS = ("\r", "\n", "c"), ("q", "\x03")
FOLDER = CollectorSettings(still_px=None, new=0.02, most_views=200)
"""Somebody chose these pictures: only copies of one another are passed over."""


@dataclass(frozen=True, kw_only=True)
class Live:
    """Calibrate: hold the board before the robot's camera, or give --images."""

    pattern: BoardOptions = dataclasses.field(default_factory=BoardOptions)
    images: Path | None = None
    """A folder of pictures or a video of the board. Default: what the robot sees now."""
    output: Annotated[Path, arg(aliases=["-o"])] = Path("camera.yaml")
    """Where to write the camera, for robot-agent --camera-file, base-station run --camera, ORB-SLAM3 and OpenCV."""
    k3: bool = False
    """Estimate the third radial coefficient too: for wide lenses, with many views up to the picture's rim."""
    host: str = "127.0.0.1"
    """The robot's name or address."""
    port: int = FRAME_PORT
    """The first of the robot's four ports."""


@dataclass(frozen=True, kw_only=True)
class Board:
    """Write a board to print, true to scale."""

    file: tyro.conf.Positional[Path]
    """A .pdf or .png file."""
    pattern: BoardOptions = dataclasses.field(default_factory=BoardOptions)
    paper: Literal["A4", "A3", "A2", "A1", "A0", "letter"] = "A4"
    """What it is printed on."""
    overwrite: bool = False
    """Replace a file that is there already."""


@dataclass(frozen=True, kw_only=True)
class Calibrate:
    """Calibrate a camera from a board held before it, or print the board: `calibrate board board.pdf`."""

    action: Annotated[Live | Board, arg(name="")] = dataclasses.field(default_factory=Live)


def spelt_out(arguments: list[str]) -> list[str]:
    """`calibrate --port 1` means `calibrate live --port 1`."""
    if arguments[:1] == ["calibrate"] and arguments[1:2] and arguments[1].startswith("-"):
        return arguments if arguments[1] in ("-h", "--help") else ["calibrate", "live", *arguments[1:]]
    return arguments


def calibrate_camera(command: Calibrate, console: Console) -> None:
    """Do it. Raises StationError."""
    action = command.action
    board = CalibrationBoard.of(action.pattern)
    if isinstance(action, Board):
        written = write_board(board, action.paper, action.file, overwrite=action.overwrite)
        print(f"{action.file}: {written}. Print it at 100 % and measure it.")
        return
    check_output("--output", action.output)
    if not 1 <= action.port <= 65532:
        raise StationError(f"--port must be 1..65532 (four ports in a row), not {action.port}.", usage=True)
    with threadpool_limits(1):
        if action.images is not None:
            collector, fps = _from_pictures(action.images, board, console), FPS
        else:
            collector, fps = _from_robot(action, board, console)
        _conclude(action, board, collector, fps, console)


def _from_pictures(source: Path, board: CalibrationBoard, console: Console) -> Collector:
    collector = Collector(CollectorSettings() if is_video(source) else FOLDER)
    finder = BoardFinder(board)
    with CollectingDisplay(console, collector, "") as display:
        for name, picture in read_pictures(source):
            view = finder.find(picture)
            verdict = collector.consider(view)
            display.show(dataclasses.replace(verdict, text=f"{name}: {verdict.text}"), view)
            if len(collector.views) >= collector.settings.most_views:
                break
    return collector


def _from_robot(action: Live, board: CalibrationBoard, console: Console) -> tuple[Collector, float]:
    """The views, and how many pictures a second the camera takes."""
    collector, finder = Collector(), BoardFinder(board)
    with ExitStack() as stack:
        link = stack.enter_context(Link(LinkSettings(host=action.host, port=action.port)))
        keys = stack.enter_context(pressed_keys())
        hint = "enter: that is enough  q: give up" if keys is not None else ""
        display = stack.enter_context(CollectingDisplay(console, collector, hint))
        begun_s = time.monotonic()
        while not collector.enough and not _pressed(keys) and not link.ended:
            received = link.next_frame(0.2)
            if received is None:
                if not link.connections and time.monotonic() - begun_s > PATIENCE_S:
                    raise StationError(
                        f"No frame came from {action.host}:{action.port} ({link.state}). Is the agent running there?"
                        " To calibrate from pictures give --images."
                    )
                display.show(Verdict(False, link.state))
                continue
            frame, _ = received
            link.send(STOP, frame.connection)  # an agent in lockstep sends no frame before this one is answered
            if link.hello is not None and link.hello.format.height != link.hello.format.full_height:
                raise StationError("The robot sends a band of rows only: start the agent without --rows.")
            view = finder.find(frame.image)
            display.show(collector.consider(view), view)
        return collector, link.hello.fps if link.hello is not None else FPS


def _pressed(keys: queue.SimpleQueue[str] | None) -> bool:
    """Whether somebody said that it is enough. Raises KeyboardInterrupt when somebody gave up."""
    while keys is not None and not keys.empty():
        key = keys.get()
        if key in QUIT_KEYS:
            raise KeyboardInterrupt
        if key in DONE_KEYS:
            return True
    return False


def _conclude(action: Live, board: CalibrationBoard, collector: Collector, fps: float, console: Console) -> None:
    found = calibrate(collector.views, k3=action.k3)
    console.print(calibration_table(found, len(collector.views)))
    for warning in [*found.warnings(), *(f"the views lack something: {lack}" for lack in collector.lacks())]:
        console.print(f"careful: {warning}", style="yellow", markup=False, highlight=False, soft_wrap=True)
    _write(action.output, found, board, fps)
    print(f"{action.output}: for robot-agent --camera-file, base-station run --camera, ORB-SLAM3 and OpenCV")


def _write(path: Path, found: Calibration, board: CalibrationBoard, fps: float) -> None:
    notes = (
        f"base-station calibrate: {len(found.kept)} views of a {board.described()},",
        f"reprojection error {found.rms_px:.3f} px (RMS)",
    )
    try:
        path.write_text(write_camera_file(found.file, fps=fps, notes=notes), encoding="utf-8")
    except OSError as error:
        raise StationError(f"{path} cannot be written ({error.strerror}).") from error
