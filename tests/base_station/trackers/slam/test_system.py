"""The whole system in a rendered room: it follows, says LOST and not a wild pose, and finds itself again."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest

from base_station.errors import StationError
from base_station.trackers.slam.features import FeatureSettings
from base_station.trackers.slam.se3 import rotation_angle_rad
from base_station.trackers.slam.sim3 import align, transform
from base_station.trackers.slam.system import SlamSettings, SlamSystem
from base_station.types import TrackingState
from tests.base_station.trackers.slam.room import Room, small_camera, standing

CAMERA = small_camera()
ROOM = Room(CAMERA)
SETTINGS = SlamSettings(features=FeatureSettings(count=600))
ALONG = [standing(-0.6 + 0.03 * k, -1.0 + 0.1 * np.sin(k / 6), 0.5 + 0.004 * k, 0.1 * np.cos(k / 5)) for k in range(50)]
FRAME_S = 1 / 30


def drive(slam: SlamSystem, poses: list[np.ndarray], start_s: float = 0.0, light: float = 1.0) -> list:
    pictures = (np.clip(ROOM.picture(pose) * light, 0, 255).astype(np.uint8) for pose in poses)
    return [slam.track(picture, start_s + k * FRAME_S) for k, picture in enumerate(pictures)]


def start(single_process: bool = True) -> SlamSystem:
    return SlamSystem(CAMERA, settings=SETTINGS, single_process=single_process)


def errors(slam: SlamSystem, poses: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Of every frame of the trajectory: metres off, when it is aligned with the truth, and by how many radians it has
    turned too much or too little against the last."""
    trajectory = slam.trajectory()
    truth = np.array([poses[round(time_s / FRAME_S)] for time_s, _ in trajectory])
    found = np.array([pose for _, pose in trajectory])
    world_from_map = align(found[:, :3, 3], truth[:, :3, 3])
    metres = np.linalg.norm(transform(world_from_map, found[:, :3, 3]) - truth[:, :3, 3], axis=1)
    turns = [(one[-1, :3, :3].T @ pose[:3, :3]) for one in (found, truth) for pose in one]
    n = len(found)
    return metres, np.array([rotation_angle_rad(turns[k].T @ turns[n + k]) for k in range(n)])


def test_it_follows_and_is_the_same_every_time():
    runs = []
    for _ in range(2):
        with start() as slam:
            frames = drive(slam, ALONG)
            slam.finish()
            runs.append(slam.trajectory())
            assert len(slam.statistics().timings_ms["mapper: settled"]) == 1
            slam.finish()  # nothing new: the map stays as it is
            assert len(slam.statistics().timings_ms["mapper: settled"]) == 1
            states = [frame.state for frame in frames]
            first = states.index(TrackingState.TRACKING)
            assert first < 15
            assert set(states[first:]) == {TrackingState.TRACKING}
            metres, radians = errors(slam, ALONG)
            assert 1e-6 < np.sqrt(np.mean(metres**2)) < 0.04
            assert metres[-20:].max() < 0.04
            assert radians[10:].max() < 0.04
            counts = slam.statistics()
            assert counts.frames == 50
            assert counts.tracked == len(slam.trajectory()) == 50 - first
            assert counts.keyframes == len(slam.keyframes()) >= 3
            assert counts.points == len(slam.points()) > 150
            assert counts.maps == 1
    assert all(np.array_equal(one, two) for (_, one), (_, two) in zip(*runs, strict=True))


def test_a_camera_that_stands_takes_no_keyframes():
    rng = np.random.default_rng(3)
    picture = ROOM.picture(ALONG[-1]).astype(float)
    with start() as slam:
        drive(slam, ALONG)
        pictures = [np.clip(picture + rng.normal(0, 3, picture.shape), 0, 255).astype(np.uint8) for _ in range(45)]
        stood = [slam.track(one, (50 + k) * FRAME_S) for k, one in enumerate(pictures)]
        assert {frame.state for frame in stood} == {TrackingState.TRACKING}
        assert sum(frame.keyframe for frame in stood) <= 1  # the first: it has moved since the last one
        assert any(frame.keyframe for frame in drive(slam, ALONG[::-1][:15], 95 * FRAME_S))


