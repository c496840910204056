"""The base-station command."""

from __future__ import annotations

import dataclasses
import functools
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Union

import tyro
from rich.console import Console

from base_station.calibration.command import Calibrate, calibrate_camera, spelt_out
from base_station.command_line import CONFIG, no_command, read_settings_of
from base_station.configuration import config_file, read_settings
from base_station.console.launcher import ConsoleSettings
from base_station.console_option import watching_console
from base_station.discovery import find_robots
from base_station.errors import EXIT_INTERRUPTED, StationError
from base_station.evaluation.evaluate_command import Evaluate, evaluate
from base_station.evaluation.overlap import has_box, read_results, read_truth, score_boxes
from base_station.landmarks_command import Landmarks, landmarks
from base_station.recording.compare_command import Compare, compare
from base_station.recording.export_command import Export, export
from base_station.recording.replay_command import Replay, replay_run
from base_station.run_command import Run, run
from base_station.trackers.registry import tracker_names

EXIT_DONE, EXIT_FAILED, EXIT_USAGE = 0, 1, 2


@dataclasses.dataclass(frozen=True, kw_only=True)
class Score:
    """Compare the boxes of a --results file with true ones (OTB's groundtruth_rect.txt): overlap, AUC, precision."""

    results: tyro.conf.Positional[Path]
    """A file written by `base-station run --results`."""
    truth: tyro.conf.Positional[Path]
    """Lines of x,y,width,height."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Trackers:
    """List the trackers."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Robots:
    """List the robots that announce themselves on this network."""

    seconds: float = 2.0
    """How long to listen."""


COMMANDS = {
    kind.__name__.lower(): kind
    for kind in (Run, Replay, Compare, Export, Landmarks, Calibrate, Score, Evaluate, Trackers, Robots)
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Returns the exit code: 0 done, 1 failed, 2 wrong usage, 130 interrupted."""
    try:
        code = _obey(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # whoever read the output has enough of it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_DONE


def _obey(arguments: Sequence[str] | None) -> int:
    console = Console(stderr=True)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # of a file that is no video we speak ourselves
    arguments = spelt_out(list(sys.argv[1:] if arguments is None else arguments))
    try:
        command = _read(arguments)
    except SystemExit as end:  # tyro's own way out: after --help, or after having said what was wrong
        return EXIT_USAGE if end.code else EXIT_DONE
    except StationError as error:
        return _failed(error, console)
    try:
        match command:
            case Run():
                run(command, console)
            case Replay():
                _replay(command, console)
            case Compare():
                compare(command, console)
            case Export():
                export(command, console)
            case Score():
                _score(command)
            case Landmarks():
                landmarks(command)
            case Calibrate():
                calibrate_camera(command, console)
            case Robots():
                _robots(command)
            case Evaluate():
                evaluate(command)
            case Trackers():
                print("\n".join(tracker_names()), flush=True)
        return EXIT_DONE
    except KeyboardInterrupt:
        if isinstance(command, Run) or (isinstance(command, Replay) and command.console):
            return EXIT_DONE  # to drive and to watch have no other end
        return _interrupted(console)
    except StationError as error:
        return _failed(error, console)


def _read(arguments: Sequence[str]) -> Any:
    """Raises StationError; SystemExit where tyro has said what there was to say."""
    if not arguments or arguments[0] in ("-h", "--help"):
        any_command: Any = Union[tuple(COMMANDS.values())]  # noqa: UP007 (of a tuple)
        return tyro.cli(
            any_command,
            prog="base-station",
            description="The station on the PC: sees with a tracker, drives with a behaviour.",
            args=arguments,
            config=CONFIG,
        )
    name, *rest = arguments
    if name not in COMMANDS:
        raise no_command(name, list(COMMANDS), "base-station")
    config = config_file(rest) if name == "run" else None
    default = {} if config is None else {"default": read_settings(config, Run, "run")}
    return read_settings_of(COMMANDS[name], rest, f"base-station {name}", **default)


def _interrupted(console: Console) -> int:
    console.print("base-station: interrupted", style="red", highlight=False)
    return EXIT_INTERRUPTED


def _failed(error: StationError, console: Console) -> int:
    console.print(f"base-station: {error}", style="red", highlight=False, markup=False, soft_wrap=True)
    return EXIT_USAGE if error.usage else EXIT_FAILED


def _replay(command: Replay, console: Console) -> None:
    if not command.console:
        replay_run(command, console)
        return
    settings = ConsoleSettings(host=command.console_host, port=command.console_port)
    say = functools.partial(console.print, soft_wrap=True, markup=False)
    replay_run(command, console, watching_console(settings, say))


def _score(command: Score) -> None:
    found, truth = read_results(command.results), read_truth(command.truth)
    frames = min(len(found), len(truth))
    if frames == 0:
        raise StationError("There are no frames to compare.")
    if len(found) != len(truth):
        print(f"comparing the first {frames} frames ({len(found)} results, {len(truth)} true boxes)", file=sys.stderr)
    known = int(has_box(truth[:frames]).sum())
    if known == 0:
        raise StationError(f"{command.truth} has no true box for any of {frames} frames.")
    if known < frames:
        print(f"{frames - known} of {frames} frames have no true box and are left out", file=sys.stderr)
    print(json.dumps(dataclasses.asdict(score_boxes(found[:frames], truth[:frames])), indent=2))


def _robots(command: Robots) -> None:
    if not 0.1 <= command.seconds <= 60:
        raise StationError(f"--seconds must be 0.1..60, not {command.seconds:g}.", usage=True)
    found = find_robots(command.seconds)
    if not found:
        raise StationError(
            "No robot announces itself here. Is the agent started with --listen 0.0.0.0, is python3-zeroconf on "
            "the robot, are both on the same network? Networks that keep multicast back are common: then use "
            "base-station run --host ADDRESS (on the robot, hostname -I tells the address)."
        )
    rows = [("name", "address", "port", "robot", "camera", "state")]
    rows += [(robot.name, robot.address, str(robot.port), robot.robot, robot.camera, robot.busy) for robot in found]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        print("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip())
    print(f"\nbase-station run --host {found[0].address} --port {found[0].port}", file=sys.stderr)
