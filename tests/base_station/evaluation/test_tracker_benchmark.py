"""The benchmark's arithmetic has known answers, its command known keys, exit codes and sentences."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from base_station.evaluation.benchmark_command import main
from base_station.evaluation.conditions import reference_view
from base_station.evaluation.footprint import array_bytes, landmark_bytes
from base_station.evaluation.goals import Goal, goals_of
from base_station.evaluation.tracker_benchmark import BenchmarkScores, score_condition, score_target
from base_station.evaluation.worlds import generated_world
from base_station.trackers.registry import make_tracker

NAN = float("nan")
CONDITION_KEYS = {"frames", "median_px", "within_1_5", "zoom_err_median", "tracked_share", "us_p50"}


def test_statistics_of_a_condition():
    rows = np.array([(0.1, 0.01, 0.9, 100), (0.3, 0.03, 0.8, 300), (1.5, NAN, 0.7, 200), (NAN, NAN, NAN, 900)])
    score = score_condition(rows)
    assert (score.frames, score.tracked_share, score.within_1_5) == (4, 0.75, 0.75)
    assert (score.median_px, score.zoom_err_median, score.us_p50) == (0.3, 0.02, 250)


def test_a_condition_in_which_nothing_was_tracked():
    score = score_condition(np.array([(NAN, NAN, NAN, 50.0)] * 3))
    assert (score.median_px, score.zoom_err_median, score.within_1_5, score.tracked_share) == (None, None, 0, 0)


def test_false_tracking_at_the_confidence_that_99_of_100_reach():
    visible = np.linspace(0.40, 0.895, 100)  # the lowest, 0.40, may be given up
    strange = {"other": np.array([NAN, 0.402, 0.5]), "mirrored": np.array([NAN, NAN, 0.41])}
    score = score_target(visible, strange, [(1000, 9), (3000, 7), (2000, 8)])
    assert score.threshold_at_99 == pytest.approx(0.405)
    assert score.false_tracking_rate == pytest.approx(3 / 6)
    assert score.false_tracking_at_99 == pytest.approx(2 / 6)
    assert score.false_by_kind == {"other": pytest.approx(2 / 3), "mirrored": pytest.approx(1 / 3)}
    assert (score.bytes_per_landmark, score.running_bytes) == (2000, 8)
    assert (score.frames_without_target, score.visible_tracked_share) == (6, 1)


@pytest.mark.parametrize(("lost", "threshold"), [(1, 0.6), (2, None)])
def test_more_than_one_of_a_hundred_lost_leaves_no_threshold(lost, threshold):
    visible = np.array([NAN] * lost + [0.6] * (100 - lost))
    score = score_target(visible, {"other": np.array([0.1, NAN])}, [])
    assert score.threshold_at_99 == threshold
    assert score.false_tracking_at_99 == (0.5 if threshold is None else 0)


def test_bytes_are_those_of_arrays_each_counted_once():
    class Holder:
        def __init__(self):
            whole = np.zeros((100, 10), np.float32)
            self.views = [whole[:5], whole.T]
            self.more = {"a": (np.zeros(3, np.uint8), "text", None)}
            self.myself = self

    assert array_bytes(Holder()) == 4000 + 3


def test_bytes_of_a_landmark_are_what_learning_added():
    tracker = make_tracker("z-regions")
    assert landmark_bytes(tracker, lambda: False) is None

    def learn() -> bool:
        tracker.kept = np.zeros(7, np.float64)
        return True

    assert landmark_bytes(tracker, learn) == 56
    tracker.landmark_bytes = 12
    assert landmark_bytes(tracker, lambda: True) == 12


def test_verdicts():
    goal = Goal(name="it", figure=0.02, bar=0.01, is_largest=True)
    assert goal.verdict() == "missed by 0.01"
    assert replace(goal, figure=0.01).verdict() == "reached"
    assert replace(goal, figure=None).verdict().startswith("no figure")
    share = Goal(name="share", figure=0.9, bar=0.95, is_largest=False)
    assert (share.is_reached, replace(share, figure=0.95).is_reached) == (False, True)


def test_light_is_judged_against_the_clean_figure():
    rows = {"shift": 0.02, "gamma": 0.031, "gradient": 0.029}
    table = {name: score_condition(np.array([(px, 0.001, 0.9, 50.0)])) for name, px in rows.items()}
    target = score_target(np.array([0.9]), {"other": np.array([NAN])}, [(4096, 1 << 20)])
    goals = {goal.name: goal for goal in goals_of(BenchmarkScores({"t": table}, {"t": target}, {}), None, "t")}
    assert not goals["gamma: median error, px (1.5 x shift)"].is_reached
    assert goals["gradient: median error, px (1.5 x shift)"].is_reached
    assert goals["bytes to keep of a landmark"].is_reached
    assert not any(name.startswith(("noise", "zoom", "tracking")) for name in goals)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One quick run of two trackers; its JSON, its folder of plots, its exit code."""
    folder = tmp_path_factory.mktemp("benchmark")
    arguments = ["--quick", "--trackers", "ztransform,phase", "--conditions", "zoom,shift"]
    code = main([*arguments, "--json", str(folder / "figures.json"), "--plots", str(folder / "plots")])
    return json.loads((folder / "figures.json").read_text()), folder / "plots", code


