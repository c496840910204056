"""A recording is a camera: every picture once and in order, at its own rate, at another, or as fast as asked."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from robot_agent.cameras.base import CameraFrame
from robot_agent.cameras.replay import ReplayCamera
from robot_agent.errors import CameraError, EndOfRecording

WIDTH, HEIGHT = 32, 24


def picture(level: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """Told from the others by its gray level; brighter on the left."""
    image = np.full((height, width), level, np.uint8)
    image[:, : width // 2] += 5
    return image


def folder(path: Path, levels: tuple[int, ...] = (10, 20, 30)) -> str:
    path.mkdir(exist_ok=True)
    for number, level in enumerate(levels):
        cv2.imwrite(str(path / f"{number:04}.png"), picture(level))
    return str(path)


def tum(path: Path, times_s: tuple[float, ...]) -> str:
    folder(path, tuple(10 * (number + 1) for number in range(len(times_s))))
    (path / "rgb.txt").write_text("".join(f"{time_s} {number:04}.png\n" for number, time_s in enumerate(times_s)))
    return str(path)


def all_frames(camera: ReplayCamera) -> list[CameraFrame]:
    frames = []
    while True:
        try:
            frame = camera.read(0.5)
        except EndOfRecording:
            return frames
        assert frame is not None
        frames.append(frame)


class Clock:
    """A clock that stands unless told."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def test_every_picture_comes_once_in_order_unchanged_and_then_the_recording_ends(tmp_path):
    camera = ReplayCamera(folder(tmp_path), realtime=False)
    camera.begin()
    frames = all_frames(camera)
    assert [int(frame.image[0, -1]) for frame in frames] == [10, 20, 30]
    assert np.array_equal(frames[1].image, picture(20))
    assert (camera.width, camera.height, camera.fps) == (WIDTH, HEIGHT, pytest.approx(30))
    with pytest.raises(EndOfRecording):
        camera.read(0.0)


def test_nothing_comes_before_the_station_does(tmp_path):
    camera = ReplayCamera(folder(tmp_path), realtime=False)
    assert camera.read(0.01) is None
    camera.begin()
    assert camera.read(0.01) is not None


def test_as_fast_as_asked_it_never_waits(tmp_path):
    camera = ReplayCamera(tum(tmp_path, (0.0, 50.0, 100.0)), realtime=False)
    camera.begin()
    begun_s = time.monotonic()
    assert [frame.capture_s for frame in all_frames(camera)] == [0.0, 50.0, 100.0]
    assert time.monotonic() - begun_s < 1.0


def test_recorded_times_are_kept_and_told_since_the_first_picture(tmp_path):
    camera = ReplayCamera(tum(tmp_path, (1305031102.25, 1305031102.35, 1305031102.75)), realtime=False)
    camera.begin()
    assert [frame.capture_s for frame in all_frames(camera)] == pytest.approx([0.0, 0.1, 0.5], abs=1e-6)
    assert camera.fps == pytest.approx(10.0, abs=1e-3)


def test_a_rate_of_ones_own_replaces_the_recorded_times(tmp_path):
    camera = ReplayCamera(tum(tmp_path, (5.0, 6.0, 60.0)), fps=50.0, realtime=False)
    camera.begin()
    assert [frame.capture_s for frame in all_frames(camera)] == pytest.approx([0.0, 0.02, 0.04])
    assert camera.fps == pytest.approx(50.0)


def test_a_picture_is_held_back_until_its_time_has_come_on_the_clock(tmp_path):
    clock = Clock()
    camera = ReplayCamera(tum(tmp_path, (0.0, 10.0)), clock=clock)
    camera.begin()
    clock.now_s += 0.001
    assert camera.read(0.01) is not None
    clock.now_s += 9.9
    assert camera.read(0.01) is None
    clock.now_s += 0.1
    frame = camera.read(0.01)
    assert frame is not None
    assert frame.capture_s == 10.0


