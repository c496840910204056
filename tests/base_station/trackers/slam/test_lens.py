"""A lens that is not as its calibration says: its geometry is exact, and a map that can tell finds it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from base_station.trackers.slam import lens_calibration, whole_bundle
from base_station.trackers.slam.bundle_kernels import adjust_with_cost
from base_station.trackers.slam.bundle_problem import BundleProblem
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import FeatureSettings
from base_station.trackers.slam.lens import Lens, look_through, through
from base_station.trackers.slam.lens_calibration import calibrated
from base_station.trackers.slam.local_bundle import BundleSettings
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.se3 import exponential
from base_station.trackers.slam.sim3 import align, transform
from base_station.trackers.slam.system import SlamSettings, SlamSystem
from base_station.types import TrackingState
from tests.base_station.trackers.slam.room import Room, small_camera, standing
from tests.base_station.trackers.slam.scene import SCALES, box_of_points, features_of, project, random_looks

CAMERA = SlamCamera(width_px=640, height_px=480, fx=500.0, fy=500.0, cx=319.5, cy=239.5)
LENS = Lens(zoom=1.02, radial=-0.03)
POINTS, KEYFRAMES = 150, 10


def picture_points() -> np.ndarray:
    return np.random.default_rng(3).uniform((0.0, 0.0), (640.0, 480.0), (300, 2))


def test_there_and_back():
    points = picture_points()
    assert np.allclose(LENS.seen(LENS.ideal(points, CAMERA), CAMERA), points, atol=1e-6)
    assert np.abs(LENS.ideal(points, CAMERA) - points).max() > 3.0
    assert np.allclose(Lens().ideal(points, CAMERA), points, atol=1e-9)


@pytest.mark.parametrize(("distortion", "close_px"), [((), 1e-3), ((-0.06, 0.03, 0.0004, -0.0003), 0.05)])
def test_it_is_the_lens_of_the_camera_that_it_makes(distortion, close_px):
    """A ray is the same through the corrected camera as through the first one and the lens."""
    first = replace(CAMERA, distortion=distortion)
    made = LENS.of(first)
    points = picture_points().astype(np.float32)
    of_made = (made.undistort(points) - made.intrinsics[2:]) / made.intrinsics[:2]
    by_lens = (LENS.ideal(first.undistort(points), first) - first.intrinsics[2:]) / first.intrinsics[:2]
    assert np.abs(of_made - by_lens).max() * first.fx < close_px
    assert Lens().of(first) == first


def test_px_per_ideal_px():
    """The square root of by how much a small patch grows."""
    points, step = picture_points(), 1e-3
    across, down = (
        (LENS.seen(points + off, CAMERA) - LENS.seen(points - off, CAMERA)) / (2.0 * step)
        for off in (np.array([step, 0.0]), np.array([0.0, step]))
    )
    area = across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]
    assert np.allclose(LENS.px_per_ideal_px(points, CAMERA), np.sqrt(area), rtol=1e-5)


def test_a_magnification_weighs_as_the_scale_does():
    """An observation that counts k times as many px costs what one of a k times smaller deviation does."""
    rng = np.random.default_rng(4)
    world = seen_map(rng, Lens(), straight=False)
    rows, seers, features = world.observations(np.arange(KEYFRAMES))
    uv, octave, _ = world.keypoints(seers, features)
    fixed = np.arange(KEYFRAMES) == 0
    problem = BundleProblem(world.poses[:KEYFRAMES], fixed, world.xyz[:POINTS], seers, rows, uv, octave)
    twice = np.full(len(uv), 2.0)
    one = adjust_with_cost(problem, CAMERA.intrinsics, SCALES, iterations=10, enough=1e-6, magnification=twice)
    other = adjust_with_cost(problem, CAMERA.intrinsics, SCALES / 2.0, iterations=10, enough=1e-6)
    plain = adjust_with_cost(problem, CAMERA.intrinsics, SCALES, iterations=10, enough=1e-6)
    assert one[2] == pytest.approx(other[2], rel=1e-9)
    assert one[2] > 2.0 * plain[2]


def seen_map(rng: np.random.Generator, lens: Lens, *, straight: bool, noise_px: float = 0.3) -> Map:
    """Keyframes about a box of points, seen through a lens that the map does not know; all else is nearly right."""
    world = Map(POINTS, SCALES)
    xyz, looks = box_of_points(rng, POINTS), random_looks(rng, POINTS)
    for row in range(KEYFRAMES):
        a = row / KEYFRAMES * 2.0 * np.pi
        if straight:
            twist = np.array([0.0, 0.0, -0.1 * row, 0.0, 0.0, 0.0])
        else:
            twist = np.array(
                [0.9 * np.cos(a), 0.6 * np.sin(a), 0.3 * np.sin(2 * a), 0.1 * np.sin(a), 0.2 * np.cos(a), 0]
            )
        pose = exponential(twist)
        uv = lens.seen(project(pose, xyz), CAMERA) + rng.normal(0, noise_px, (POINTS, 2))
        world.add_keyframe(row, float(row), pose, features_of(uv, looks), np.empty(0, np.int32), 0)
    rows = world.add_points(xyz + rng.normal(0, 0.01, xyz.shape), looks, 0)
    world.point_of[:KEYFRAMES] = rows
    world.recount(np.arange(KEYFRAMES))
    return world


@pytest.mark.parametrize("seed", [0, 1])
def test_a_lens_that_is_not_as_calibrated_is_found(seed):
    world = seen_map(np.random.default_rng(seed), LENS, straight=False)
    unsure = replace(CAMERA, focal_sigma=0.1, radial_sigma=0.1)
    found = calibrated(world, 0, unsure)
    assert found is not None
    assert found.zoom == pytest.approx(LENS.zoom, abs=0.005)
    assert found.radial == pytest.approx(LENS.radial, abs=0.002)
    look_through(world, found, CAMERA)
    assert calibrated(world, 0, unsure) is None, "what is known is not found again"


def test_the_calibration_has_its_weight():
    """The surer it is, the nearer the lens stays to it."""
    world = seen_map(np.random.default_rng(0), LENS, straight=False)
    zooms = []
    for sigma in (0.1, 0.02, 0.01):
        found = calibrated(world, 0, replace(CAMERA, focal_sigma=sigma, radial_sigma=sigma))
        assert found is not None
        zooms.append(found.zoom)
    assert zooms[0] > zooms[1] > zooms[2] > 1.005


@pytest.mark.parametrize("seed", range(4))
def test_a_calibration_that_is_right_is_left_or_hardly_changed(seed):
    found = calibrated(seen_map(np.random.default_rng(seed), Lens(), straight=False), 0, CAMERA)
    assert found is None or (abs(found.zoom - 1.0) < 0.002 and abs(found.radial) < 0.004)


@pytest.mark.parametrize("camera", [replace(CAMERA, focal_sigma=0.0), replace(CAMERA, radial_sigma=0.0)])
def test_an_exact_calibration_is_left_alone(camera):
    assert calibrated(seen_map(np.random.default_rng(0), LENS, straight=False), 0, camera) is None


def test_what_a_straight_way_says_weighs_little():
    """Straight ahead focal length and depth are exchanged: a longer lens is a deeper world."""
    found = calibrated(seen_map(np.random.default_rng(0), Lens(zoom=1.02), straight=True, noise_px=1.0), 0, CAMERA)
    assert found is None or 1.0 - 0.005 < found.zoom < 1.02 + 0.005


def test_a_lens_too_far_from_the_calibration_is_not_believed():
    world = seen_map(np.random.default_rng(0), Lens(zoom=1.08), straight=False)
    assert calibrated(world, 0, CAMERA) is None
    unsure = calibrated(world, 0, replace(CAMERA, focal_sigma=0.1, radial_sigma=0.1))
    assert unsure is not None
    assert unsure.zoom == pytest.approx(1.08, abs=0.01)


def test_too_few_keyframes_say_nothing(monkeypatch):
    monkeypatch.setattr(lens_calibration, "FEWEST", KEYFRAMES + 1)
    assert calibrated(seen_map(np.random.default_rng(0), LENS, straight=False), 0, CAMERA) is None


def test_a_large_map_is_asked_in_part(monkeypatch):
    monkeypatch.setattr(lens_calibration, "MOST", 8)
    monkeypatch.setattr(lens_calibration, "STRETCHES", 2)
    found = calibrated(seen_map(np.random.default_rng(0), LENS, straight=False), 0, CAMERA)
    assert found is not None
    assert found.zoom == pytest.approx(LENS.zoom, abs=0.009)  # drawn towards the calibration, as fewer say less


def test_the_whole_map_is_better_for_it():
    """Aligned with the truth, points are where they are; with the calibration as it was, they are not."""
    off = {}
    for name, camera in (("found", CAMERA), ("as it was", replace(CAMERA, focal_sigma=0.0))):
        rng = np.random.default_rng(5)
        truth = box_of_points(np.random.default_rng(5), POINTS)
        world = seen_map(rng, LENS, straight=False)
        assert whole_bundle.adjust_whole(world, 0, camera, BundleSettings())
        rows = world.points_alive(0)
        moved = transform(align(world.xyz[rows], truth[rows]), world.xyz[rows])
        off[name] = float(np.median(np.linalg.norm(moved - truth[rows], axis=1)))
    assert off["found"] < 0.5 * off["as it was"]


def test_all_keypoints_follow_the_lens():
    """Those of the map, whoever keeps a copy of it, and those of later pictures."""
    world = seen_map(np.random.default_rng(0), LENS, straight=False)
    copy = Map(POINTS, SCALES)
    copy.features.update(world.features)
    before = world.features[3]
    look_through(world, LENS, CAMERA)
    look_through(copy, Lens(*world.take_changes().lens), CAMERA)
    later = through(before, Lens(), LENS, CAMERA)
    assert np.array_equal(world.features[3].xy_px, copy.features[3].xy_px)
    assert np.array_equal(world.features[3].xy_px, later.xy_px)
    assert np.abs(later.xy_px - before.xy_px).max() > 1.0
    look_through(world, Lens(), CAMERA)
    assert np.abs(world.features[3].xy_px - before.xy_px).max() < 1e-3


def test_the_system_goes_on_with_another_lens(monkeypatch):
    """Begun with a focal length that is 5 % too short; a way as short as this one would not tell."""
    monkeypatch.setattr(whole_bundle, "calibrated", lambda *_: Lens(zoom=1 / 0.95))
    true = small_camera()
    wrong = replace(true, fx=0.95 * true.fx, fy=0.95 * true.fy)
    room = Room(true)
    way = [
        standing(0.6 * np.sin(k / 15), -0.8 + 0.3 * np.cos(k / 20), 0.3 * np.sin(k / 12), 0.2 * np.sin(k / 9))
        for k in range(80)
    ]
    with SlamSystem(wrong, settings=SlamSettings(features=FeatureSettings(count=600)), single_process=True) as slam:
        for k, pose in enumerate(way[:70]):
            slam.track(room.picture(pose), k / 30)
        before = slam.statistics()
        assert before.camera == wrong
        slam.finish()
        found = slam.statistics().camera
        assert found is not None
        assert found.fx == pytest.approx(true.fx)
        after = [slam.track(room.picture(pose), (70 + k) / 30) for k, pose in enumerate(way[70:])]
        assert {frame.state for frame in after} == {TrackingState.TRACKING}
        assert min(frame.matches for frame in after) > 150
        slam.finish()
        trajectory = slam.trajectory()
        places = np.array([pose[:3, 3] for _, pose in trajectory])
        truth = np.array([way[round(time_s * 30)][:3, 3] for time_s, _ in trajectory])
        assert np.linalg.norm(transform(align(places, truth), places) - truth, axis=1)[-10:].max() < 0.04
