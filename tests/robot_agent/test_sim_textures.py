"""Textures are seeded and natural; noise has the strength that is asked for."""

import numpy as np
import pytest

from robot_agent.sim import textures
from robot_agent.sim.noise import NoiseBank


def test_pink_noise_has_a_spectrum_that_falls_as_one_over_f():
    noise = textures.pink_noise(np.random.default_rng(0), 512, 512)
    assert noise.mean() == pytest.approx(0.0, abs=1e-4) and noise.std() == pytest.approx(1.0, abs=1e-4)
    power = np.abs(np.fft.fft2(noise)) ** 2
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(512), np.fft.fftfreq(512)))
    octaves = 0.005 * 2.0 ** np.arange(6)
    density = [power[(frequency >= f) & (frequency < 2 * f)].mean() for f in octaves]
    slope = np.polyfit(np.log(octaves), np.log(density), 1)[0]
    assert -2.6 < slope < -1.6, "power falls as 1/f squared"


def test_a_texture_follows_its_seed_and_leaves_room_for_noise():
    first, again, other = (textures.texture(np.random.default_rng(seed), 256, 512, textures.WALL) for seed in (1, 1, 2))
    assert first.shape == (256, 512) and first.dtype == np.uint8
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert first.min() >= 14 and first.max() <= 241
    assert 40 < first.std() < 75


@pytest.mark.parametrize("sigma", [1.0, 2.0, 8.0])
def test_noise_has_the_asked_strength_and_no_bias(sigma):
    bank = NoiseBank(sigma=sigma, width=320, height=240, seed=3)
    noise = np.stack([bank.add_to(np.full((240, 320), 128, np.uint8)) for _ in range(8)]).astype(float) - 128.0
    assert noise.std() == pytest.approx(sigma, rel=0.02)
    assert noise.mean() == pytest.approx(0.0, abs=0.03)


def test_noise_differs_from_frame_to_frame_and_is_white():
    bank = NoiseBank(sigma=8.0, width=320, height=240, seed=3)
    gray = np.full((240, 320), 128, np.uint8)
    one, two = (bank.add_to(gray).astype(float) - 128.0 for _ in range(2))
    assert np.corrcoef(one.ravel(), two.ravel())[0, 1] == pytest.approx(0.0, abs=0.02)
    assert np.corrcoef(one[:, 1:].ravel(), one[:, :-1].ravel())[0, 1] == pytest.approx(0.0, abs=0.02)
    assert np.corrcoef(one[1:].ravel(), one[:-1].ravel())[0, 1] == pytest.approx(0.0, abs=0.02)


def test_noise_saturates_instead_of_wrapping_round():
    bank = NoiseBank(sigma=8.0, width=320, height=240, seed=3)
    assert bank.add_to(np.full((240, 320), 255, np.uint8)).min() > 200
    assert bank.add_to(np.zeros((240, 320), np.uint8)).max() < 55


def test_no_noise_leaves_the_picture_alone():
    image = np.arange(240 * 320, dtype=np.uint64).astype(np.uint8).reshape(240, 320)
    assert np.array_equal(NoiseBank(sigma=0.0, width=320, height=240, seed=0).add_to(image), image)
