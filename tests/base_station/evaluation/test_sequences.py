"""Sequences in OTB layout: what is read, how a lost target counts, what the commands print, write and refuse."""

from __future__ import annotations

import json
import time

import cv2
import numpy as np
import pytest

from base_station import cli
from base_station.errors import StationError
from base_station.evaluation import otb_command
from base_station.evaluation.otb_command import duel_table
from base_station.evaluation.peers import make_peer
from base_station.evaluation.sequences import (
    SequenceScore,
    TrackerFollower,
    find_sequences,
    mean_score,
    run_sequence,
)
from base_station.types import Box, TrackerResult, TrackingState

STEP_PX = 2
KEYS = {"sequence", "frames", "auc", "precision20", "mean_iou", "ms_p50", "ms_p95", "lost_frames"}


def write_sequence(folder, frames=8, *, separator=",", suffix="png", truths=None):
    """A picture that moves right by two pixels a frame in front of nothing, and its box."""
    (folder / "img").mkdir(parents=True)
    rng = np.random.default_rng(0)
    target = cv2.resize(rng.integers(0, 255, (8, 10), np.uint8), (60, 48), interpolation=cv2.INTER_CUBIC)
    lines = []
    for number in range(frames):
        x = 40 + STEP_PX * number
        image = np.full((120, 160, 3), (90, 110, 130), np.uint8)
        image[30:78, x : x + 60] = target[..., None]
        cv2.imwrite(str(folder / "img" / f"{number + 1:04d}.{suffix}"), image)
        lines.append(separator.join(str(v) for v in (x, 30, 60, 48)))
    (folder / "groundtruth_rect.txt").write_text("\n".join(lines[: truths or frames]) + "\n")
    return folder


class Scripted:
    """Answers as told; the only thing that is measured is the scoring."""

    flags = cv2.IMREAD_GRAYSCALE

    def __init__(self, answers):
        self.answers, self.started = list(answers), None

    def start(self, image, box):
        time.sleep(0.05)
        self.started = (image.shape, box)

    def next(self, image):
        return self.answers.pop(0)


@pytest.mark.parametrize(("separator", "suffix"), [(",", "png"), ("\t", "jpg"), (" ", "png")])
def test_a_perfect_answer_has_the_best_score(tmp_path, separator, suffix):
    (sequence,) = find_sequences(write_sequence(tmp_path / "toy", separator=separator, suffix=suffix))
    follower = Scripted([Box(40 + STEP_PX * number, 30, 60, 48) for number in range(1, 8)])
    score = run_sequence(sequence, follower)
    assert follower.started == ((120, 160), Box(40, 30, 60, 48))
    assert (score.sequence, score.frames, score.lost_frames, score.precision20) == ("toy", 8, 0, 1.0)
    assert score.auc == pytest.approx(20 / 21)
    assert score.ms_p50 < 40  # starting is not in it


def test_a_lost_picture_counts_with_the_box_given_last(tmp_path):
    (sequence,) = find_sequences(write_sequence(tmp_path / "toy"))
    held = run_sequence(sequence, Scripted([None] * 7))
    still = run_sequence(sequence, Scripted([Box(40, 30, 60, 48)] * 7))
    assert (held.lost_frames, still.lost_frames) == (7, 0)
    assert held.auc == still.auc
    expected = np.mean([(60 - STEP_PX * n) / (60 + STEP_PX * n) for n in range(8)])
    assert held.mean_iou == pytest.approx(expected)


def test_a_tracker_gets_gray_frames_at_thirty_a_second_and_learns_the_first_box(tmp_path):
    class Watching:
        def __init__(self):
            self.frames = []

        def learn(self, frame, target):
            self.frames.append(frame)
            self.target = target

        def update(self, frame):
            self.frames.append(frame)
            return TrackerResult(state=TrackingState.LOST, reason="it only watches")

        def close(self):
            pass

    tracker = Watching()
    (sequence,) = find_sequences(write_sequence(tmp_path / "toy"), 5)
    assert run_sequence(sequence, TrackerFollower(tracker)).lost_frames == 4
    assert [frame.number for frame in tracker.frames] == [1, 2, 3, 4, 5]
    assert np.diff([frame.time_s for frame in tracker.frames]) == pytest.approx(1 / 30)
    assert {(frame.image.shape, frame.image.dtype.name) for frame in tracker.frames} == {((120, 160), "uint8")}
    assert (tracker.target, tracker.frames[0].camera.width) == (Box(40, 30, 60, 48), 160)


