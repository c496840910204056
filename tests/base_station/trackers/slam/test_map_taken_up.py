"""A map of an earlier run: a new system finds itself in it, maps on, and joins what it has mapped before it did."""

from __future__ import annotations

import dataclasses
import multiprocessing

import cv2
import numpy as np
import pytest

from base_station import cli
from base_station.errors import StationError
from base_station.evaluation.slam.trajectory import Trajectory, write_tum
from base_station.geometry import PinholeCamera
from base_station.map_option import trackers_with_map
from base_station.trackers.slam.features import FeatureSettings
from base_station.trackers.slam.map_file import read_map, write_map
from base_station.trackers.slam.se3 import rotation_angle_rad
from base_station.trackers.slam.sim3 import align, transform
from base_station.trackers.slam.system import SlamSettings, SlamSystem
from base_station.trackers.slam.tracker import SlamTracker
from base_station.types import Box, Frame, TrackingState
from tests.base_station.trackers.slam.room import Room, small_camera, standing

CAMERA = small_camera()
PINHOLE = PinholeCamera(width=320, height=240, fx=CAMERA.fx, fy=CAMERA.fy, cx=CAMERA.cx, cy=CAMERA.cy)
ROOM = Room(CAMERA)
SETTINGS = SlamSettings(features=FeatureSettings(count=700))
FRAME_S = 1 / 30


def aside(start_deg: float, end_deg: float, count: int) -> list[np.ndarray]:
    """Round a circle of 1 m, looking outwards, up and down a little."""
    angles = np.radians(np.linspace(start_deg, end_deg, count))
    return [standing(np.sin(a), np.cos(a), a + 0.6, 0.1 * np.sin(3 * a)) for a in angles]


def shown_to(slam: SlamSystem, poses: list[np.ndarray], start_s: float = 0.0) -> list:
    return [slam.track(ROOM.picture(pose), start_s + k * FRAME_S) for k, pose in enumerate(poses)]


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    """The file, and from the map to the room the similarity of places, and the turn: the map is bent by 0.1 rad."""
    file, poses = tmp_path_factory.mktemp("map") / "room.npz", aside(0, 110, 45)
    with SlamSystem(CAMERA, settings=SETTINGS, single_process=True) as slam:
        shown_to(slam, poses)
        slam.finish()
        write_map(file, slam.saved())
        times, found = zip(*slam.trajectory(), strict=True)
    there, here = np.array([poses[round(time_s / FRAME_S)] for time_s in times]), np.array(found)
    u, _, v = np.linalg.svd(np.einsum("kij,klj->il", there[:, :3, :3], here[:, :3, :3]))
    return file, align(here[:, :3, 3], there[:, :3, 3]), u @ v


def start(file, single_process: bool = True) -> SlamSystem:
    return SlamSystem(CAMERA, settings=SETTINGS, single_process=single_process, saved=read_map(file))


