"""The loose target as it was learned: doubted when something else is followed, found again elsewhere in the frame."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from base_station.trackers.ztransform.loose import LooseFollower, LooseSettings
from base_station.trackers.ztransform.pyramid import Pyramid
from base_station.trackers.ztransform.recollection import Recollection, RecollectionSettings, windows

SETTINGS = RecollectionSettings()
TARGET, OTHER = np.array([150.0, 200.0, 80.0, 100.0, 0.0]), np.array([480.0, 250.0, 80.0, 100.0, 0.0])


def texture(seed: int, sigma: float, size: tuple[int, int] = (480, 640)) -> np.ndarray:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 1, size), (0, 0), sigma)
    return np.clip(128 + 45 * noise / noise.std(), 0, 255).astype(np.uint8)


def view(*things: tuple[int, np.ndarray]) -> Pyramid:
    """Things, each a texture's seed and where it lies, in front of the same background."""
    frame = texture(1, 6.0)
    for seed, (x, y, width, height, _) in things:
        top, left = int(y - height / 2), int(x - width / 2)
        frame[top : top + int(height), left : left + int(width)] = texture(seed, 3.0, (int(height), int(width)))
    return Pyramid(frame)


def led_astray() -> tuple[LooseFollower, Recollection]:
    """A follower that learned thing 2 and, for a while, thing 3 in its place."""
    follower = LooseFollower(LooseSettings())
    follower.start(view((2, TARGET)), TARGET)
    astray = view((3, TARGET))
    for _ in range(80):
        follower.look(astray, TARGET)
        follower.adapt(astray)
    return follower, Recollection(follower, SETTINGS)


def test_what_was_kept_is_what_was_learned_at_first():
    follower, _ = led_astray()
    assert follower.recall(view((2, OTHER)), OTHER).sharpness > SETTINGS.sharpness
    changed = follower.look(view((2, TARGET)), TARGET).sharpness
    follower.restore()
    again = follower.look(view((2, TARGET)), TARGET)
    assert again.sharpness > changed + 2
    assert follower.familiarity() == pytest.approx(again.sharpness, rel=0.02)


def test_a_target_is_found_again_elsewhere_and_the_other_forgotten():
    follower, recollection = led_astray()
    frame, found = view((3, TARGET), (2, OTHER)), None
    for _ in range(200):
        placement = follower.look(frame, TARGET).placement
        found = recollection.look(frame, placement, is_seen=True)
        if found is not None:
            break
    assert found is not None
    assert found.placement[:2] == pytest.approx(OTHER[:2], abs=3)
    assert follower.look(frame, found.placement).placement[:2] == pytest.approx(OTHER[:2], abs=2)
    assert follower.familiarity() > SETTINGS.sharpness


@pytest.mark.parametrize("is_seen", [True, False])
def test_nothing_is_found_where_the_target_is_not(is_seen):
    follower, recollection = led_astray()
    frame = view((3, TARGET), (4, OTHER))
    for _ in range(200):
        placement = follower.look(frame, TARGET).placement
        assert recollection.look(frame, placement, is_seen=is_seen) is None


def test_a_familiar_target_is_not_doubted():
    """Not even where its equal stands: no window is looked at."""
    follower, frame = LooseFollower(LooseSettings()), view((2, TARGET), (2, OTHER))
    follower.start(frame, TARGET)
    recollection = Recollection(follower, SETTINGS)
    for _ in range(150):
        placement = follower.look(frame, TARGET).placement
        assert recollection.look(frame, placement, is_seen=True) is None
        follower.adapt(frame)


@pytest.mark.parametrize(("zoom", "sizes"), [(1.05, 1), (1.5, 2)])
def test_the_windows_cover_the_frame_nearest_last(zoom, sizes):
    last = TARGET * [1, 1, zoom, zoom, 1]
    placements = np.array(windows(last, TARGET, (480, 640), SETTINGS))
    away = np.hypot(*(placements[:, :2] - last[:2]).T)
    assert np.all(np.diff(away) <= 0)
    assert len(np.unique(placements[:, 2])) == sizes
    half = SETTINGS.step / 2 * np.sqrt(TARGET[2] * TARGET[3]) * zoom
    for x, y in np.random.default_rng(0).uniform((0, 0), (640, 480), (50, 2)):
        reach = np.abs(placements[:, :2] - (x, y))
        assert np.any(np.all(reach <= half + 1e-9, axis=1))