def test_the_mean_counts_every_sequence_the_same():
    def score(frames, auc, ms):
        return SequenceScore(
            sequence="s", frames=frames, auc=auc, precision20=auc, mean_iou=auc, ms_p50=ms, ms_p95=ms, lost_frames=1
        )

    mean = mean_score([score(10, 0.2, 1.0), score(1000, 0.6, 3.0)])
    assert (mean.auc, mean.ms_p50, mean.frames, mean.lost_frames) == (pytest.approx(0.4), 2.0, 1010, 2)
    duel = duel_table("ours", {"ours": [score(10, 0.5, 0.4)], "csrt": [score(10, 0.62, 9.0)]})
    assert "above: missed (-0.120)" in duel.caption
    assert "below: missed (worst -0.120)" in duel.caption
    assert "at most 0.5 ms a picture: reached (0.40 ms)" in duel.caption


def test_evaluate_writes_one_sequence(tmp_path, capsys):
    write_sequence(tmp_path / "toy")
    path = tmp_path / "score.json"
    folder = str(tmp_path / "toy")
    assert cli.main(["evaluate", "tracking", folder, "--tracker", "ncc", "--json", str(path), "--max-frames", "6"]) == 0
    score = json.loads(path.read_text())
    assert set(score) == KEYS
    assert (score["sequence"], score["frames"]) == ("toy", 6)
    assert score["auc"] > 0.9
    assert score["ms_p50"] > 0
    assert "toy" in capsys.readouterr().out


def test_evaluate_writes_several_and_their_mean(tmp_path, capsys):
    for name in ("b", "a"):
        write_sequence(tmp_path / "all" / name, truths=5)
    path = tmp_path / "score.json"
    assert cli.main(["evaluate", "tracking", str(tmp_path / "all"), "-t", "phase", "--json", str(path)]) == 0
    score = json.loads(path.read_text())
    assert set(score) == KEYS | {"sequences"}
    assert [row["sequence"] for row in score["sequences"]] == ["a", "b"]
    assert score["frames"] == 10
    assert "a: 8 pictures and 5 true boxes; the first 5 are compared" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("damage", "code", "said"),
    [
        (lambda folder: [path.unlink() for path in (folder / "img").iterdir()], 2, "has no pictures"),
        (lambda folder: (folder / "groundtruth_rect.txt").unlink(), 2, "is no OTB sequence"),
        (lambda folder: (folder / "groundtruth_rect.txt").write_text("1,2,3\n"), 1, "four numbers a line"),
        (lambda folder: (folder / "groundtruth_rect.txt").write_text("1,2,0,0\n1,2,3,4\n"), 1, "no box to learn"),
        (lambda folder: (folder / "groundtruth_rect.txt").write_text("1,2,30,40\n"), 2, "at least 2 are needed"),
        (lambda folder: (folder / "groundtruth_rect.txt").write_text("900,2,30,40\n" * 9), 1, "first box cannot be"),
        (lambda folder: (folder / "img" / "0003.png").write_bytes(b"x"), 1, "0003.png cannot be read"),
        (lambda folder: (folder / "img" / "0003.png").unlink(), 1, "after 0002.png comes 0004.png"),
        (lambda folder: (folder / "groundtruth_rect.txt").write_text("1e300,2,3,4\n1,2,3,4\n"), 1, "no box to learn"),
        (lambda folder: (folder / "groundtruth_rect.txt").write_text("1,2,3,4\n"), 2, "has 1 picture with"),
    ],
)  # fmt: skip
def test_what_is_no_sequence_is_one_sentence(tmp_path, capsys, damage, code, said):
    folder = write_sequence(tmp_path / "toy")
    damage(folder)
    assert cli.main(["evaluate", "tracking", str(folder), "--tracker", "phase"]) == code
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error


def rename(folder, names):
    for path, name in zip(sorted(folder.iterdir()), names, strict=True):
        path.rename(folder / f"new-{name}")
    for path in folder.iterdir():
        path.rename(folder / path.name.removeprefix("new-"))


