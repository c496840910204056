"""A map in a file: what is read is what was written; whatever is no such file is one sentence."""

from __future__ import annotations

import contextlib
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from base_station.errors import StationError
from base_station.trackers.slam.camera import SlamCamera
from base_station.trackers.slam.features import Features, FeatureSettings
from base_station.trackers.slam.lens import Lens
from base_station.trackers.slam.map import Map
from base_station.trackers.slam.map_file import SHAPES, read_map, write_map
from base_station.trackers.slam.relocalization import Places
from base_station.trackers.slam.saved_map import SavedMap

CAMERA = SlamCamera(width_px=320, height_px=240, fx=260.0, fy=261.0, cx=159.5, cy=119.5, distortion=(0.1, -0.05, 0, 0))
SETTINGS = FeatureSettings(count=60)
SCALES = SETTINGS.scale_factor ** np.arange(SETTINGS.levels)
COLUMNS = ("poses", "sizes", "time_s", "component", "alive", "point_of", "octave_of", "xyz", "descriptors",
           "normals", "nearest", "farthest", "point_alive", "observed", "point_component", "born")  # fmt: skip


def some_features(rng: np.random.Generator, count: int) -> Features:
    return Features(
        rng.uniform(20, 200, (count, 2)).astype(np.float32), rng.integers(0, 8, count).astype(np.uint8),
        rng.uniform(0, 360, count).astype(np.float32), rng.integers(0, 1 << 63, (count, 4), dtype=np.uint64),
    )  # fmt: skip