def test_json_has_a_table_for_each_tracker(run):
    figures, _, code = run
    assert code == 0
    assert {name for name in figures if not name.startswith("_")} == {"ztransform", "phase"}
    for name in ("ztransform", "phase"):
        assert set(figures[name]) == {"zoom", "shift"}
        for score in figures[name].values():
            assert set(score) == CONDITION_KEYS
            assert score["frames"] == 12
    assert set(figures["_trackers"]) == {"ztransform", "phase"}
    assert figures["_costs"]["tracking_us"] > 0
    goals = {goal["goal"] for goal in figures["_goals"]["ztransform"]}
    assert goals > {
        "zoom: share within 1.5 px",
        "bytes to keep of a landmark",
        "look-up among 20 landmarks, ms a frame",
    }
    assert figures["_run"]["worlds"] == ["generated 0", "generated 1"]


def test_figures_are_those_of_the_trackers(run):
    """Loosely, from both sides: exact on a shift; phase correlation knows no zoom and does not pretend to."""
    figures, _, _ = run
    assert 0 < figures["ztransform"]["shift"]["median_px"] < 0.3
    assert figures["ztransform"]["zoom"]["zoom_err_median"] < 0.01
    assert figures["phase"]["shift"]["within_1_5"] > 0.6
    assert figures["phase"]["zoom"]["within_1_5"] < 0.6
    assert figures["phase"]["zoom"]["zoom_err_median"] is None
    assert figures["_trackers"]["phase"]["bytes_per_landmark"] == 240 * 180
    assert figures["_trackers"]["phase"]["running_bytes"] >= 2 * 240 * 180 * 4, "a patch and a window, float32"
    assert figures["_trackers"]["ztransform"]["bytes_per_landmark"] <= 8192
    assert figures["_trackers"]["phase"]["false_tracking_rate"] < 0.5


def test_plots_show_curves(run):
    _, plots, _ = run
    for name in ("errors.png", "cost.png"):
        picture = cv2.imread(str(plots / name))
        assert (np.ptp(picture.astype(int), axis=2) > 60).sum() > 300, name


def test_a_place_is_learned_whole_and_seen_by_a_camera_that_turns(tmp_path):
    path = tmp_path / "figures.json"
    arguments = ["--quick", "--trackers", "ztransform", "--conditions", "shift", "--place", "--json", str(path)]
    assert main(arguments) == 0
    score = json.loads(path.read_text())["ztransform"]["shift"]
    assert score["within_1_5"] >= 0.9
    assert score["median_px"] < 0.3


def test_photographs_are_the_worlds_where_there_are_some(tmp_path):
    for seed in range(2):
        cv2.imwrite(str(tmp_path / f"{seed}.png"), reference_view(generated_world(20 + seed)))
    path = tmp_path / "figures.json"
    arguments = ["--quick", "--trackers", "phase", "--conditions", "shift", "--images", str(tmp_path)]
    assert main([*arguments, "--json", str(path)]) == 0
    assert json.loads(path.read_text())["_run"]["worlds"] == ["0.png", "1.png"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--trackers", "ztransfrom"], "did you mean ztransform?"),
        (["--trackers", ","], "--trackers ',' names none"),
        (["--trackers", "nowhere.py:Mine"], "there is no file nowhere.py"),
        (["--conditions", "fog"], "no condition 'fog'. There are: shift, noise, gain_offset"),
        (["--frames", "0"], "--frames must be 1..10000, not 0"),
        (["--worlds", "-1"], "--worlds must be 1..100, not -1"),
        (["--seed", "-1"], "--seed must be 0..4294967295, not -1"),
        (["--images", "nowhere"], "There is no folder nowhere"),
        (["--json", "nowhere/figures.json"], "--json nowhere/figures.json: there is no folder nowhere"),
        (["--frames", "many"], "many"),
    ],
)
def test_wrong_usage_is_one_sentence_and_exit_code_2(capsys, arguments, said):
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert said in " ".join((printed.err + printed.out).split())
    assert "Traceback" not in printed.err