@pytest.mark.parametrize(
    ("names", "truths"),
    [
        ([f"{number:04d}.png" for number in range(300, 312)], 12),
        ([f"{number:04d}.png" for number in range(300, 312)], 9),  # some of OTB's truths are shorter
        ([f"{number:04d}.png" for number in range(300, 312)], 20),  # or longer
        ([f"{number}.png" for number in range(1, 13)], 9),
        ([f"{2 * number:04d}.png" for number in range(12)], 12),  # every second one, with a box each
        ([f"{name}.png" for name in "abcdefghijkl"], 9),
    ],
)
def test_pictures_are_taken_by_their_numbers_whatever_the_first_is(tmp_path, names, truths):
    folder = write_sequence(tmp_path / "toy", 12)
    rename(folder / "img", names)
    (folder / "groundtruth_rect.txt").write_text("40,30,60,48\n" * truths)
    assert [path.name for path in find_sequences(folder)[0].pictures] == names[:truths]


def test_pictures_without_a_true_box_are_shown_and_not_compared(tmp_path, capsys):
    folder = write_sequence(tmp_path / "toy", 6)
    lines = (folder / "groundtruth_rect.txt").read_text().splitlines()
    lines[2], lines[4] = "NaN,NaN,NaN,NaN", "1e300,30,60,48"
    (folder / "groundtruth_rect.txt").write_text("\n".join(lines))
    (sequence,) = find_sequences(folder)
    score = run_sequence(sequence, Scripted([Box(40 + STEP_PX * number, 30, 60, 48) for number in range(1, 6)]))
    assert (score.frames, score.precision20, score.auc) == (4, 1.0, pytest.approx(20 / 21))
    assert cli.main(["evaluate", "tracking", str(folder), "--tracker", "ncc"]) == 0
    assert "toy: 2 of 6 pictures have no true box and are left out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--tracker", "ztransfrom"], "did you mean ztransform?"),
        (["--max-frames", "1"], "--max-frames must be at least 2"),
        (["--json", "nowhere/score.json"], "--json nowhere/score.json: there is no folder"),
    ],
)
def test_wrong_options_are_wrong_usage(tmp_path, capsys, options, said):
    folder = str(write_sequence(tmp_path / "toy"))
    assert cli.main(["evaluate", "tracking", folder, *options]) == 2
    assert said in capsys.readouterr().err
    if options[0] != "--tracker":
        assert otb_command.main([folder, *options]) == 2


@pytest.mark.parametrize(
    ("learn", "update", "said"),
    [
        ("raise RuntimeError('oops')", "pass", "the tracker failed at 0001.png: RuntimeError: oops (mine.py, line 2)"),
        ("pass", "1 / 0", "the tracker failed at 0002.png: ZeroDivisionError: division by zero (mine.py, line 3)"),
        ("pass", "raise SystemExit(3)", "the tracker failed at 0002.png: SystemExit: 3 (mine.py, line 3)"),
        ("pass", "pass", "Mine.update returned NoneType, not a TrackerResult"),
    ],
)
def test_a_tracker_of_ones_own_that_fails_is_one_sentence_and_is_closed(
    tmp_path, capsys, caplog, learn, update, said
):  # fmt: skip
    own = tmp_path / "mine.py"
    own.write_text(
        f"class Mine:\n    def learn(self, frame, target): {learn}\n    def update(self, frame): {update}\n"
        "    def close(self): 1 / 0\n"
    )
    folder = write_sequence(tmp_path / "toy", 3)
    assert cli.main(["evaluate", "tracking", str(folder), "--tracker", f"{own}:Mine"]) == 1
    assert said in capsys.readouterr().err
    assert "did not close cleanly: ZeroDivisionError" in caplog.text


def test_trackers_are_compared_on_the_same_sequences(tmp_path, capsys):
    folder = write_sequence(tmp_path / "toy")
    path = tmp_path / "all.json"
    assert otb_command.main([str(folder), "--trackers", "phase,ncc", "--json", str(path)]) == 0
    figures = json.loads(path.read_text())
    assert [row["sequence"] for row in figures["phase"] + figures["ncc"]] == ["toy", "toy"]
    assert figures["_machine"]["cores"] >= 1


def test_peers_need_their_own_opencv():
    """The station's wheel has no CSRT; where the contrib wheel is installed instead, it is there."""
    if hasattr(cv2, "TrackerCSRT_create"):
        assert make_peer("csrt").flags == cv2.IMREAD_COLOR
    else:
        with pytest.raises(StationError, match="contrib wheel"):
            make_peer("csrt")
