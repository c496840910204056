"""How exact the Z-transform tracker is on synthetic truth, and that it knows when it does not know."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform.tracker import ZTransformTracker
from base_station.types import Box, Frame, TrackingState

TARGET = Box.around(319.5, 239.5, 200, 180)
LIGHTS = {
    "plain": {},
    "noise": {"noise": 10},
    "dark": {"gain": 1 / 3, "noise": 8},
    "gain and offset": {"gain": 0.6, "offset": 40},
}


def learned(world, target=TARGET, **light):
    tracker = ZTransformTracker()
    tracker.learn(world.frame(world.view(**light)), target)
    return tracker


def follow(world, tracker, poses, **light):
    """Results for views at (dx, dy, zoom), one after the other."""
    return [tracker.update(world.frame(world.view(*pose, **light), n)) for n, pose in enumerate(poses, 2)]


@pytest.mark.parametrize(
    ("light", "px", "percent"),
    [("plain", 0.06, 0.06), ("noise", 0.2, 0.3), ("dark", 0.3, 0.5), ("gain and offset", 0.08, 0.08)],
)
def test_shift_and_zoom_are_exact(make_world, light, px, percent):
    shift_errors, zoom_errors = [], []
    for seed in range(2):
        world = make_world(seed)
        poses = [(2.3 * i, 0.9 * i, 1.02**i) for i in range(12)]
        for (dx, dy, zoom), result in zip(poses, follow(world, learned(world), poses, **LIGHTS[light]), strict=True):
            assert result.state is TrackingState.TRACKING, result.reason
            shift_errors += [result.shift_px - dx, result.shift_y_px - dy]
            zoom_errors.append(100 * (result.zoom / zoom - 1))
    assert np.median(np.abs(shift_errors)) < px
    assert np.median(np.abs(zoom_errors)) < percent
    assert np.abs(shift_errors).max() < 12 * px
    assert abs(np.mean(shift_errors)) < px


def test_zoom_comes_from_the_height(world):
    """A picture that turns away gets narrower, not farther."""
    tracker = learned(world)
    for number, aspect in enumerate((0.98, 0.95, 0.92, 0.88, 0.84), 2):
        result = tracker.update(world.frame(world.view(aspect=aspect), number))
        assert result.zoom == pytest.approx(1, abs=0.004)
    assert result.box.width == pytest.approx(200 * 0.84, rel=0.01)
    assert result.box.height == pytest.approx(180, rel=0.005)


@pytest.mark.parametrize("step_px", [17, -30, 55])
def test_a_sudden_turn_is_followed_in_the_same_frame(make_world, step_px):
    for seed in range(4):
        world = make_world(seed)
        result = follow(world, learned(world), [(0, 0, 1), (step_px, 0, 1)], noise=3)[-1]
        assert result.shift_px == pytest.approx(step_px, abs=0.4)


@pytest.mark.parametrize("zoom", [0.45, 0.6, 0.8, 1.25, 1.6, 2.2])
def test_acquisition_needs_no_prediction(make_world, zoom):
    for seed in range(2):
        world = make_world(seed)
        tracker = learned(world)
        blank = world.frame(np.full((480, 640), 128, np.uint8), 2)
        assert tracker.update(blank).state is TrackingState.LOST
        dx = (-1) ** seed * 110
        results = [tracker.update(world.frame(world.view(dx, 0, zoom, gain=0.5, noise=3), 3 + n)) for n in range(2)]
        assert results[-1].state is TrackingState.TRACKING, results[-1].reason
        assert results[-1].shift_px == pytest.approx(dx, abs=0.5)
        assert results[-1].zoom == pytest.approx(zoom, rel=0.01)


@pytest.mark.parametrize(
    ("velocity", "side"), [((-20, 0), "left"), ((20, 0), "right"), ((0, -20), "top"), ((0, 20), "bottom")]
)
def test_says_at_which_side_it_left(make_world, velocity, side):
    world = make_world(3)
    cut = np.zeros((480, 640), bool)
    cut[150:330, 220:420] = True
    target = np.where(cut, world.view(), 0)
    tracker, backdrop = learned(world), make_world(9)
    reasons = []
    for n in range(1, 30):
        moved = np.roll(np.pad(target, 700), (n * velocity[1], n * velocity[0]), (0, 1))[700:1180, 700:1340]
        shown = np.roll(np.pad(cut, 700), (n * velocity[1], n * velocity[0]), (0, 1))[700:1180, 700:1340]
        result = tracker.update(world.frame(np.where(shown, moved, backdrop.view()).astype(np.uint8), n + 1))
        if result.state is TrackingState.LOST:
            reasons.append(result.reason)
        elif shown.sum() > 0.8 * cut.sum():
            assert result.shift_px == pytest.approx(n * velocity[0], abs=1.5)
            assert result.shift_y_px == pytest.approx(n * velocity[1], abs=1.5)
    assert reasons
    assert f"left the frame at the {side}" in reasons[-1]


def test_hidden_is_not_featureless(make_world):
    world, other = make_world(0), make_world(20)
    tracker = learned(world)
    assert "hidden or gone" in tracker.update(world.frame(other.view(noise=2), 2)).reason
    gradient = np.repeat(np.linspace(40, 160, 640)[None], 480, 0)
    noisy = np.clip(gradient + np.random.default_rng(0).normal(0, 8, gradient.shape), 0, 255).astype(np.uint8)
    assert "featureless" in tracker.update(world.frame(noisy, 3)).reason


def test_is_not_found_where_it_is_not(make_world):
    """Views of other worlds, right after tracking and while lost: under 1 % may be believed."""
    believed = count = 0
    for seed in range(4):
        world, other = make_world(seed), make_world(100 + seed)
        tracker = learned(world, Box.around(319.5, 239.5, (200, 90, 40, 300)[seed], 120))
        rng = np.random.default_rng(seed)
        for n in range(30):
            view = other.view(*rng.uniform(-120, 120, 2), rng.uniform(0.6, 1.5), noise=4)
            believed += tracker.update(world.frame(view, 2 + n)).state is TrackingState.TRACKING
            count += 1
    assert believed <= 0.01 * count


@pytest.mark.parametrize(("columns", "rows"), [(640, 480), (320, 240), (640, 64)])
def test_a_place_tells_how_far_the_robot_turned(make_world, columns, rows):
    """A turn on the spot of up to 25 degrees each way; parts of the place leave the view."""
    world = make_world(1, 640, 480)
    tracker, errors = ZTransformTracker(), []
    camera = type(world.camera).with_fov(columns, rows)
    frame = type(world.frame(world.view()))
    turns = np.deg2rad(25 * np.sin(np.arange(0, 60) / 60 * 2 * np.pi))
    tracker.learn(frame(image=_turned(world, camera, 0.0), number=1, time_s=0, camera=camera), None)
    for n, turn in enumerate(turns, 1):
        image = _turned(world, camera, turn)
        result = tracker.update(frame(image=image, number=n + 1, time_s=n / 30, camera=camera))
        assert result.state is TrackingState.TRACKING, (n, np.rad2deg(turn), result.reason)
        errors.append(np.rad2deg(result.bearing_rad + turn))
    assert np.sqrt(np.mean(np.square(errors))) < 0.25
    assert np.abs(errors).max() < 1


def _turned(world, camera, turn_rad):
    """What a camera sees that was turned to the left, of a panorama: the world's picture rolled into a cylinder."""
    import cv2

    x, y = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    azimuth = np.arctan2(x - camera.cx, camera.fx) - turn_rad
    upwards = (y - camera.cy) / camera.fx * np.cos(azimuth + turn_rad)
    focal = world.camera.fx
    columns, rows = (639.5 + focal * azimuth).astype(np.float32), (479.5 + focal * upwards).astype(np.float32)
    flat = cv2.remap(world._picture.astype(np.float32), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    noisy = flat + np.random.default_rng(int(1e4 * (turn_rad + 4))).normal(0, 2, flat.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def test_is_found_in_another_row_while_lost(make_world):
    """Where the horizon rule does not hold, as on a ramp: within a few frames."""
    world = make_world(2)
    tracker = learned(world, Box.around(319.5, 239.5, 160, 140))
    tracker.update(world.frame(np.full((480, 640), 128, np.uint8), 2))
    results = [tracker.update(world.frame(world.view(60, 75, 0.9, noise=3), 3 + n)) for n in range(8)]
    assert results[-1].state is TrackingState.TRACKING
    assert results[-1].shift_y_px == pytest.approx(75, abs=0.5)


@pytest.mark.parametrize("sigma", [1, 2, 5, 10])
@pytest.mark.parametrize("target", [Box.around(319.5, 239.5, 240, 180), Box.around(200, 300, 60, 40), None])
def test_a_plain_wall_is_not_learned_for_its_noise(sigma, target):
    """It would be followed to anywhere: the patch has the noise's texture."""
    wall = np.linspace(110, 130, 640)[None] + np.random.default_rng(sigma).normal(0, sigma, (480, 640))
    frame = Frame(
        image=np.clip(wall, 0, 255).astype(np.uint8), number=1, time_s=0.0, camera=PinholeCamera.with_fov(640, 480)
    )
    with pytest.raises(ValueError, match="featureless"):
        ZTransformTracker().learn(frame, target)
