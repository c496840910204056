"""Trajectories: the files against themselves, and the errors against a known disturbance and against evo."""

from __future__ import annotations

import re
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import pytest

from base_station.errors import StationError
from base_station.evaluation.slam.trajectory import (
    Trajectory,
    quaternions,
    read_euroc,
    read_kitti,
    read_tum,
    rotations,
    write_euroc,
    write_tum,
)
from base_station.evaluation.slam.trajectory_errors import associate, errors
from base_station.trackers.slam.sim3 import exp, rotation_matrix, rotation_of, scale_of

ROOT = Path(__file__).parents[4]
EVO, EVO_PACKAGES = ROOT / ".venv-evo", ("evo==1.13.5", "scipy==1.17.1", "numpy==2.4.6", "argcomplete", "colorama")
"""This evo computes what today's does, and its command runs with these packages alone: a tenth of today's."""


def wander(count, seed, rate_hz=30.0):
    """A smooth path through space."""
    rng = np.random.default_rng(seed)
    poses, step = [np.eye(4)], exp(np.array([0.01, 0.02, -0.01, 0.03, 0.01, 0.05, 0]))
    for _ in range(count - 1):
        step = exp(np.append(rng.normal(0, 0.002, 6), 0)) @ step
        poses.append(poses[-1] @ step)
    return Trajectory(50.0 + np.arange(count) / rate_hz, np.stack(poses))


def disturbed(truth, seed, *, place=0.0, turn=0.0, world=None):
    """The same path in another world, with noise on every pose."""
    rng = np.random.default_rng(seed)
    poses = truth.world_from_cam.copy()
    for pose in poses:
        pose[:3, 3] += rng.normal(0, place, 3) if place else 0
        pose[:3, :3] = pose[:3, :3] @ rotation_matrix(rng.normal(0, turn, 3)) if turn else pose[:3, :3]
    if world is not None:
        poses = world @ poses
        poses[:, :3, :3] = rotation_of(poses)
    return Trajectory(truth.times_s, poses)


WORLD = exp(np.array([0.5, -1.0, 0.3, 4.0, -2.0, 1.0, np.log(0.2)]))


def test_quaternions_and_back():
    turns = np.stack([rotation_matrix(v) for v in np.random.default_rng(0).uniform(-1.8, 1.8, (200, 3))])
    turns = np.concatenate([turns, [np.eye(3)], [np.diag([1.0, -1, -1])], [rotation_matrix(np.array([0, np.pi, 0]))]])
    found = quaternions(turns)
    assert np.linalg.norm(found, axis=1) == pytest.approx(1)
    assert (found[:, 3] >= 0).all()
    assert rotations(found) == pytest.approx(turns, abs=1e-12)
    half = np.sqrt(0.5)
    assert quaternions(rotation_matrix(np.array([0, 0, np.pi / 2]))[None])[0] == pytest.approx([0, 0, half, half])


def test_files_keep_a_trajectory(tmp_path):
    truth = wander(40, 0)
    write_tum(tmp_path / "tum.txt", truth)
    write_euroc(tmp_path / "euroc.csv", truth)
    for back in (read_tum(tmp_path / "tum.txt"), read_euroc(tmp_path / "euroc.csv")):
        assert back.times_s == pytest.approx(truth.times_s, abs=1e-6)
        assert back.world_from_cam == pytest.approx(truth.world_from_cam, abs=1e-8)
    first = (tmp_path / "tum.txt").read_text().splitlines()[0]
    assert re.fullmatch(r"50\.000000( -?\d+\.\d{9}){7}", first)
    rows = [" ".join(map(repr, pose[:3].ravel().tolist())) for pose in truth.world_from_cam]
    (tmp_path / "kitti.txt").write_text("\n".join(rows))
    assert read_kitti(tmp_path / "kitti.txt", truth.times_s[:-3]).world_from_cam == pytest.approx(
        truth.world_from_cam[:-3]
    )


def test_a_disordered_file_is_put_in_order(tmp_path):
    (tmp_path / "tum.txt").write_text("# c\n2 1 0 0 0 0 0 1\n\n1 0 0 0 0 0 0 2.0\n")
    with pytest.raises(StationError, match="length 1"):
        read_tum(tmp_path / "tum.txt")
    (tmp_path / "tum.txt").write_text("2 1 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n2 5 0 0 0 0 0 1\n")
    assert read_tum(tmp_path / "tum.txt").times_s.tolist() == [1, 2]


@pytest.mark.parametrize("text", ["", "1 2 3\n", "1 a 0 0 0 0 0 1\n", "1 nan 0 0 0 0 0 1\n", "\0\xff\n"])
def test_a_damaged_file_is_one_sentence(tmp_path, text):
    path = tmp_path / "tum.txt"
    path.write_text(text)
    with pytest.raises(StationError, match=r"holds no poses|8 numbers are expected"):
        read_tum(path)
    with pytest.raises(StationError, match=r"holds no poses|8 numbers are expected"):
        read_euroc(path)
    with pytest.raises(StationError, match="cannot be read"):
        read_tum(tmp_path / "missing.txt")


