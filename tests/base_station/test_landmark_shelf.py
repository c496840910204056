"""The file of landmarks beside a running station: remember, forget, names that follow the file."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.errors import StationError
from base_station.geometry import PinholeCamera
from base_station.landmark_shelf import LandmarkShelf
from base_station.types import Box, Frame
from tests.helpers import numbered_picture


@pytest.fixture
def frame() -> Frame:
    return Frame(image=numbered_picture(1), number=1, time_s=0.0, camera=PinholeCamera.with_fov(160, 120))


def test_what_is_remembered_is_there_until_it_is_forgotten(tmp_path, frame):
    shelf = LandmarkShelf(tmp_path / "landmarks.npz")
    shelf.refresh()
    assert shelf.names == ()
    assert not shelf.remember("door", frame, Box(40, 30, 60, 50))
    assert not shelf.remember("hall", frame, None)
    assert shelf.remember("door", frame, Box(40, 30, 60, 50)), "replaced without a word"
    assert shelf.names == ("door", "hall")
    other = LandmarkShelf(tmp_path / "landmarks.npz")
    other.refresh()
    assert other.names == ("door", "hall")
    shelf.forget("door")
    other.refresh()
    assert other.names == shelf.names == ("hall",)
    with pytest.raises(ValueError, match="no landmark 'door'"):
        shelf.forget("door")


def test_what_cannot_be_remembered_is_told(tmp_path, frame):
    shelf = LandmarkShelf(tmp_path / "landmarks.npz")
    plain = Frame(image=np.zeros((120, 160), np.uint8), number=1, time_s=0.0, camera=frame.camera)
    with pytest.raises(ValueError, match=r".+"):
        shelf.remember("wall", plain, Box(40, 30, 60, 50))
    band = Frame(image=frame.image[:20], number=1, time_s=0.0, camera=frame.camera, full_height=120)
    with pytest.raises(ValueError, match="band of rows"):
        shelf.remember("band", band, None)
    assert not (tmp_path / "landmarks.npz").exists()


def test_a_file_of_something_else_is_told_and_left_alone(tmp_path, frame):
    path = tmp_path / "landmarks.npz"
    path.write_bytes(b"my thesis")
    shelf = LandmarkShelf(path)
    shelf.refresh()
    assert shelf.names == () and "no file of landmarks" in shelf.problem
    with pytest.raises(StationError, match="no file of landmarks"):
        shelf.remember("door", frame, None)
    assert path.read_bytes() == b"my thesis"
