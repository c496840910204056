"""A mistyped command line is told in one sentence, about the command that was meant and about nothing else."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from base_station import cli
from base_station.cli import EXIT_DONE, EXIT_USAGE, main
from base_station.errors import EXIT_INTERRUPTED


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("run --behavior follow", "no option --behavior; did you mean --behaviour? base-station run --help"),
        ("run --max_framse=3", "no option --max_framse; did you mean --max-frames?"),
        ("replay x.mcap --trakcer phase", "no option --trakcer; did you mean --tracker? base-station replay --help"),
        ("compare x --trakers a,b", "did you mean --trackers? base-station compare --help"),
        ("calibrate board b.pdf --papr A4", "did you mean --paper? base-station calibrate board --help"),
        ("calibrate --squre-mm 20", "did you mean --square-mm? base-station calibrate live --help"),
        ("calibrate board b.pdf --images x", "no option --images. base-station calibrate board --help"),
        ("calibrate bord b.pdf", "no command 'bord'; did you mean board?"),
        ("evaluate tracking x --trackr y", "did you mean --tracker? base-station evaluate tracking --help"),
        ("landmarks lern door", "no command 'lern'; did you mean learn? base-station landmarks --help"),
        ("rnu", "no command 'rnu'; did you mean run? base-station --help"),
        ("zzz", "there are run, replay, compare"),
        ("--record x run", "Name a command before --record"),
        ("run extra", "'extra' is too much here. base-station run --help"),
        ("run -Z", "no option -Z. base-station run --help"),
        ("replay --source x.mcap", "no option --source. base-station replay --help"),
    ],
)
def test_a_typo_is_one_line(arguments: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments.split()) == EXIT_USAGE
    out, error = capsys.readouterr()
    assert out == ""
    assert said in error
    assert len(error.splitlines()) == 1, error


@pytest.mark.parametrize(
    ("arguments", "does", "code"),
    [
        ("evaluate tracking x", "evaluate", EXIT_INTERRUPTED),
        ("evaluate slam x", "evaluate", EXIT_INTERRUPTED),
        ("compare x --trackers phase", "compare", EXIT_INTERRUPTED),
        ("export x.mcap y", "export", EXIT_INTERRUPTED),
        ("landmarks list", "landmarks", EXIT_INTERRUPTED),
        ("calibrate live", "calibrate_camera", EXIT_INTERRUPTED),
        ("replay x.mcap", "replay_run", EXIT_INTERRUPTED),
        ("replay x.mcap --console", "replay_run", EXIT_DONE),
        ("run", "run", EXIT_DONE),
    ],
)
def test_an_interrupted_command_has_not_done_it(
    arguments: str, does: str, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C. To drive and to watch have no other end."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, does, interrupted)
    monkeypatch.setattr(cli, "watching_console", lambda *_: None)
    assert main(arguments.split()) == code
    assert capsys.readouterr().err == ("base-station: interrupted\n" if code else "")


def test_underscores_and_switched_off_flags_are_known(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--max_frames", "3", "--no-rows", "--print-config"]) == EXIT_DONE
    assert "max-frames = 3" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([""], "'' is no name for a landmark"),
        (["two\nlines"], "is no name for a landmark"),
        (
            ["door", "--target", "9000,60,100,80"],
            "--target 9000,60,100,80 lies outside of the picture, which has 64x48",
        ),
        (["door", "--memory", "nowhere/a.npz"], "--memory nowhere/a.npz: there is no folder nowhere"),
        (["door", "--memory", "."], "--memory: . is a folder"),
    ],
    ids=lambda value: " ".join(value[-2:]) if isinstance(value, list) else "",
)
def test_what_cannot_be_learned_as_it_is_asked_is_wrong_usage(
    options: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    cv2.imwrite("picture.png", np.random.default_rng(0).integers(0, 255, (48, 64), np.uint8))
    assert main(["landmarks", "learn", *options, "--image", "picture.png"]) == EXIT_USAGE
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["calibrate", "board", "--help"]])
def test_help_is_no_mistake(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == EXIT_DONE
    assert "usage: base-station" in capsys.readouterr().out


def test_a_value_that_is_none_sends_to_the_commands_own_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--port", "abc"]) == EXIT_USAGE
    assert "base-station run --help" in capsys.readouterr().err