def test_times_are_paired_with_the_nearest():
    truth = np.arange(0, 10, 0.1)
    found = np.array([-0.3, 0.004, 0.515, 0.55, 9.915, 30.0])
    assert associate(found, truth).tolist() == [[1, 0], [2, 5], [4, 99]]
    assert associate(truth, found).tolist() == [[0, 1], [5, 2], [99, 4]]
    assert associate(found[:0], truth).shape == (0, 2)


def test_another_world_is_no_error():
    truth = wander(90, 1)
    found = errors(disturbed(truth, 0, world=WORLD), truth)
    assert found is not None and found.poses == 90
    assert found.scale == pytest.approx(1 / scale_of(WORLD))
    for value in (found.ate_rmse, found.ate_max, found.rpe_trans_rmse, found.rpe_rot_deg_rmse, found.rpe_1s_trans_rmse):
        assert value == pytest.approx(0, abs=1e-6)


def test_noise_is_told_as_large_as_it_is():
    truth = wander(600, 2)
    found = errors(disturbed(truth, 3, place=0.01, turn=0.005, world=WORLD), truth)
    assert found is not None
    assert found.ate_rmse == pytest.approx(0.01 * np.sqrt(3), rel=0.05)
    assert found.rpe_trans_rmse == pytest.approx(0.01 * np.sqrt(6), rel=0.05)
    assert found.rpe_rot_deg_rmse == pytest.approx(np.degrees(0.005) * np.sqrt(6), rel=0.05)
    assert found.rpe_1s_rot_deg_rmse == pytest.approx(np.degrees(0.005) * np.sqrt(6), rel=0.05)
    assert found.ate_median < found.ate_mean < found.ate_rmse < found.ate_max < 0.05


def test_too_little_is_not_measured():
    truth = wander(30, 0)
    assert errors(Trajectory(truth.times_s[:2], truth.world_from_cam[:2]), truth) is None
    assert errors(Trajectory(truth.times_s + 99, truth.world_from_cam), truth) is None
    assert errors(Trajectory(truth.times_s, np.tile(np.eye(4), (30, 1, 1))), truth) is None
    short = errors(Trajectory(truth.times_s[:5], truth.world_from_cam[:5]), truth)
    assert short is not None and short.rpe_1s_trans_rmse is None and short.rpe_trans_rmse is not None


@pytest.fixture(scope="module")
def evo():
    """The folder of evo's commands, in an environment of its own (GPL: it is run, never imported)."""
    tools = EVO / "bin"
    if not (tools / "evo_ape").is_file():
        venv.create(EVO, with_pip=False, clear=True)
        install = [sys.executable, "-m", "pip", "--python", str(tools / "python"), "install", "--quiet", "--no-deps"]
        done = subprocess.run([*install, *EVO_PACKAGES], capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.skip(f"evo cannot be installed here: {done.stderr.strip().splitlines()[-1]}")
    return tools


@pytest.mark.timeout(900)  # evo is installed the first time
def test_the_errors_are_those_of_evo(evo, tmp_path):
    """Every third pose is missing and times are a bit off: pairs, alignment, ATE and RPE as evo computes them."""
    truth = wander(240, 4)
    whole = disturbed(truth, 5, place=0.02, turn=0.01, world=WORLD)
    kept = np.arange(240) % 3 != 0
    found = Trajectory(whole.times_s[kept] + 0.004, whole.world_from_cam[kept])
    write_tum(tmp_path / "truth.txt", truth)
    write_tum(tmp_path / "found.txt", found)

    def rmse(command, *options):
        files = [str(tmp_path / "truth.txt"), str(tmp_path / "found.txt")]
        line = [str(evo / command), "tum", *files, "-as", "--t_max_diff", "0.02", *options]
        said = subprocess.run(line, capture_output=True, text=True, check=True, timeout=60).stdout
        return float(re.search(r"rmse\s+([\d.]+)", said)[1])

    ours = errors(read_tum(tmp_path / "found.txt"), read_tum(tmp_path / "truth.txt"))
    assert ours is not None and ours.poses == 160
    assert ours.ate_rmse == pytest.approx(rmse("evo_ape"), abs=1e-6)
    assert ours.rpe_trans_rmse == pytest.approx(rmse("evo_rpe", "-d", "1", "-u", "f"), abs=1e-6)
    turned = rmse("evo_rpe", "-d", "1", "-u", "f", "-r", "angle_deg")
    assert ours.rpe_rot_deg_rmse == pytest.approx(turned, abs=1e-5)
    assert 0.03 < ours.ate_rmse < 0.04