def some_map() -> Map:
    """Two maps of five and three keyframes, 40 and 20 points, each point seen by some of the keyframes of its map; one
    more keyframe and two more points that are no more."""
    rng = np.random.default_rng(0)
    world = Map(SETTINGS.count, SCALES)
    nobody = np.empty(0, np.int32)
    for row in range(9):
        pose = np.eye(4)
        pose[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        pose[:3, :3] *= np.linalg.det(pose[:3, :3])
        pose[:3, 3] = rng.normal(size=3)
        world.add_keyframe(row, row / 30, pose, some_features(rng, 50 + row % 3), nobody, 0 if row < 6 else 2)
    for born, count in ((0, 42), (6, 20)):
        rows = world.add_points(
            rng.normal(size=(count, 3)), rng.integers(0, 1 << 63, (count, 4), dtype=np.uint64), born
        )
        world.normals[rows] = rng.uniform(-0.5, 0.5, (count, 3))
        world.nearest[rows], world.farthest[rows] = 1.0, rng.uniform(2, 3, count)
        for keyframe in range(born, 6 if born == 0 else 9):
            seen = rng.permutation(rows)[: count // 2 + 5]
            world.point_of[keyframe, rng.permutation(50)[: len(seen)]] = seen
    world.sizes[:9] = rng.uniform(0.9, 1.1, 9)
    world.recount(np.arange(9))
    world.remove_keyframe(2, 1)
    world.remove_points(np.array([3, 17]))
    world.recount(world.keyframes_alive())
    world.count_observed(world.points_alive())
    world.lens = (1.01, -0.02)
    return world


@pytest.fixture
def saved() -> SavedMap:
    found = SavedMap.of(some_map(), CAMERA, 3)
    assert found is not None
    return found


@pytest.fixture
def file(tmp_path, saved):
    write_map(tmp_path / "room.map", saved)
    return tmp_path / "room.map"


def test_what_is_read_is_what_was_written(file, saved):
    again = read_map(file)
    assert (again.camera, again.lens, again.source) == (CAMERA, (1.01, -0.02), str(file))
    assert set(again.columns) == set(saved.columns)
    for name, column in saved.columns.items():
        assert again.columns[name].dtype == column.dtype, name
        assert np.array_equal(again.columns[name], column), name
    assert again.told == "8 keyframes, 60 points"
    assert [path.name for path in file.parent.iterdir()] == [file.name]  # nothing half-written is left


def test_a_map_filled_from_a_file_is_the_one_that_was_saved(file):
    """But for dead rows, which are left out: with them the numbers change, and with none they do not."""
    old, new = some_map(), Map(SETTINGS.count, SCALES)
    read_map(file).ready_for(CAMERA, SETTINGS).fill(new, Places(new))
    kept = old.keyframes_alive()
    assert (new.keyframe_count, new.point_count) == (8, 60)
    assert [new.neighbours(row, 9).tolist() for row in range(8)] == [
        np.searchsorted(kept, old.neighbours(int(row), 9)).tolist() for row in kept
    ]
    assert np.array_equal(new.poses[:8], old.poses[kept]) and np.array_equal(new.sizes[:8], old.sizes[kept])
    assert np.array_equal(new.component[:8], [0] * 5 + [1] * 3)
    alive = old.points_alive()
    assert np.array_equal(new.observed[:60], old.observed[alive])
    for row, before in enumerate(kept):
        seen = old.point_of[before]
        assert np.array_equal(new.point_of[row], np.where(seen >= 0, np.searchsorted(alive, seen), -1))
        assert np.array_equal(new.features[row].descriptors, old.features[int(before)].descriptors)
        assert np.array_equal(new.octave_of[row], old.octave_of[before])
    twice = Map(SETTINGS.count, SCALES)
    again = SavedMap.of(new, CAMERA, 3)
    assert again is not None
    again.fill(twice, Places(twice))
    for name in COLUMNS:
        assert np.array_equal(getattr(new, name), getattr(twice, name)), name
    assert twice.lens == (1.01, -0.02)
    assert not len(twice.take_changes().keyframes)


def test_maps_too_small_to_keep_are_left_out():
    world = some_map()
    five = SavedMap.of(world, CAMERA, 5)
    assert five is not None and five.told == "5 keyframes, 40 points"
    assert SavedMap.of(world, CAMERA, 6) is None
    assert SavedMap.of(Map(SETTINGS.count, SCALES), CAMERA, 1) is None


def rewritten(file, **changed):
    """The same file with other arrays; None leaves one out."""
    with np.load(file, allow_pickle=False) as old:
        arrays = {name: old[name] for name in old.files}
    for name, change in changed.items():
        value = change(arrays[name].copy()) if callable(change) else change
        arrays[name] = value
    np.savez(file.open("wb"), **{name: value for name, value in arrays.items() if value is not None})
    return file


def put(index, value):
    def change(array):
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"kind": np.array("zservo landmarks")}, "nothing of a map"),
        ({"kind": None}, "nothing of a map"),
        ({"version": np.array(2)}, "of version 2"),
        ({"version": np.array(1.0)}, "does not tell its version"),
        ({"xyz": None}, "xyz"),
        ({"xyz": lambda xyz: xyz.astype(np.float32)}, "xyz is float32"),
        ({"xyz": lambda xyz: xyz[:-1]}, "xyz is|descriptors is|normals is"),
        ({"poses": lambda poses: poses[:, :3]}, "poses is"),
        ({"component": np.array([{}] * 8, object)}, "component"),
        ({"xyz": put((0, 0), np.nan)}, "xyz is not finite"),
        ({"xyz": put((0, 0), 1e30)}, "out of range"),
        ({"poses": put((0, 0, 0), 2.0)}, "only turn"),
        ({"poses": lambda poses: -poses}, "poses that are none"),
        ({"sizes": put(0, -1.0)}, "sizes out of range"),
        ({"feature_counts": put(0, 7)}, "do not add up"),
        ({"feature_counts": put(0, -7)}, "do not add up"),
        ({"octave": put(0, 8)}, "octaves out of range"),
        ({"point_of": put(0, 60)}, "point_of: indices out of range"),
        ({"point_of": put(0, -2)}, "point_of: indices out of range"),
        ({"point_of": put(slice(0, 2), 5)}, "twice"),
        ({"point_of": put(-1, 0)}, "of another map"),
        ({"point_component": put(0, 2)}, "indices out of range"),
        ({"component": put(0, 9)}, "not numbered"),
        ({"component": put(0, -1)}, "not numbered"),
        ({"camera": put(2, -5.0)}, "focal lengths must be positive"),
        ({"camera": put(0, 1e300)}, "no camera"),
        ({"lens": put(0, 0.0)}, "lens"),
        ({"scales": put(0, 0.0)}, "pyramid"),
        ({"nearest": put(0, -1.0)}, "distances out of range"),
    ],
)  # fmt: skip
def test_a_file_that_was_changed_is_one_sentence(file, changed, why):
    with pytest.raises(StationError, match=why) as caught:
        read_map(rewritten(file, **changed))
    assert caught.value.usage and "\n" not in str(caught.value)


