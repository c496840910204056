"""The comparison with ORB-SLAM3: the files it is given, its adapter with the library faked, the table, and failures."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from base_station.evaluation.slam import comparison
from base_station.evaluation.slam.camera_files import read_orbslam
from base_station.evaluation.slam.comparison import comparison_table, run_program
from base_station.evaluation.slam.orbslam_files import write_settings, write_vocabulary
from base_station.evaluation.slam.trajectory import Trajectory, write_tum
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.sim3 import inverse
from base_station.trackers.slam.vocabulary import TreeSettings, train
from tests.base_station.evaluation.slam import sequences
from tests.base_station.evaluation.slam.sequences import (
    FRAMES,
    ConstantMotion,
    write_euroc_sequence,
    write_tum_sequence,
)

PEER = Path(__file__).parents[4] / "scripts" / "peers" / "orbslam3.py"


@pytest.mark.parametrize("distortion", [(), (-0.1, 0.02, 0.001, -0.002), (0.2, -0.9, -0.005, 0.003, 1.1)])
def test_settings_say_what_the_camera_is(tmp_path, distortion):
    camera = SlamCamera(width_px=752, height_px=480, fx=458, fy=457.25, cx=367.2, cy=248.4, distortion=distortion)
    write_settings(tmp_path / "settings.yaml", camera, 19.98)
    assert read_orbslam(tmp_path / "settings.yaml").camera(752, 480) == camera
    text = (tmp_path / "settings.yaml").read_text()
    assert "Camera.fps: 20\n" in text
    assert "Camera1.fx: 458.0\n" in text, "ORB-SLAM3 refuses whole numbers"


def test_the_vocabulary_in_dbow_format_is_the_same_tree(tmp_path):
    rng = np.random.default_rng(0)
    vocabulary = train([rng.integers(0, 256, (300, 32), np.uint8)], TreeSettings(branching=3, depth=3))
    write_vocabulary(tmp_path / "words.txt", vocabulary)
    header, *lines = (tmp_path / "words.txt").read_text().splitlines()
    assert header == "3 6 0 0" and len(lines) == 3 + 9 + 27
    children, leaves, words = {}, {}, 0
    descriptors = {}
    for number, line in enumerate(lines, 1):
        parent, leaf, *rest = line.split()
        children.setdefault(int(parent), []).append(number)
        descriptors[number] = np.array(rest[:32], np.uint8)
        if leaf == "1":
            leaves[number] = words
            assert float(rest[32]) == pytest.approx(vocabulary.weights[words], abs=1e-5)
            words += 1
    asked = rng.integers(0, 256, (50, 32), np.uint8)
    for descriptor, word in zip(asked, vocabulary.bow(asked)[0], strict=True):
        node = 0
        while node not in leaves:
            node = min(children[node], key=lambda n: np.bitwise_count(descriptors[n] ^ descriptor).sum())
        assert leaves[node] == word


class FakeSlam(ConstantMotion):
    """The library's face: poses world from camera, trajectories as files after the end."""

    def __init__(self, vocabulary, settings, sensor, viewer):
        assert Path(vocabulary).is_file() and Path(settings).is_file() and not viewer
        super().__init__(read_orbslam(Path(settings)).camera(96, 72))

    def track_monocular(self, image, time_s):
        frame = self.track(image, time_s)
        valid = frame.cam_from_world is not None
        return types.SimpleNamespace(pose_valid=valid, pose_wc=inverse(frame.cam_from_world) if valid else None)

    def shutdown(self):
        assert not self.is_closed
        self.is_closed = True

    def save_trajectory_euroc(self, name):
        write_tum(Path(name), Trajectory.of(self.trajectory()))
        rows = [line.split() for line in Path(name).read_text().splitlines()]
        Path(name).write_text("\n".join(f"{float(row[0]) * 1e9:.6f} {' '.join(row[1:])}" for row in rows))

    def save_keyframe_trajectory_tum(self, name):
        assert self.is_closed
        write_tum(Path(name), Trajectory.of(self.keyframes()))


def test_the_adapter_is_scored_as_ours_is(tmp_path, monkeypatch):
    library = types.SimpleNamespace(Slam=FakeSlam, Sensor=types.SimpleNamespace(MONOCULAR=0))
    monkeypatch.setitem(sys.modules, "pyorbslam3", library)
    spec = importlib.util.spec_from_file_location("orbslam3_peer", PEER)
    peer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(peer)
    folder = write_tum_sequence(tmp_path / "toy")
    (tmp_path / "words.txt").write_text("3 6 0 0\n")
    files = {
        "--vocabulary": tmp_path / "words.txt",
        "--settings": folder / "orbslam3.yaml",
        "--json": tmp_path / "o.json",
    }
    options = [str(part) for pair in files.items() for part in pair]
    monkeypatch.setattr(sys, "argv", ["orbslam3", str(folder), *options])
    assert peer.main() == 0
    found = json.loads((tmp_path / "o.json").read_text())
    assert (found["tracker"], found["frames"], found["tracked_frames"]) == ("ORB-SLAM3", FRAMES, FRAMES - 3)
    assert found["initializing_frames"] == 3
    assert found["ate_rmse"] < 1e-4 and found["ate_online_rmse"] < 1e-4 and found["ate_poses"] == FRAMES - 3
    assert found["keyframes"] == 5 and found["points"] is None and found["loops"] is None


