"""Views of a world show it exactly where they say: against formulas, against plain numpy, and by Fourier upsampling."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from base_station.errors import StationError
from base_station.evaluation.conditions import CAMERA
from base_station.evaluation.worlds import (
    COLUMNS,
    PIXEL_SIGMA,
    ROWS,
    SAMPLES_PER_PX,
    VIEW_COLUMNS,
    VIEW_ROWS,
    World,
    generated_world,
    photographed_worlds,
)

ACROSS, DOWN = 0.11, 0.07
"""Of the wave, radians per sample."""


def wave_at(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.sin(ACROSS * x) * np.cos(DOWN * y)


@pytest.fixture(scope="module")
def wave() -> World:
    y, x = np.mgrid[0:ROWS, 0:COLUMNS].astype(float)
    return World("wave", (128 + 100 * wave_at(x, y)).astype(np.float32), (1101.3, 812.6))


@pytest.fixture(scope="module")
def leaves() -> World:
    return generated_world(0)


@pytest.mark.parametrize(("dx", "dy", "zoom"), [(0, 0, 1), (13.37, 0, 1), (-49.9, 5.8, 1), (3, -2, 0.7), (-8, 1, 1.4)])
def test_a_view_is_the_wave_displaced_and_enlarged_and_seen_by_a_gaussian_pixel(wave, dx, dy, zoom):
    pitch = SAMPLES_PER_PX / zoom
    y, x = np.mgrid[0:VIEW_ROWS, 0:VIEW_COLUMNS].astype(float)
    at_x = wave.origin[0] + (x - (VIEW_COLUMNS - 1) / 2 - dx) * pitch
    at_y = wave.origin[1] + (y - (VIEW_ROWS - 1) / 2 - dy) * pitch
    softness = math.exp(-((PIXEL_SIGMA * pitch) ** 2) * (ACROSS**2 + DOWN**2) / 2)
    assert np.abs(wave.view(dx, dy, zoom) - (128 + 100 * softness * wave_at(at_x, at_y))).max() < 0.02


def test_a_turn_follows_the_rays(wave):
    shift_px, zoom = 41.7, 1.1
    view = wave.turned_view(shift_px, 3.0, zoom, CAMERA)
    turn = math.atan2(shift_px, CAMERA.fx)
    for x, y in ((30, 40), (320, 240), (600, 430), (111, 300)):
        right, down = (x - 319.5) / CAMERA.fx, (y - 239.5 - 3.0) / CAMERA.fx
        azimuth = math.atan(right) - turn
        depth = math.hypot(1, right) * math.cos(azimuth)  # of the ray's end, before the camera turned
        scale = SAMPLES_PER_PX * CAMERA.fx / zoom
        there = wave_at(wave.origin[0] + scale * math.tan(azimuth), wave.origin[1] + scale * down / depth)
        softness = math.exp(-((PIXEL_SIGMA * SAMPLES_PER_PX / zoom) ** 2) * (ACROSS**2 + DOWN**2) / 2)
        assert view[y, x] == pytest.approx(128 + 100 * softness * there, abs=2.0)


def displacement_px(one: np.ndarray, other: np.ndarray, around: int) -> float:
    """How far `other` is to the right of `one`: the peak of their cross-correlation, its Fourier series evaluated on a
    grid of 1/500 px (Guizar-Sicairos, Thurman and Fienup, Optics Letters 2008) about a whole number of pixels."""
    rows, columns = slice(100, 380), slice(150, 490)
    moved = slice(columns.start + around, columns.stop + around)
    window = np.outer(np.hanning(280), np.hanning(340))
    a, b = (np.fft.fft2((view - view.mean()) * window) for view in (one[rows, columns], other[rows, moved]))
    cross = (a.conj() * b).sum(0)  # rows do not move
    shifts = np.arange(-0.8, 0.8, 0.002)
    height = np.real(np.exp(2j * np.pi * np.outer(shifts, np.fft.fftfreq(340))) @ cross)
    return around + float(shifts[np.argmax(height)])


@pytest.mark.parametrize("dx", [0.0, 0.25, -0.5, 17.3, -49.6])
def test_fourier_upsampling_finds_the_shift(leaves, dx):
    assert displacement_px(leaves.view(), leaves.view(dx), round(dx)) == pytest.approx(dx, abs=0.01)


def test_beyond_the_border_the_world_is_mirrored():
    y, x = np.mgrid[0:ROWS, 0:COLUMNS]
    steps = World("steps", ((x // 7 + y // 5) % 251).astype(np.uint8))
    reach = 500
    padded = np.pad(steps.picture, reach, mode="reflect")
    inside = World("inside", padded, (steps.origin[0] + reach, steps.origin[1] + reach))
    assert np.abs(steps.view(40, -6, 0.45) - inside.view(40, -6, 0.45)).max() < 1e-3


def test_a_seed_is_a_world(leaves):
    again = generated_world(0)
    assert (again.picture == leaves.picture).all()
    assert again.origin == leaves.origin
    assert (generated_world(1).picture != leaves.picture).mean() > 0.9


def test_generated_worlds_are_like_photographs(leaves):
    """Contrast of neighbours grows slowly with their distance, most of a picture is smooth, and edges are steep."""
    view = leaves.view()
    steps = [np.abs(view[:, d:] - view[:, :-d]).mean() for d in (1, 4, 16)]
    assert 1.2 < steps[1] / steps[0] < 4
    assert 1.1 < steps[2] / steps[1] < 3
    fine = view[:, 1:] - view[:, :-1]
    assert ((fine - fine.mean()) ** 4).mean() / fine.var() ** 2 > 8  # kurtosis; of noise it is 3
    assert 25 < view.std() < 80


@pytest.mark.parametrize(("width", "height"), [(100, 70), (300, 900), (4000, 1700)])
def test_photographs_of_any_size_cover_a_world(tmp_path, width, height):
    picture = np.random.default_rng(0).integers(0, 255, (height // 8 + 1, width // 8 + 1), np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), cv2.resize(picture, (width, height), interpolation=cv2.INTER_CUBIC))
    (tmp_path / "notes.txt").write_text("no picture")
    (world,) = photographed_worlds(tmp_path, 0)
    assert world.picture.shape == (ROWS, COLUMNS)
    assert world.name == "a.png"
    assert world.view().std() > 10


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({}, "has no picture"),
        ({"a.txt": b"x"}, "has no picture"),
        ({"a.jpg": b"no jpeg"}, "a.jpg cannot be read as a picture"),
        ({"a.png": b""}, "a.png cannot be read as a picture"),
        ({"a.png": cv2.imencode(".png", np.zeros((20, 900), np.uint8))[1].tobytes()}, "too small: 900x20"),
    ],
)
def test_a_folder_that_gives_no_worlds_says_so(tmp_path, files, said):
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    with pytest.raises(StationError, match=said) as caught:
        photographed_worlds(tmp_path, 0)
    assert caught.value.usage


def test_a_folder_that_is_none_says_so(tmp_path):
    with pytest.raises(StationError, match="no folder"):
        photographed_worlds(tmp_path / "nowhere", 0)
