"""base-station evaluate slam with a stand-in that knows the path: figures, real time, files, and broken input."""

from __future__ import annotations

import json
import re

import cv2
import numpy as np
import pytest

from base_station import cli
from base_station.evaluation.slam.map_files import write_colmap, write_ply
from base_station.evaluation.slam.run import Outcome, figures, memory_mib, show
from base_station.evaluation.slam.sequence import read_sequence
from base_station.evaluation.slam.trajectory import Trajectory, read_euroc, read_tum, write_tum
from base_station.trackers.slam.camera import SlamCamera
from tests.base_station.evaluation.slam import sequences
from tests.base_station.evaluation.slam.sequences import (
    FRAMES,
    ConstantMotion,
    path,
    write_euroc_sequence,
    write_kitti_sequence,
    write_tum_sequence,
)

STAND_IN = f"{sequences.__file__}:ConstantMotion"
PROMISED = {"frames", "tracked_share", "ate_rmse", "rpe_trans_rmse", "rpe_rot_deg_rmse", "ms_p50", "ms_p95", "ms_max",
            "keyframes", "keyframes_per_s", "points", "maps", "loops"}  # fmt: skip


class Clock:
    """Time that passes only when somebody sleeps."""

    def __init__(self):
        self.now_s, self.slept_s = 0.0, []

    def __call__(self):
        return self.now_s

    def sleep(self, seconds):
        self.slept_s.append(seconds)
        self.now_s += seconds


def evaluate(folder, *options, tracker=STAND_IN):
    return cli.main(["evaluate", "slam", str(folder), "--tracker", tracker, *map(str, options)])


@pytest.mark.parametrize("write", [write_tum_sequence, write_euroc_sequence, write_kitti_sequence])
def test_the_figures_of_a_perfect_run(tmp_path, capsys, write):
    folder, file = write(tmp_path / "dataset" / "sequences" / "03"), tmp_path / "score.json"
    assert evaluate(folder, "--json", file) == 0
    found = json.loads(file.read_text())
    assert set(found) >= PROMISED
    assert (found["frames"], found["tracked_frames"], found["initializing_frames"]) == (FRAMES, FRAMES - 3, 3)
    assert found["tracked_share"] == (FRAMES - 3) / FRAMES
    assert found["ate_rmse"] < 1e-5 and found["ate_online_rmse"] < 1e-5 and found["rpe_rot_deg_rmse"] < 1e-3
    assert found["scale"] == pytest.approx(1 / 0.4, rel=1e-4)
    assert found["ate_poses"] == found["trajectory_poses"] == FRAMES - 3
    assert found["keyframes_per_s"] == pytest.approx(found["keyframes"] / ((FRAMES - 1) / 20), rel=1e-6)
    assert found["loops"] == 2 and found["stages_ms"]["tracking"] == {"p50": 2.0, "p95": 2.9, "max": 3.0, "runs": 3}
    assert 0 < found["ms_p50"] <= found["ms_p95"] <= found["ms_max"] < 2000
    assert found["machine"]["cores"] >= 1
    assert "87.5%" in capsys.readouterr().out


def test_real_time_waits_for_pictures_and_drops_those_that_come_too_late(tmp_path):
    sequence, clock = read_sequence(write_tum_sequence(tmp_path / "toy")), Clock()
    slow_at = {6: 0.16, 15: 0.04}

    class Slow(ConstantMotion):
        def track(self, image, time_s):
            clock.now_s += slow_at.get(self.seen, 0.001)
            return super().track(image, time_s)

    slam = Slow(sequence.camera)
    run = show(sequence, slam, realtime=True, clock=clock, sleep=clock.sleep)
    outcomes = [one.outcome for one in run.shown]
    assert [number for number, outcome in enumerate(outcomes) if outcome is Outcome.DROPPED] == [7, 8]
    assert slam.seen == FRAMES - 2
    assert run.shown[9].time_s == pytest.approx(sequence.times_s[9])
    assert clock.now_s == pytest.approx((FRAMES - 1) / 20 + 0.001)
    found = figures(sequence, run)
    assert (found["dropped_frames"], found["tracked_frames"], found["ms_max"]) == (2, FRAMES - 5, pytest.approx(40))
    assert found["tracked_share"] == pytest.approx((FRAMES - 5) / FRAMES)
    assert found["tracked_share_of_shown"] == pytest.approx((FRAMES - 5) / (FRAMES - 2))
    quick = show(sequence, ConstantMotion(sequence.camera), clock=clock, sleep=clock.sleep)
    assert all(one.outcome is not Outcome.DROPPED for one in quick.shown)


