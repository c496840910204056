"""SLAM as a tracker, in a rendered room: bearing, zoom and view angle of a target on a wall, in sight and out of it."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest

from base_station.geometry import PinholeCamera
from base_station.trackers.slam.features import FeatureSettings
from base_station.trackers.slam.lens import Lens, look_through, through
from base_station.trackers.slam.system import SlamSettings
from base_station.trackers.slam.tracker import SlamTracker
from base_station.types import Box, Frame, TrackingState
from tests.base_station.trackers.slam.room import Room, small_camera, standing

CAMERA = small_camera()
PINHOLE = PinholeCamera(width=320, height=240, fx=CAMERA.fx, fy=CAMERA.fy, cx=CAMERA.cx, cy=CAMERA.cy)
ROOM = Room(CAMERA)
START = standing(-0.6, -1.0, 0.5)
TARGET = Box.around(170, 120, 110, 100)


def path(k: int) -> np.ndarray:
    return standing(-0.6 + 0.03 * k, -1.0 + 0.1 * np.sin(k / 6), 0.5 + 0.004 * k, 0.1 * np.sin(k / 5))


def frame(pose: np.ndarray, number: int) -> Frame:
    return Frame(image=ROOM.picture(pose), number=number, time_s=number / 30, camera=PINHOLE)


def on_the_wall(column: float, row: float) -> np.ndarray:
    """The point of the room that the first view shows there."""
    ray = START[:3, :3] @ np.array([(column - CAMERA.cx) / CAMERA.fx, (row - CAMERA.cy) / CAMERA.fy, 1.0])
    half = np.array([2.5, 1.5, 2.5])
    return START[:3, 3] + ray * ((np.sign(ray) * half - START[:3, 3]) / ray).min()


@pytest.fixture(scope="module")
def seen():
    """The tracker after 50 frames of a drive past the target, and what it said of each."""
    tracker = SlamTracker(settings=SlamSettings(features=FeatureSettings(count=600)), single_process=True)
    tracker.learn(frame(START, 1), TARGET)
    results = [tracker.update(frame(path(k), k + 2)) for k in range(50)]
    yield tracker, results
    tracker.close()


def true_bearing_rad(pose: np.ndarray) -> float:
    x, _, z = pose[:3, :3].T @ (on_the_wall(170, 120) - pose[:3, 3])
    return -math.atan2(x, z)


def test_it_tracks_from_the_first_frame_and_knows_a_pose_soon(seen):
    _, results = seen
    assert {result.state for result in results} == {TrackingState.TRACKING}
    assert all(result.cam_from_world is not None for result in results[25:])
    for k in (2, 25, 49):
        assert results[k].bearing_rad == pytest.approx(true_bearing_rad(path(k)), abs=0.04)


def test_zoom_and_view_angle_are_the_rooms(seen):
    _, results = seen
    point = on_the_wall(170, 120)
    depth = [(pose[:3, :3].T @ (point - pose[:3, 3]))[2] for pose in (START, path(49))]
    assert results[49].zoom == pytest.approx(depth[0] / depth[1], rel=0.06)
    sight = [math.atan2(*(point - pose[:3, 3])[[0, 2]]) for pose in (START, path(49))]
    assert results[49].view_angle_rad == pytest.approx(sight[0] - sight[1], abs=0.06)


def test_a_target_out_of_sight_keeps_its_bearing(seen):
    tracker, _ = seen
    for k in range(12):
        turned = path(49) @ standing(0, 0, 0.02 * k)
        result = tracker.update(frame(turned, 60 + k))
    assert result.state is TrackingState.TRACKING
    assert true_bearing_rad(turned) > 0.6  # beyond the left border
    assert result.bearing_rad == pytest.approx(true_bearing_rad(turned), abs=0.045)
    assert result.box is None or result.box.clipped(320, 240) is not None


def test_the_learned_picture_follows_the_lens_that_the_whole_map_finds(seen):
    tracker, _ = seen
    slam = tracker.slam
    slam.finish()  # no older word of the lens is on its way
    for number in (58, 59):  # the first may become a keyframe, which brings one more
        tracker.update(frame(path(49), number))
    learned = tracker._placement.features
    before, found = Lens(*slam.map.lens), Lens(1.02, 0.01)
    for world in (slam.map, slam._link.mapper.map):
        look_through(world, found, slam._camera)
    tracker.update(frame(path(49), 60))
    assert np.allclose(tracker._placement.features.xy_px, through(learned, before, found, slam._camera).xy_px)
    assert np.abs(tracker._placement.features.xy_px - learned.xy_px).max() > 0.5
    for world in (slam.map, slam._link.mapper.map):
        look_through(world, before, slam._camera)
    tracker.update(frame(path(49), 61))
    assert np.abs(tracker._placement.features.xy_px - learned.xy_px).max() < 0.01


def test_a_map_that_has_never_seen_the_target_leaves_it_lost():
    tracker = SlamTracker(settings=SlamSettings(features=FeatureSettings(count=600)), single_process=True)
    tracker.learn(frame(START, 1), TARGET)
    elsewhere = [standing(0.6 - 0.03 * k, 0.5, -2.4, 0.1 * np.sin(k / 5)) for k in range(30)]
    results = [tracker.update(frame(pose, k + 2)) for k, pose in enumerate(elsewhere)]
    assert tracker.slam is not None and tracker.slam.statistics().tracked > 5
    assert {result.state for result in results} == {TrackingState.LOST}
    assert all(result.reason for result in results)
    tracker.close()


def test_a_calibrated_lens_is_taken_into_account():
    """Near the rim of a lens that bends by 8 px: bearing and box are right (without the lens 0.02 rad off)."""
    distortion = (-0.25, 0.08, 0.0, 0.0)
    lens, camera = (dataclasses.replace(one, distortion=distortion) for one in (CAMERA, PINHOLE))
    bent = np.stack(np.meshgrid(np.arange(320.0), np.arange(240.0)), axis=-1).astype(np.float32)
    straight = lens.undistort(bent.reshape(-1, 2)).reshape(bent.shape)
    tracker = SlamTracker(settings=SlamSettings(features=FeatureSettings(count=600)), single_process=True)
    for k in range(-1, 6):
        pose = START if k < 0 else path(k)
        image = cv2.remap(ROOM.picture(pose), straight, None, cv2.INTER_LINEAR)
        shown = Frame(image=image, number=k + 2, time_s=(k + 2) / 30, camera=camera)
        if k < 0:
            tracker.learn(shown, Box.around(*lens.distort(np.array([[285.0, 120.0]]))[0], 70, 100))
            continue
        result = tracker.update(shown)
        x, y, z = pose[:3, :3].T @ (on_the_wall(285, 120) - pose[:3, 3])
        there = lens.distort(np.array([[CAMERA.cx + CAMERA.fx * x / z, CAMERA.cy + CAMERA.fy * y / z]]))[0]
        assert result.bearing_rad == pytest.approx(-math.atan2(x, z), abs=0.005)
        assert result.box is not None and result.box.center_px == pytest.approx(there, abs=2.0)
    tracker.close()


def test_a_frame_that_is_not_its_cameras_is_refused():
    other = PinholeCamera.with_fov(640, 480)
    with pytest.raises(ValueError, match="another size"):
        SlamTracker().learn(Frame(image=np.zeros((240, 320), np.uint8), number=1, time_s=0.0, camera=other), None)
