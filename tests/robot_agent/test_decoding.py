"""Gray pictures from files: a binary PGM without OpenCV, the same as with it; all else as OpenCV reads it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from robot_agent.cameras.decoding import read_gray, scaled

ROOT = Path(__file__).parents[2]
PICTURE = np.random.default_rng(0).integers(0, 256, (24, 32), np.uint8)


@pytest.mark.parametrize("suffix", ["pgm", "png"])
def test_what_opencv_writes_is_read_unchanged(tmp_path, suffix):
    path = tmp_path / f"picture.{suffix}"
    assert cv2.imwrite(str(path), PICTURE)
    np.testing.assert_array_equal(read_gray(path), PICTURE)


@pytest.mark.parametrize(
    "header",
    [b"P5\n32 24\n255\n", b"P5 32\n24 255 ", b"P5\n# with a comment\n32 24\n255\n"],
    ids=["lines", "mixed", "comment"],
)
def test_headers_of_a_pgm(tmp_path, header):
    path = tmp_path / "picture.pgm"
    path.write_bytes(header + PICTURE.tobytes())
    np.testing.assert_array_equal(read_gray(path), PICTURE)
    np.testing.assert_array_equal(read_gray(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))


@pytest.mark.parametrize(
    "data",
    [b"", b"P5", b"P5\n0 24\n255\n", b"P5\n9999 9999\n255\n", b"no picture at all", None],
    ids=["empty", "cut", "no-width", "too-large-and-short", "text", "missing"],
)
def test_what_is_no_picture_is_none(tmp_path, data):
    path = tmp_path / "picture.pgm"
    if data is not None:
        path.write_bytes(data)
    assert read_gray(path) is None


def test_scaling(tmp_path):
    """Itself at its own size, else each pixel the mean of what it covers."""
    assert scaled(PICTURE, (32, 24)) is PICTURE
    half = PICTURE.reshape(12, 2, 16, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(scaled(PICTURE, (16, 12)), half, atol=0.51)


def test_an_agent_with_pgm_pictures_loads_no_opencv(tmp_path):
    """On Debian OpenCV costs 100 MiB; a Pi's camera, as this recording, does without."""
    (tmp_path / "1.pgm").write_bytes(b"P5 32 24 255\n" + PICTURE.tobytes())
    code = (
        "import sys; import robot_agent.cli, robot_agent.cameras.picamera2\n"
        "from robot_agent.rig import RigOptions, build_rig\n"
        f"build_rig(RigOptions(robot='none', camera='replay', source={str(tmp_path)!r}))\n"
        "assert 'cv2' not in sys.modules"
    )
    finished = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert finished.returncode == 0, finished.stderr