def test_what_is_written(tmp_path):
    folder, out = write_euroc_sequence(tmp_path / "toy"), tmp_path / "out"
    assert evaluate(folder, "--output", out) == 0
    truth = path(begin_s=1403636579.0)
    tum, euroc = read_tum(out / "CameraTrajectory.txt"), read_euroc(out / "CameraTrajectory.csv")
    assert len(tum) == len(euroc) == FRAMES - 3
    assert tum.times_s == pytest.approx(truth.times_s[3:], abs=1e-6)
    assert tum.world_from_cam == pytest.approx(euroc.world_from_cam, abs=1e-8)
    assert len(read_tum(out / "KeyFrameTrajectory.txt")) == 5
    rows = (out / "frames.csv").read_text().splitlines()
    assert rows[0] == "time_s,outcome,ms,keyframe,reason" and len(rows) == FRAMES + 1
    assert rows[1].endswith('"too little motion"') and ",INITIALIZING," in rows[1] and ",TRACKING," in rows[-1]
    for name in ("trajectory.png", "map.png"):
        picture = cv2.imread(str(out / name))
        assert picture.shape[0] > 500 and 5 < picture.std() < 100
    assert "03.png" not in (out / "colmap" / "images.txt").read_text()
    assert f"{round(truth.times_s[3] * 1e9)}.png" in (out / "colmap" / "images.txt").read_text()


def test_the_map_opens_elsewhere(tmp_path):
    camera = SlamCamera(width_px=96, height_px=72, fx=80, fy=81, cx=47, cy=36, distortion=(-0.1, 0.01, 0, 0))
    keyframes, points = path(4), np.random.default_rng(0).normal(0, 1, (9, 3))
    write_ply(tmp_path / "map.ply", points, keyframes)
    header, _, body = (tmp_path / "map.ply").read_text().partition("end_header\n")
    assert "element vertex 13" in header
    found = np.array([line.split() for line in body.splitlines()], float)
    assert found[:9, :3] == pytest.approx(points, rel=1e-5) and found[9:, :3] == pytest.approx(
        keyframes.positions, rel=1e-5
    )
    write_colmap(tmp_path / "model", camera, keyframes, [f"{number}.png" for number in range(4)], points)
    pycolmap = pytest.importorskip("pycolmap", reason="the extra slam (pycolmap) is not installed")
    model = pycolmap.Reconstruction()
    model.read_text(str(tmp_path / "model"))
    assert (model.num_images(), model.num_points3D()) == (4, 9)
    assert model.cameras[1].params.tolist() == [80, 81, 47.5, 36.5, -0.1, 0.01, 0, 0]
    for number, pose in enumerate(keyframes.world_from_cam, 1):
        assert model.images[number].projection_center() == pytest.approx(pose[:3, 3], abs=1e-9)
        assert model.images[number].cam_from_world().rotation.matrix() == pytest.approx(pose[:3, :3].T, abs=1e-9)
    assert model.points3D[9].xyz == pytest.approx(points[8], rel=1e-8)


def test_missing_and_changed_pictures_are_frames_without_a_pose(tmp_path, capsys):
    folder, file = write_tum_sequence(tmp_path / "toy"), tmp_path / "score.json"
    pictures = sorted((folder / "rgb").iterdir())
    pictures[10].unlink()
    pictures[12].write_bytes(b"no picture")
    cv2.imwrite(str(pictures[14]), np.zeros((40, 50), np.uint8))
    assert evaluate(folder, "--json", file) == 0
    found = json.loads(file.read_text())
    assert (found["unreadable_frames"], found["lost_frames"], found["longest_gap_frames"]) == (2, 1, 1)
    assert found["tracked_frames"] == FRAMES - 6
    assert f"2 pictures were passed over; the first: {pictures[10].name} cannot be read" in capsys.readouterr().err


def test_a_run_without_a_pose_still_writes_everything(tmp_path, capsys):
    folder, file, out = write_tum_sequence(tmp_path / "toy", 3), tmp_path / "score.json", tmp_path / "out"
    assert evaluate(folder, "--json", file, "--output", out) == 0
    found = json.loads(file.read_text())
    assert (found["tracked_share"], found["ate_rmse"], found["ate_poses"]) == (0, None, 0)
    assert (out / "trajectory.png").is_file() and (out / "map.ply").is_file()
    told = capsys.readouterr()
    assert "No picture was tracked: too little motion" in told.err and "No errors" not in told.err
    assert re.search(r"RPE, step to step +-, -", told.out) and "°" not in told.out