def off(frame, room_from_map: np.ndarray, turn: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    """Metres and radians between a pose and the true one."""
    world_from_cam = np.linalg.inv(frame.cam_from_world)
    metres = np.linalg.norm(transform(room_from_map, world_from_cam[None, :3, 3])[0] - truth[:3, 3])
    return float(metres), rotation_angle_rad((turn @ world_from_cam[:3, :3]).T @ truth[:3, :3])


@pytest.mark.parametrize("single_process", [True, False])
def test_it_finds_itself_from_elsewhere_and_maps_on(mapped, single_process):
    file, *to_room = mapped
    before = read_map(file)
    elsewhere = [standing(0.5 + 0.02 * k, 0.55, 1.2 + 0.02 * k, 0.03) for k in range(30)]
    children = len(multiprocessing.active_children())
    with start(file, single_process) as slam:
        dark = slam.track(np.zeros((240, 320), np.uint8), 0.0)
        assert (dark.state, dark.reason) == (TrackingState.LOST, "no place of the map is recognised yet")
        assert slam.keyframes() == slam.trajectory() == []
        frames = shown_to(slam, elsewhere, 0.1)
        slam.finish()
        first = next(k for k, frame in enumerate(frames) if frame.state is TrackingState.TRACKING)
        assert first < 10
        assert {frame.component for frame in frames[first:]} == {0}
        for frame, truth in zip(frames[first:], elsewhere[first:], strict=True):
            metres, radians = off(frame, *to_room, truth)
            assert metres < 0.1 and radians < 0.05
        counts, keyframes = slam.statistics(), slam.keyframes()
        assert (counts.maps, counts.frames) == (1, 31) and counts.relocalizations >= 1
        assert keyframes and all(time_s >= 0.1 for time_s, _ in keyframes)
        assert counts.keyframes > len(before.columns["poses"]) - 3 and counts.points > len(before.columns["xyz"])
        after = slam.saved()
        assert after is not None and len(after.columns["poses"]) == counts.keyframes
        assert 0.95 * counts.points < len(after.columns["xyz"]) <= counts.points  # but those that nothing sees any more
    assert len(multiprocessing.active_children()) == children


def test_what_it_maps_before_it_finds_itself_is_joined(mapped):
    file, *to_room = mapped
    poses = aside(190, 415, 92)
    with start(file) as slam:
        slam.track(np.zeros((240, 320), np.uint8), 0.0)
        frames = shown_to(slam, poses, 2.0)
        slam.finish()
        components = [frame.component for frame in frames]
        assert next(component for component in components if component >= 0) == 1  # on its own, at first
        assert components[-1] == 0  # and then in the map of the file
        counts = slam.statistics()
        assert (counts.maps, counts.merges) == (1, 1)
        metres, radians = off(frames[-1], *to_room, poses[-1])
        assert metres < 0.25 and radians < 0.08


def frame(pose: np.ndarray, number: int, camera: PinholeCamera = PINHOLE) -> Frame:
    return Frame(image=ROOM.picture(pose), number=number, time_s=number * FRAME_S, camera=camera)


def test_a_target_learned_in_a_known_room_is_in_the_map_at_once(mapped, tmp_path):
    file, said = tmp_path / "own.npz", []
    file.write_bytes(mapped[0].read_bytes())
    poses, target = aside(40, 52, 8), Box.around(160, 120, 150, 120)
    tracker = SlamTracker(settings=SETTINGS, single_process=True, map_file=file, say=said.append)
    tracker.keep_map()  # nothing seen yet: nothing written
    assert file.read_bytes() == mapped[0].read_bytes()
    other = dataclasses.replace(PINHOLE, fx=400.0, fy=400.0)
    with pytest.raises(StationError, match="of another camera"):
        tracker.learn(frame(poses[0], 0, other), target)
    tracker.learn(frame(poses[0], 0), target)
    results = [tracker.update(frame(pose, k)) for k, pose in enumerate(poses)]
    assert {result.state for result in results} == {TrackingState.TRACKING}
    assert all(result.cam_from_world is not None and result.zoom is not None for result in results[1:])
    tracker.close()
    before, after = read_map(mapped[0]), read_map(file)
    assert said == [f"map: {before.told} from {file}", f"map: {after.told} to {file}"]


def test_a_map_with_nothing_in_it_is_not_written(tmp_path):
    file, said = tmp_path / "new.npz", []
    tracker = trackers_with_map(file, said.append)("slam")
    tracker.learn(frame(standing(0, 0, 0), 0), None)
    tracker.update(frame(standing(0, 0, 0), 1))
    tracker.close()
    assert not file.exists()
    assert [line.partition(",")[0] for line in said] == ["map: a new one", "map: too little was seen to be kept"]


def test_evaluate_goes_on_where_it_left_off(tmp_path, capsys):
    folder, file, times, poses = tmp_path / "room", tmp_path / "room.map", 100.0 + np.arange(30) / 30, aside(20, 80, 30)
    (folder / "rgb").mkdir(parents=True)
    for time_s, pose in zip(times, poses, strict=True):
        cv2.imwrite(str(folder / "rgb" / f"{time_s:.6f}.png"), ROOM.picture(pose))
    (folder / "rgb.txt").write_text("".join(f"{time_s:.6f} rgb/{time_s:.6f}.png\n" for time_s in times))
    write_tum(folder / "groundtruth.txt", Trajectory(times, np.stack(poses)))
    (folder / "camera.yaml").write_text(
        '%YAML:1.0\nCamera.type: "PinHole"\nCamera1.fx: 260.0\nCamera1.fy: 260.0\nCamera1.cx: 159.5\n'
        "Camera1.cy: 119.5\nCamera.width: 320\nCamera.height: 240\n"
    )
    evaluate = ["evaluate", "slam", str(folder), "--single-process", "--map", str(file)]
    assert cli.main(evaluate) == 0
    told = read_map(file).told
    assert f"map: {told} to {file}\n" in capsys.readouterr().err
    assert cli.main(evaluate) == 0
    said = capsys.readouterr()
    assert f"map: {told} from {file}\n" in said.err and f"map: {read_map(file).told} to {file}\n" in said.err
    assert "100.0%" in said.out  # from the first picture on
    told = read_map(file).told
    assert cli.main(["replay", str(folder), "--tracker", "slam", "--map", str(file), "--max-frames", "8"]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert f"map: {told} from {file}" in said and f"map: {read_map(file).told} to {file}" in said
    assert cli.main(["replay", str(folder), "--tracker", "phase", "--map", str(file)]) == 2
    assert "--map goes with --tracker slam" in " ".join(capsys.readouterr().err.split())
    whole = file.read_bytes()
    file.write_bytes(whole[:1000])
    assert cli.main(evaluate) == 2
    assert "no map of SLAM's" in " ".join(capsys.readouterr().err.split())
    assert file.read_bytes() == whole[:1000]


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["run", "--map", "room.npz"], "--map goes with --tracker slam"),
        (["run", "--tracker", "klt", "--shadow", "phase", "--map", "room.npz"], "--map goes with --tracker slam"),
        (["run", "--tracker", "slam", "--shadow", "slam", "--map", "room.npz"], "--map is for one slam"),
        (["run", "--tracker", "slam", "--map", "."], "is a folder"),
        (["evaluate", "slam", ".", "--tracker", "mine.py:Mine", "--map", "room.npz"], "--map goes with --tracker slam"),
    ],
)
def test_a_map_without_slam_is_said(capsys, options, why):
    assert cli.main(options) == 2
    assert why in " ".join(capsys.readouterr().err.split())


def test_the_map_is_a_setting(capsys, tmp_path):
    file = tmp_path / "robot.toml"
    file.write_text('[run]\nshadow = "slam"\nmap = "room.npz"\n')
    assert cli.main(["run", "--config", str(file), "--print-config"]) == 0
    assert f'map = "{tmp_path / "room.npz"}"' in capsys.readouterr().out