def test_covered_carried_away_and_found_again():
    elsewhere = standing(-0.3, -0.9, 0.52)
    with start() as slam:
        drive(slam, ALONG)
        covered = [slam.track(np.zeros((240, 320), np.uint8), 2.0 + k * FRAME_S) for k in range(10)]
        assert {frame.state for frame in covered} == {TrackingState.LOST}
        assert all(frame.cam_from_world is None and frame.reason for frame in covered)
        found = [slam.track(ROOM.picture(elsewhere), 60.0 + k * FRAME_S) for k in range(10)]
        assert found[-1].state is TrackingState.TRACKING
        slam.finish()
        times, poses = zip(*slam.trajectory(), strict=True)
        truth = [ALONG[round(time_s / FRAME_S)] if time_s < 50 else elsewhere for time_s in times]
        there, here = (np.array([pose[:3, 3] for pose in poses]) for poses in (truth, poses))
        assert np.linalg.norm(transform(align(here, there), here) - there, axis=1)[10:].max() < 0.1
        counts = slam.statistics()
        assert counts.relocalizations >= 1
        assert counts.maps == 1


def test_light_to_a_third_and_back():
    with start() as slam:
        drive(slam, ALONG[:40])
        dark = drive(slam, ALONG[40:45], 40 * FRAME_S, light=0.33)
        again = drive(slam, ALONG[45:], 45 * FRAME_S)
        assert again[-1].state is TrackingState.TRACKING
        assert all(frame.state is TrackingState.TRACKING or frame.reason for frame in dark)
        assert errors(slam, ALONG)[0][10:].max() < 0.08


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


def test_a_loop_is_closed_and_the_map_is_one():
    """Once around in a room, looking outwards: what is seen at the end was seen at the start, and nothing between.

    Six centimetres a frame: with four, a turn of 2.5 degrees shows too little depth for some rooms to be followed.
    """
    room = Room(CAMERA, size=(6.0, 3.0, 6.0), seed=3)
    angles = np.radians(2.5 * np.arange(172))
    poses = [standing(1.4 * np.sin(a), 1.4 * np.cos(a), a + 0.6, 0.1 * np.sin(3 * a)) for a in angles]
    with SlamSystem(CAMERA, settings=SlamSettings(features=FeatureSettings(count=700)), single_process=True) as slam:
        states = [slam.track(room.picture(pose), k * FRAME_S).state for k, pose in enumerate(poses)]
        slam.finish()
        counts = slam.statistics()
        assert counts.loops == 1
        assert counts.maps == 1
        assert states.count(TrackingState.TRACKING) > 150
        metres, _ = errors(slam, poses)
        assert 0.005 < np.sqrt(np.mean(metres**2)) < 0.05  # of 10.5 m; 0.021 when this was written


def test_with_the_mapper_in_a_process_of_its_own_which_ends():
    before = set(multiprocessing.active_children())
    slam = start(single_process=False)
    mapper = (set(multiprocessing.active_children()) - before).pop()
    try:
        frames = drive(slam, ALONG)
        assert frames[-1].state is TrackingState.TRACKING
        slam.finish()
        metres, _ = errors(slam, ALONG)
        assert np.sqrt(np.mean(metres**2)) < 0.04
        assert len(slam.keyframes()) >= 3
    finally:
        slam.close()
        slam.close()
    assert not mapper.is_alive()


def test_who_waits_gets_the_poses_of_a_single_process():
    """As in lockstep, where the robot's time stands meanwhile."""
    found = []
    for single_process in (True, False):
        with start(single_process) as slam:
            for k, pose in enumerate(ALONG):
                slam.track(ROOM.picture(pose), k * FRAME_S, wait=True)
            slam.finish()
            found.append(slam.trajectory())
    one, two = found
    assert [time_s for time_s, _ in one] == [time_s for time_s, _ in two]
    assert np.allclose([pose for _, pose in one], [pose for _, pose in two], atol=1e-4)


def test_pictures_faster_than_their_time_wait_for_the_mapper():
    """50 pictures in some tenths of a second: no keyframe is refused because the mapper is behind."""
    with start() as alone, start(single_process=False) as slam:
        drive(alone, ALONG)
        frames = drive(slam, ALONG)
        slam.finish()
        first = next(k for k, one in enumerate(frames) if one.component == 0)
        assert {frame.component for frame in frames[first:]} == {0}
        assert len(slam.keyframes()) >= max(len(alone.keyframes()) - 3, 3)


def test_a_mapper_that_dies_is_told_at_once_and_at_the_end():
    slam = start(single_process=False)
    mapper = multiprocessing.active_children()[-1]
    try:
        drive(slam, ALONG[:20])
        mapper.kill()
        mapper.join(5)
        with pytest.raises(StationError, match=r"mapper has ended .by signal 9.*start again"):
            drive(slam, ALONG[20:22], 20 * FRAME_S)
        with pytest.raises(StationError, match="mapper has ended"):
            slam.finish()
        assert len(slam.trajectory()) > 5
    finally:
        slam.close()