def test_the_recording_s_time_begins_with_the_first_station_not_with_a_later_one(tmp_path):
    clock = Clock()
    camera = ReplayCamera(tum(tmp_path, (0.0, 10.0)), clock=clock)
    clock.now_s += 500
    camera.begin()
    assert camera.read(0.01) is not None
    clock.now_s += 10.001
    camera.begin()
    assert camera.read(0.01) is not None


def test_in_real_time_five_pictures_at_100_per_second_take_40_ms(tmp_path):
    camera = ReplayCamera(folder(tmp_path, (1, 2, 3, 4, 5)), fps=100.0)
    begun_s = time.monotonic()
    camera.begin()
    assert len(all_frames(camera)) == 5
    assert 0.039 <= time.monotonic() - begun_s < 0.3  # not faster; on a busy machine perhaps slower


def test_size_scales_every_picture(tmp_path):
    camera = ReplayCamera(folder(tmp_path), size=(16, 12), realtime=False)
    camera.begin()
    frame = camera.read(0.1)
    assert frame is not None
    assert frame.image.shape == (camera.height, camera.width) == (12, 16)
    assert frame.image.dtype == np.uint8
    assert (frame.image[0, 0], frame.image[0, -1]) == (15, 10)


def test_a_picture_of_another_size_is_an_error_that_names_it_unless_one_size_is_asked_for(tmp_path):
    source = folder(tmp_path)
    cv2.imwrite(str(tmp_path / "0002.png"), picture(30, width=40))
    camera = ReplayCamera(source, realtime=False)
    camera.begin()
    with pytest.raises(CameraError, match=r"Picture 3 .* is 40x24, the first was 32x24: .*--size"):
        all_frames(camera)
    scaled = ReplayCamera(source, size=(WIDTH, HEIGHT), realtime=False)
    scaled.begin()
    assert len(all_frames(scaled)) == 3


def test_colour_becomes_gray(tmp_path):
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[:, :, 1] = 200
    cv2.imwrite(str(tmp_path / "a.png"), image)
    camera = ReplayCamera(str(tmp_path), realtime=False)
    camera.begin()
    (frame,) = all_frames(camera)
    assert frame.image.shape == (HEIGHT, WIDTH)
    assert int(frame.image[0, 0]) == pytest.approx(0.587 * 200, abs=1)


def test_a_missing_source_says_how_to_name_one(tmp_path):
    with pytest.raises(CameraError, match=r"no recording .*nowhere.* --source"):
        ReplayCamera(str(tmp_path / "nowhere"))


def test_a_listed_picture_that_is_missing_or_broken_is_named(tmp_path):
    source = tum(tmp_path, (0.0, 1.0, 2.0))
    (tmp_path / "0000.png").write_bytes(b"no picture")
    with pytest.raises(CameraError, match=r"0000\.png is missing or no picture"):
        ReplayCamera(source)


def test_a_file_that_is_no_video_is_refused(tmp_path):
    (tmp_path / "film.avi").write_bytes(b"no film")
    with pytest.raises(CameraError, match="no video that OpenCV can read"):
        ReplayCamera(str(tmp_path / "film.avi"))


def test_a_video_plays_at_its_own_rate(tmp_path):
    path = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for level in (40, 120, 200):
        writer.write(cv2.cvtColor(picture(level), cv2.COLOR_GRAY2BGR))
    writer.release()
    camera = ReplayCamera(path, realtime=False)
    camera.begin()
    frames = all_frames(camera)
    assert [frame.capture_s for frame in frames] == pytest.approx([0.0, 0.05, 0.1])
    assert [float(frame.image.mean()) for frame in frames] == pytest.approx([42.5, 122.5, 202.5], abs=3)
    assert camera.fps == pytest.approx(20.0)


def test_closing_wakes_a_reader_that_waits_for_the_next_picture(tmp_path):
    camera = ReplayCamera(tum(tmp_path, (0.0, 30.0)))
    camera.begin()
    assert camera.read(0.5) is not None
    camera.close()
    begun_s = time.monotonic()
    assert camera.read(5.0) is None
    assert time.monotonic() - begun_s < 1.0
