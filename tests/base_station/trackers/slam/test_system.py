"""The whole system in a rendered room: it follows, says LOST and not a wild pose, and finds itself again."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest

from base_station.trackers.slam.features import FeatureSettings
from base_station.trackers.slam.se3 import rotation_angle_rad
from base_station.trackers.slam.sim3 import align, transform
from base_station.trackers.slam.system import SlamSettings, SlamSystem
from base_station.types import TrackingState
from tests.base_station.trackers.slam.room import Room, small_camera, standing

CAMERA = small_camera()
ROOM = Room(CAMERA)
SETTINGS = SlamSettings(features=FeatureSettings(count=500))
ALONG = [standing(-0.6 + 0.03 * k, -1.0, 0.004 * k) for k in range(40)]
FRAME_S = 1 / 30


def drive(slam: SlamSystem, poses: list[np.ndarray], start_s: float = 0.0, light: float = 1.0) -> list:
    pictures = (np.clip(ROOM.picture(pose) * light, 0, 255).astype(np.uint8) for pose in poses)
    return [slam.track(picture, start_s + k * FRAME_S) for k, picture in enumerate(pictures)]


def start(single_process: bool = True) -> SlamSystem:
    return SlamSystem(CAMERA, settings=SETTINGS, single_process=single_process)


def errors(slam: SlamSystem, poses: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Metres and radians off, of every frame of the trajectory, when it is aligned with the truth."""
    trajectory = slam.trajectory()
    truth = np.array([poses[round(time_s / FRAME_S)] for time_s, _ in trajectory])
    found = np.array([pose for _, pose in trajectory])
    world_from_map = align(found[:, :3, 3], truth[:, :3, 3])
    metres = np.linalg.norm(transform(world_from_map, found[:, :3, 3]) - truth[:, :3, 3], axis=1)
    turned = world_from_map[:3, :3] / np.cbrt(np.linalg.det(world_from_map[:3, :3]))
    return metres, np.array([
        rotation_angle_rad(turned @ one[:3, :3] @ other[:3, :3].T) for one, other in zip(found, truth, strict=True)
    ])  # fmt: skip


def test_it_follows_and_is_the_same_every_time():
    runs = []
    for _ in range(2):
        with start() as slam:
            frames = drive(slam, ALONG)
            slam.finish()
            runs.append(slam.trajectory())
            states = [frame.state for frame in frames]
            first = states.index(TrackingState.TRACKING)
            assert first < 10
            assert set(states[first:]) == {TrackingState.TRACKING}
            metres, radians = errors(slam, ALONG)
            assert 1e-6 < np.sqrt(np.mean(metres**2)) < 0.01
            assert radians.max() < 0.01
            counts = slam.statistics()
            assert counts.frames == 40
            assert counts.tracked == len(slam.trajectory()) == 40 - first
            assert counts.keyframes == len(slam.keyframes()) >= 3
            assert counts.points == len(slam.points()) > 150
            assert counts.maps == 1
    assert all(np.array_equal(one, two) for (_, one), (_, two) in zip(*runs, strict=True))


def test_covered_carried_away_and_found_again():
    with start() as slam:
        drive(slam, ALONG)
        covered = [slam.track(np.zeros((240, 320), np.uint8), 1.4 + k * FRAME_S) for k in range(10)]
        assert {frame.state for frame in covered} == {TrackingState.LOST}
        assert all(frame.cam_from_world is None and frame.reason for frame in covered)
        keyframes = slam.statistics().keyframes
        elsewhere = [standing(-0.3, -0.9, 0.02)] * 10
        found = drive(slam, elsewhere, 40 * FRAME_S + 60.0)
        states = [frame.state for frame in found]
        assert TrackingState.TRACKING in states[:10]
        slam.finish()
        poses = {round(time_s / FRAME_S): pose for time_s, pose in slam.trajectory()}
        where = np.array([poses[k][:3, 3] for k in sorted(poses) if k < 40])
        truth = np.array([ALONG[k][:3, 3] for k in sorted(poses) if k < 40])
        world_from_map = align(where, truth)
        last = max(poses)
        assert np.linalg.norm(transform(world_from_map, poses[last][None, :3, 3]) - elsewhere[0][:3, 3]) < 0.05
        counts = slam.statistics()
        assert counts.relocalizations >= 1
        assert counts.maps == 1
        assert counts.keyframes >= keyframes


def test_light_to_a_third_and_back():
    with start() as slam:
        drive(slam, ALONG[:30])
        dark = drive(slam, ALONG[30:35], 30 * FRAME_S, light=0.33)
        again = drive(slam, ALONG[35:], 35 * FRAME_S)
        assert again[-1].state is TrackingState.TRACKING
        assert all(frame.state is TrackingState.TRACKING or frame.reason for frame in dark)
        assert errors(slam, ALONG)[0].max() < 0.05


def test_a_camera_that_only_turns_makes_no_map():
    with start() as slam:
        frames = drive(slam, [standing(0.0, 0.0, 0.03 * k) for k in range(30)])
        assert {frame.state for frame in frames} == {TrackingState.INITIALIZING}
        assert slam.trajectory() == []
        assert slam.keyframes() == []
        assert slam.points().shape == (0, 3)


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((0, 0), np.uint8), np.zeros((240, 321), np.uint8), np.zeros((240, 320, 3), np.uint8),
        np.zeros((240, 320), np.float32), np.zeros((240, 320), np.uint8), np.full((240, 320), 255, np.uint8), None,
    ],
)  # fmt: skip
def test_bad_pictures_are_said_and_lose_nothing(slam_that_tracks, picture):
    slam = slam_that_tracks
    keyframes = slam.statistics().keyframes
    bad = slam.track(picture, 100.0)
    assert bad.state is TrackingState.LOST
    assert bad.reason
    good = slam.track(ROOM.picture(ALONG[-1]), 100.0)
    assert good.state is TrackingState.TRACKING
    assert slam.statistics().keyframes >= keyframes


@pytest.fixture(scope="module")
def slam_that_tracks():
    with start() as slam:
        drive(slam, ALONG)
        yield slam


def test_with_the_mapper_in_a_process_of_its_own_which_ends():
    before = set(multiprocessing.active_children())
    slam = start(single_process=False)
    mapper = (set(multiprocessing.active_children()) - before).pop()
    try:
        frames = drive(slam, ALONG)
        assert frames[-1].state is TrackingState.TRACKING
        slam.finish()
        metres, _ = errors(slam, ALONG)
        assert np.sqrt(np.mean(metres**2)) < 0.02
        assert len(slam.keyframes()) >= 3
    finally:
        slam.close()
        slam.close()
    assert not mapper.is_alive()
    assert mapper.exitcode == 0
