"""One go through all stages with a made-up scene, so that every compiled kernel is there before the first picture.

Loading them takes a second, compiling them the first time some ten; a tracker that waits so long in the middle of its
work has lost its track.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.chance import log10_false_alarms
from base_station.trackers.slam.features import FeatureExtractor, Features
from base_station.trackers.slam.initialization import Initializer, InitialPair
from base_station.trackers.slam.keyframe_decision import share_seen
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.mapper import Mapper, NewKeyframe, NewMap
from base_station.trackers.slam.matching import Grid
from base_station.trackers.slam.relocalization import Places
from base_station.trackers.slam.se3 import exponential, transform
from base_station.trackers.slam.settings import SlamSettings
from base_station.trackers.slam.tracking import FrameTracker, Picture
from base_station.trackers.slam.visibility import expect

POINTS = 300
STEPS = 4


CAMERA = SlamCamera(width_px=320, height_px=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5)


@cache
def rehearse_mapping() -> Mapper:
    """A mapper that has seen a few made-up keyframes; only good to be thrown away."""
    camera, settings = CAMERA, SlamSettings()
    mapper = Mapper(camera, settings)
    points, looks = _scene()
    words = np.zeros(POINTS, np.int32)
    poses = [exponential(np.array([0.1 * step, 0.0, 0.0, 0.0, 0.0, 0.0])) for step in range(STEPS)]
    views = [_view(camera, pose, points, looks) for pose in poses]
    rows = np.arange(POINTS)
    pair = InitialPair((0.0, 1.0), (views[0], views[1]), poses[1], points, rows, rows)
    mapper.begin(NewMap(pair, (0, 1), (words, words), 0))
    half = np.where(rows < POINTS // 2, rows, -1).astype(np.int32)
    none = np.empty(0, np.int64)
    for step in range(2, STEPS):
        relative = poses[step].copy()
        relative[:3, 3] *= float(mapper.map.poses[1][0, 3]) / 0.1
        new = NewKeyframe(step, float(step), views[step], half, 0, relative, 1.0, words, none, none, none)
        mapper.insert(new)
    mapper.settle(0)
    return mapper


@cache
def rehearse_tracking() -> None:
    """A made-up picture's way through the tracker."""
    camera, settings = CAMERA, SlamSettings()
    extract = FeatureExtractor(camera, settings.features)
    noise = np.random.default_rng(0).integers(0, 255, (camera.height_px, camera.width_px), np.uint8)
    features = extract(noise)
    noise.flags.writeable = False  # as pictures from a robot are: to compiled code another kind of array
    features = extract(noise)
    replace(camera, distortion=(0.1, 0.0, 0.0, 0.0)).undistort(features.xy_px)
    initializer = Initializer(camera, extract.scales, settings.initializer)
    for time_s in range(2):
        initializer(float(time_s), features, Grid.of(features.xy_px, camera.bounds_px))
    mapper = rehearse_mapping()
    world = mapper.map
    tracker = FrameTracker(camera, world, settings.tracking)
    points, looks = _scene()
    for _ in range(2):
        view = _view(camera, np.eye(4), points, looks)
        picture = Picture(0.0, view, Grid.of(view.xy_px, camera.bounds_px))
        found = tracker.locate_by(picture, 0) if tracker.last_pose is None else tracker.follow(picture)
        if not isinstance(found, str):
            tracker.remember(picture, found, moving=False)
    _rehearse_places(world, view)
    seen = world.point_of[0, :POINTS]
    share_seen(seen, seen, world.point_alive, world.observed, 1)
    expected = expect(world, seen[seen >= 0], np.eye(4), camera)
    log10_false_alarms(world, expected, view, picture.grid, seen, POINTS)


def _rehearse_places(world: Map, view: Features) -> None:
    places = Places(world)
    words = places.words(view)
    places.add(0, words)
    places.candidates(words)


def _scene() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    points = rng.uniform([-1.0, -0.8, 3.0], [1.0, 0.8, 5.0], (POINTS, 3))
    return points, rng.integers(0, 2**63, (POINTS, 4)).astype(np.uint64)


def _view(camera: SlamCamera, pose: np.ndarray, points: np.ndarray, looks: np.ndarray) -> Features:
    uv = camera.project(transform(pose, points))
    return Features(uv.astype(np.float32), np.zeros(POINTS, np.uint8), np.zeros(POINTS, np.float32), looks)
