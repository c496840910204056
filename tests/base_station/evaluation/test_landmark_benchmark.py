"""The benchmark of landmarks counts rightly, on a small run."""

from __future__ import annotations

import json

from base_station.evaluation.landmark_benchmark import main, run_landmark_benchmark
from base_station.evaluation.worlds import generated_world


def test_a_small_run_finds_most_and_is_the_same_twice():
    worlds = [generated_world(n) for n in range(3)]
    first, again = (run_landmark_benchmark(worlds[:2], worlds[2:], landmarks=8, frames=12, seed=1) for _ in range(2))
    assert first.landmarks == 8 and first.frames == 12 and first.empty_frames == 6
    assert first.ranges == again.ranges and first.wrong_sightings == again.wrong_sightings == 0
    assert sum(score.expected for score in first.ranges.values()) > 12
    assert first.ranges["zoom 0.7-1.4"].found >= 0.7
    assert first.false_frames == 0
    assert 0 < first.bytes_per_landmark <= 8192
    assert first.lookup_ms_p50 > 0 and first.phase_correlation_ms_p50 > 0


def test_a_world_without_its_landmarks_counts_as_none_found():
    """Looked for in views of other worlds: found must fall, or the count means nothing."""
    worlds = [generated_world(n) for n in range(2)]
    scores = run_landmark_benchmark(worlds[:1], worlds[:1], landmarks=4, frames=6, seed=0)
    assert scores.false_frames > 0.3, "the world that should show none shows them all"


def test_wrong_use_is_told(tmp_path, capsys):
    assert main(["--landmarks", "0"]) == 2
    assert "--landmarks must be" in capsys.readouterr().err
    assert main(["--images", str(tmp_path / "no")]) == 2
    figures = tmp_path / "figures.json"
    assert main(["--landmarks", "3", "--frames", "3", "--json", str(figures)]) == 0
    assert json.loads(figures.read_text())["landmarks"] == 3
    assert "look-up among 3 landmarks" in capsys.readouterr().out