def test_the_adapter_needs_no_more_than_is_installed_for_it():
    """compare-slam gives ORB-SLAM3 an environment of its own, with little in it."""
    script = (PEER.parents[1] / "compare-slam").read_text()
    packages = re.search(r"grep -E '\^\(([a-z|-]+)\)=='", script)[1].split("|")
    assert {"numpy", "opencv-python-headless"} < set(packages)
    names = {"opencv-python-headless": "cv2"}
    allowed = {names.get(package, package) for package in packages} | {"llvmlite"}  # which numba brings
    program = f"""
import importlib.util, runpy, sys, sysconfig
class OnlyThese:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in {allowed!r} and top not in ("base_station", "protocol", *sys.stdlib_module_names):
            raise ModuleNotFoundError("No module named " + repr(top), name=top)
sys.meta_path.insert(0, OnlyThese())
runpy.run_path({str(PEER)!r}, run_name="peer")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_ours_alone_where_orbslam_is_not_installed(tmp_path, monkeypatch, capsys):
    folder, file = write_euroc_sequence(tmp_path / "toy", 12), tmp_path / "all.json"
    monkeypatch.setattr(comparison, "PEER_PYTHON", tmp_path / "nothing")
    ours = comparison._ours
    stand_in = ["--tracker", f"{sequences.__file__}:ConstantMotion"]
    monkeypatch.setattr(comparison, "_ours", lambda command: ours(command) + stand_in)
    options = [str(folder), "--runs", "1", "--max-frames", "8", "--json", str(file)]
    assert comparison.main(options) == 0
    said = capsys.readouterr()
    assert "machine: " in said.out and "load before the runs" in said.out
    assert "toy, 8 pictures, real time" in said.out and "62.5%" in said.out
    assert "ORB-SLAM3 is not installed" in said.err
    found = json.loads(file.read_text())
    assert [run["frames"] for run in found["zservo"]] == [8] and found["zservo"][0]["realtime"] is True


def test_a_failed_run_does_not_lose_the_others(tmp_path, monkeypatch, capsys):
    folder, figures = write_tum_sequence(tmp_path / "toy", 4), [{"tracked_share": 0.5}, None, {"tracked_share": 0.7}]
    monkeypatch.setattr(comparison, "PEER_PYTHON", tmp_path / "nothing")

    def run(program, file):
        found = figures.pop(0)
        if found is None:
            raise comparison.StationError("it crashed")
        return found

    monkeypatch.setattr(comparison, "run_program", run)
    assert comparison.main([str(folder)]) == 0
    said = capsys.readouterr()
    assert "60.0%" in said.out and "it crashed" in said.err
    figures[:] = [None] * 3
    assert comparison.main([str(folder)]) == 1
    assert "zservo failed in every run" in capsys.readouterr().err


def test_the_table_has_every_run_and_the_medians():
    runs = [
        {"tracked_share": share, "ate_rmse": ate, "ms_p50": 9.0} for share, ate in ((0.9, 0.2), (0.8, None), (1, 0.4))
    ]
    table = comparison_table("toy", {"zservo": runs, "ORB-SLAM3": runs[:1]})
    columns = [list(column.cells) for column in table.columns]
    assert columns[0] == ["zservo 1", "zservo 2", "zservo 3", "zservo median", "ORB-SLAM3 1", "ORB-SLAM3 median"]
    assert columns[1] == ["90.0%", "80.0%", "100.0%", "90.0%", "90.0%", "90.0%"]
    assert columns[2] == ["0.2000", "-", "0.4000", "0.3000", "0.2000", "0.2000"]
    assert columns[-1] == ["-"] * 6


def test_what_fails_says_why(tmp_path, capsys):
    failing = [sys.executable, "-c", "import sys; sys.exit('no vocabulary')"]
    with pytest.raises(comparison.StationError, match="no vocabulary"):
        run_program(failing, tmp_path / "figures.json")
    with pytest.raises(comparison.StationError, match="exit code 0: it said nothing"):
        run_program([sys.executable, "-c", "pass"], tmp_path / "figures.json")
    late = "import os, sys; open(sys.argv[-1], 'w').write('{\"frames\": 3}'); os.abort()"
    assert run_program([sys.executable, "-c", late], tmp_path / "figures.json") == {"frames": 3}
    assert comparison.main([str(tmp_path / "nothing")]) == 2
    assert comparison.main([str(tmp_path), "--runs", "0"]) == 2
    assert "There is no folder" in capsys.readouterr().err