def test_a_file_cut_short_or_with_changed_bytes_is_one_sentence(file):
    whole = file.read_bytes()
    for length in (*range(0, len(whole), len(whole) // 40), len(whole) - 1):
        file.write_bytes(whole[:length])
        with pytest.raises(StationError, match="no map of SLAM's"):
            read_map(file)
    for place in range(40, len(whole), len(whole) // 60):
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        with contextlib.suppress(StationError):  # some bytes say nothing, such as those of a date
            read_map(file)
    with pytest.raises(StationError, match="cannot be read"):
        read_map(file.parent)


@pytest.mark.parametrize("shape", ["(1000000000000, 3)", "(-1, 3)", "(8, 9)", "'x'"])
def test_a_claim_of_a_size_is_not_believed(file, shape):
    """An array of terabytes by its header, in a file of kilobytes."""
    with zipfile.ZipFile(file) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    parts["xyz.npy"] = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + bytes(60 * 24)
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    with pytest.raises(StationError, match="no map of SLAM's"):
        read_map(file)


def test_other_files_are_none(tmp_path):
    other, bomb = tmp_path / "other.npz", tmp_path / "bomb.npz"
    np.savez(other, picture=np.zeros((3, 3)))
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in SHAPES:
            archive.writestr(f"{name}.npy", bytes(30 << 20))
    for path, why in ((other, "nothing of a map"), (bomb, "more than 512 MiB"), (tmp_path / "none", "cannot be read")):
        with pytest.raises(StationError, match=why):
            read_map(path)


def test_a_folder_that_takes_no_file_is_said(tmp_path, saved):
    with pytest.raises(StationError, match="cannot be written"):
        write_map(tmp_path / "nowhere" / "room.map", saved)


def test_the_camera_must_be_the_same_one(file):
    saved = read_map(file)
    assert saved.ready_for(CAMERA, SETTINGS) is saved
    smaller = replace(CAMERA, width_px=160, height_px=120, cx=79.5, cy=59.5)
    for camera, why in (
        (smaller, "320x240 px, and the camera's have 160x120"),
        (replace(CAMERA, fx=290.0, fy=290.0), "focal length 260 px, now 290"),
        (replace(CAMERA, distortion=(-0.2, 0.0, 0.0, 0.0)), "differ by up to"),
    ):
        with pytest.raises(StationError, match=why) as caught:
            saved.ready_for(camera, SETTINGS)
        assert str(file) in str(caught.value)
    for settings in (FeatureSettings(count=40), FeatureSettings(count=60, levels=6)):
        with pytest.raises(StationError, match="other features"):
            saved.ready_for(CAMERA, settings)


def test_a_camera_calibrated_anew_sees_the_same_pictures(file):
    """Keypoints stay where the pictures showed them."""
    saved = read_map(file)
    camera = replace(CAMERA, fx=262.0, fy=262.5, distortion=(0.11, -0.05, 0.0, 0.0))
    moved = saved.ready_for(camera, SETTINGS)
    before = CAMERA.distort(Lens(*saved.lens).seen(saved.columns["xy_px"].astype(np.float64), CAMERA))
    after = camera.distort(moved.columns["xy_px"])
    assert moved.lens == (1.0, 0.0) and moved.camera == camera
    assert np.abs(moved.columns["xy_px"] - saved.columns["xy_px"]).max() > 0.3
    assert np.abs(before - after).max() < 1e-3
