"""Loose targets: the channels mean what the reference says, the filters find shifts and sizes, nothing is made up."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from base_station.geometry import PinholeCamera
from base_station.trackers.registry import make_tracker
from base_station.trackers.ztransform import reference
from base_station.trackers.ztransform.channels import ChannelReader, ChannelSettings
from base_station.trackers.ztransform.loose import LooseFollower, LooseSettings, sample_polar
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.types import Box, Frame, TrackingState

SMALLEST_SHARPNESS = LooseSettings().least_sharpness


def picture(seed: int, sigma: float = 3.0) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, (480, 640)), (0, 0), sigma)
    return np.clip(128 + 45 * noise / noise.std(), 0, 255).astype(np.uint8)


def moved(image: np.ndarray, dx: float, dy: float, zoom: float = 1.0) -> np.ndarray:
    shift = np.float64([[zoom, 0, (1 - zoom) * 320 + dx], [0, zoom, (1 - zoom) * 240 + dy]])
    return cv2.warpAffine(image, shift, (640, 480), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


@pytest.mark.parametrize("cells", [17, 44])
def test_the_channels_are_those_of_the_reference(cells):
    patch = np.random.default_rng(1).uniform(0, 255, (cells, cells)).astype(np.float32)
    settings = ChannelSettings()
    rates = np.array(settings.rates)
    poles, across = np.exp(-rates * (1 + 1j * settings.slope)), np.exp(-settings.across * rates)
    expected = reference.phase_channels(patch, poles, across, settings.floor)
    read = ChannelReader(settings).read(patch, np.zeros(4, np.float32), 1.0)[:-1]
    assert read[..., 0] + 1j * read[..., 1] == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize(("dx", "dy"), [(0, 0), (9, -6), (-31, 17)])
def test_a_shift_is_found_to_a_fraction_of_a_cell(dx, dy):
    image, placement = picture(2), np.array([320.0, 240.0, 90.0, 70.0, 0.0])
    follower = LooseFollower(LooseSettings())
    follower.start(Pyramid(image), placement)
    sighting = follower.look(Pyramid(moved(image, dx, dy)), placement)
    assert sighting.sharpness > SMALLEST_SHARPNESS
    assert sighting.placement[:2] == pytest.approx([320 + dx, 240 + dy], abs=1.5)


@pytest.mark.parametrize("zoom", [0.8, 1.25])
def test_the_size_follows_a_slow_zoom(zoom):
    image, placement = picture(3), np.array([320.0, 240.0, 90.0, 70.0, 0.0])
    follower = LooseFollower(LooseSettings())
    follower.start(Pyramid(image), placement)
    for n in range(1, 61):
        pyramid = Pyramid(moved(image, 0, 0, zoom ** (min(n, 40) / 40)))
        assert follower.look(pyramid, placement).sharpness > SMALLEST_SHARPNESS
        placement = follower.adapt(pyramid)
    assert placement[2] / 90 == pytest.approx(zoom, rel=0.05)
    assert placement[3] / placement[2] == pytest.approx(70 / 90, rel=1e-6)


@pytest.mark.parametrize("speed_deg", [-2.5, 2.0])
def test_a_target_that_turns_in_the_picture_is_turned_with(speed_deg):
    """A disc of its own texture, over other texture, by a quarter of a circle and more."""
    back, front = picture(6, 5.0), picture(7, 2.5)
    rows, columns = np.mgrid[0:480, 0:640]
    disc = np.hypot(rows - 240, columns - 320) < 50
    follower, placement = LooseFollower(LooseSettings()), np.array([320.0, 240.0, 100.0, 100.0, 0.0])
    follower.start(Pyramid(np.where(disc, front, back)), placement)
    for n in range(1, 61):
        turn = cv2.getRotationMatrix2D((320.0, 240.0), -speed_deg * n, 1.0)
        turned = cv2.warpAffine(front, turn, (640, 480), flags=cv2.INTER_CUBIC)
        pyramid = Pyramid(np.where(disc, turned, back))
        assert follower.look(pyramid, placement).sharpness > SMALLEST_SHARPNESS
        placement = follower.adapt(pyramid)
    assert placement == pytest.approx([320, 240, 100, 100, 0], abs=8)
    assert np.degrees(follower.turn_rad) == pytest.approx(60 * speed_deg, abs=12)


@pytest.mark.parametrize(("scale", "turn_rad"), [(1, 0.0), (2, 0.6), (1, -2.5)])
def test_a_polar_patch_is_read_where_the_reference_reads_it(scale, turn_rad):
    image, rng = cv2.resize(picture(8), None, fx=1 / scale, fy=1 / scale), np.random.default_rng(1)
    across, down = rng.uniform(-1.2, 1.2, (2, 16, 16)).astype(np.float32)
    placement, patch = np.array([600.0, 200.0, 120.0, 60.0, 0.0]), np.empty((16, 16), np.float32)
    sample_polar(image, scale, placement, turn_rad, across, down, patch)
    expected = reference.turned_reads(image, scale, placement, turn_rad, across, down)
    assert patch == pytest.approx(expected, abs=0.1)


def test_other_pictures_do_not_answer_sharply():
    placement, sharp = np.array([320.0, 240.0, 90.0, 70.0, 0.0]), []
    for seed in range(12):
        follower = LooseFollower(LooseSettings())
        follower.start(Pyramid(picture(10 + seed)), placement)
        sharp += [follower.look(Pyramid(picture(100 + n)), placement).sharpness for n in range(20)]
    assert np.mean(np.array(sharp) < SMALLEST_SHARPNESS) > 0.95


def test_a_target_that_bends_is_followed_where_the_signature_gives_up():
    """A patch with its own texture, over other texture, that is bent more and more until rows alone know it no more."""
    back, front, camera = picture(4, 5.0), picture(5, 2.5), PinholeCamera.with_fov(640, 480)
    rows, columns = np.mgrid[0:480, 0:640].astype(np.float32)
    tracker, errors = make_tracker("ztransform"), []
    for n in range(90):
        x, y, bend = 240 + 1.5 * n, 240 + 20 * np.sin(n / 15), 0.25 * n
        local_x, local_y = columns - np.float32(x), rows - np.float32(y)
        across = local_x + np.float32(bend) * np.sin(local_y / 12)
        bent = cv2.remap(front, across + 320, local_y + 240, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        frame = np.where((np.abs(local_x) < 45) & (np.abs(local_y) < 35), bent, back).astype(np.uint8)
        made = Frame(image=frame, number=n + 1, time_s=n / 30, camera=camera)
        if n == 0:
            tracker.learn(made, Box.around(x, y, 90, 70))
        result = tracker.update(made)
        if result.state is TrackingState.TRACKING:
            errors.append(np.hypot(*np.subtract(result.box.center_px, (x, y))))
    assert len(errors) > 80
    assert np.median(errors) < 6
    assert errors[-1] < 15