@pytest.mark.parametrize(
    ("options", "said", "code"),
    [
        (["--tracker", "ztransform"], "'ztransform' gives no trajectory", 2),
        (["--tracker", "no/such.py:Slam"], "there is no file", 2),
        (["--max-frames", "1"], "--max-frames must be at least 2", 2),
        (["--json", "nowhere/score.json"], "--json nowhere/score.json: there is no folder", 2),
        (["--camera", "nowhere/camera.yaml"], "--camera nowhere/camera.yaml cannot be read", 2),
        (["--seed", "-1"], "--seed must not be negative", 2),
    ],
)
def test_wrong_options_are_one_sentence(tmp_path, capsys, options, said, code):
    folder = write_tum_sequence(tmp_path / "toy", 3)
    assert evaluate(folder, *options) == code
    assert said in capsys.readouterr().err


def test_a_truth_of_other_times_is_told(tmp_path, capsys):
    folder = write_tum_sequence(tmp_path / "toy", 6)
    truth = read_tum(folder / "groundtruth.txt")
    write_tum(folder / "groundtruth.txt", Trajectory(truth.times_s + 800, truth.world_from_cam))
    assert evaluate(folder) == 0
    write_tum(folder / "groundtruth.txt", Trajectory(truth.times_s[-2:], truth.world_from_cam[-2:]))
    assert evaluate(folder) == 0
    told = capsys.readouterr().err
    assert "poses that have a true one within 0.02 s: 2 of 3; 3 are needed" in told
    assert "none of the 3 poses has a true one within 0.02 s: are both in the same clock" in told


def test_what_is_no_sequence_is_one_sentence(tmp_path, capsys):
    assert evaluate(tmp_path / "nothing") == 2
    assert evaluate(tmp_path) == 2
    error = capsys.readouterr().err
    assert "There is no folder" in error and "is no sequence" in error and "Traceback" not in error


def test_the_system_is_closed_whatever_happens(tmp_path, monkeypatch, capsys):
    closed = []
    monkeypatch.setattr("base_station.evaluation.slam.command.make_slam", lambda *_, **__: Failing(closed))

    class Failing(ConstantMotion):
        def __init__(self, closed):
            self.closed = closed

        def track(self, image, time_s):
            raise RuntimeError("a defect")

        def close(self):
            self.closed.append(True)

    assert evaluate(write_tum_sequence(tmp_path / "toy", 3)) == 1
    assert closed == [True]
    assert "The tracker failed at " in (error := capsys.readouterr().err) and "RuntimeError: a defect (" in error


@pytest.mark.parametrize(
    ("method", "said", "code"),
    [
        ("__init__(self, camera, **options): raise ValueError('no')", "Mine() failed: ValueError: no", 2),
        ("track(self, image, time_s): pass", "Mine.track returned NoneType, not a SlamFrame", 1),
        ("trajectory(self): return [(0.0, None), None]", "The tracker failed after the last picture: TypeError", 1),
        ("close(self): 1 / 0", "", 0),
    ],
)
def test_a_system_of_ones_own_that_fails_is_one_sentence(tmp_path, capsys, method, said, code):
    own = tmp_path / "mine.py"
    own.write_text(f"from {sequences.__name__} import ConstantMotion\nclass Mine(ConstantMotion):\n    def {method}\n")
    assert evaluate(write_tum_sequence(tmp_path / "toy", 3), tracker=f"{own}:Mine") == code
    assert said in capsys.readouterr().err


def test_a_system_that_lacks_methods_is_wrong_usage(tmp_path, capsys):
    own = tmp_path / "mine.py"
    own.write_text("class Mine:\n    def __init__(self, camera, **options): pass\n    def track(self, i, t): pass\n")
    assert evaluate(write_tum_sequence(tmp_path / "toy", 3), tracker=f"{own}:Mine") == 2
    assert "it has no method finish, trajectory, keyframes" in capsys.readouterr().err


def test_memory_is_that_of_this_process_and_its_children():
    mib = memory_mib()
    assert mib is None or 20 < mib < 4000
    assert Trajectory.of([(2.0, np.eye(4)), (1.0, np.eye(4)), (2.0, np.eye(4))]).times_s.tolist() == [1.0, 2.0]
