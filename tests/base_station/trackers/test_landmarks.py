"""Landmarks: recognised in other light and zoom and not where they are not, kept in a file, followed again."""

from __future__ import annotations

import math
import zipfile

import numpy as np
import pytest

from base_station.errors import StationError
from base_station.geometry import PinholeCamera
from base_station.trackers.ztransform.landmark_file import LANDMARK_BYTES, read_landmarks, write_landmarks
from base_station.trackers.ztransform.lookup import LandmarkMemory
from base_station.trackers.ztransform.lookup_kernels import (
    best_windows,
    compare_slopes,
    gather_bands,
    power_of,
    put_together,
)
from base_station.trackers.ztransform.recall import RecallTracker
from base_station.trackers.ztransform.windows import FUNCTIONS, WINDOWS, descriptor_of, known_slopes
from base_station.types import Box, Frame, TrackingState
from tests.base_station.trackers.conftest import World

MIDDLE = (319.5, 239.5)
SPOTS = ((200, 180), (320, 300), (450, 200), (230, 320), (420, 330))


def box_at(number: int) -> Box:
    """Where landmark `number` of a world is learned."""
    x, y = SPOTS[number]
    return Box.around(x, y, 90 + 15 * number, 120 - 10 * number)


def seen_at(box: Box, dx: float, zoom: float) -> tuple[float, float]:
    x, y = box.center_px
    return MIDDLE[0] + zoom * (x - MIDDLE[0]) + dx, MIDDLE[1] + zoom * (y - MIDDLE[1])


@pytest.fixture(scope="module")
def worlds() -> list[World]:
    return [World(seed) for seed in range(100)]


@pytest.fixture(scope="module")
def memory(worlds: list[World]) -> LandmarkMemory:
    """500 landmarks: five of each world."""
    memory = LandmarkMemory()
    for n, world in enumerate(worlds):
        frame = world.frame(world.view())
        for number in range(len(SPOTS)):
            memory.learn(f"{n}/{number}", frame, box_at(number))
    return memory


def find(memory: LandmarkMemory, world: World, *view: float, **light: float) -> dict[str, tuple[float, float, float]]:
    """What is seen: name to x, y of its middle, zoom."""
    sightings = memory.find(world.frame(world.view(*view, **light)))
    return {s.landmark.name: (*s.box.center_px, s.zoom) for s in sightings}


@pytest.mark.parametrize(
    ("zoom", "light"),
    [
        (1.0, {}),
        (1.0, {"gain": 0.4}),
        (1.0, {"gain": 0.6, "offset": 40, "noise": 5}),
        (0.7, {"gain": 0.6, "noise": 5}),
        (1.4, {"gain": 1.3, "offset": -40}),
        (0.5, {}),
        (2.0, {"noise": 3}),
    ],
    ids=str,
)
def test_500_landmarks_are_told_apart_in_other_light_and_zoom(memory, worlds, zoom, light):
    expected, found, wrong, off_px, off_zoom = 0, 0, 0, [], []
    for n in range(0, 100, 9):
        dx = 40 * math.sin(n)
        seen = find(memory, worlds[n], dx, 3, zoom, **light)
        wrong += sum(not name.startswith(f"{n}/") for name in seen)
        for number in range(len(SPOTS)):
            box = box_at(number)
            x, y = seen_at(box, dx, zoom)
            inside = abs(x - 319.5) + zoom * box.width / 2 < 319 and abs(y + 3 - 239.5) + zoom * box.height / 2 < 239
            expected += inside
            if inside and f"{n}/{number}" in seen:
                found += 1
                off_px.append(abs(seen[f"{n}/{number}"][0] - x))
                off_zoom.append(abs(seen[f"{n}/{number}"][2] / zoom - 1))
    assert expected >= 3
    assert found >= 0.85 * expected - 0.5
    assert wrong == 0
    assert np.median(off_px) < 0.8
    assert np.median(off_zoom) < 0.012


def test_nothing_is_seen_where_nothing_was_learned(memory):
    """The bar is 1 % of frames."""
    views = [(dx, 0, zoom) for dx in (-60, 0, 60) for zoom in (0.6, 1.0, 1.7)]
    others = [World(seed) for seed in range(1000, 1012)]
    seen = [find(memory, other, *view, noise=2) for other in others for view in views]
    assert sum(map(bool, seen)) <= 1
    assert find(memory, World(0), gain=0.0, offset=128) == {}, "a blank wall"


def test_a_landmark_takes_less_than_8_KiB(memory, tmp_path):
    """In the file, and less than what is told once it is compressed."""
    assert len(memory) == 500
    write_landmarks(tmp_path / "all.npz", memory.landmarks)
    with zipfile.ZipFile(tmp_path / "all.npz") as archive:
        whole = sum(entry.file_size for entry in archive.infolist())
    assert whole / 500 == pytest.approx(LANDMARK_BYTES, rel=0.001)
    assert LANDMARK_BYTES <= 8192
    assert (tmp_path / "all.npz").stat().st_size <= 500 * LANDMARK_BYTES


def test_only_one_is_looked_for_when_only_one_is_asked_for(memory, worlds):
    frame = worlds[3].frame(worlds[3].view(10))
    assert [s.landmark.name for s in memory.find(frame, only="3/1")] == ["3/1"]
    assert memory.find(frame, only="4/1") == []
    assert len(memory.find(frame)) > 1


def test_learning_replaces_and_forgetting_forgets(world):
    memory = LandmarkMemory()
    frame = world.frame(world.view())
    first = memory.learn("door", frame, box_at(0))
    assert memory.learn("door", frame, box_at(1)) is memory["door"] is not first
    assert list(find(memory, world)) == ["door"]
    memory.forget("door")
    assert len(memory) == 0 and find(memory, world) == {}
    with pytest.raises(KeyError):
        memory.forget("door")


@pytest.mark.parametrize(
    ("name", "box", "said"),
    [
        ("", box_at(0), "no name"),
        (" x", box_at(0), "no name"),
        ("a\nb", box_at(0), "no name"),
        ("x" * 65, box_at(0), "no name"),
        ("x", Box(900, 0, 50, 50), "outside"),
        ("x", Box(600, 100, 100, 100), "a fifth or more"),
        ("x", Box(100, 100, 12, 90), "too small"),
    ],
)
def test_what_cannot_be_learned_is_said(world, name, box, said):
    with pytest.raises(ValueError, match=said):
        LandmarkMemory().learn(name, world.frame(world.view()), box)


def test_a_blank_wall_is_no_landmark(world):
    with pytest.raises(ValueError, match="featureless"):
        LandmarkMemory().learn("wall", world.frame(np.full((480, 640), 90, np.uint8)), box_at(0))


@pytest.mark.parametrize("zoom", [0.85, 1.0, 1.2])
def test_a_place_is_recognised_and_tells_the_turn(make_world, zoom):
    memory, worlds = LandmarkMemory(), [make_world(seed) for seed in range(12)]
    for n, world in enumerate(worlds):
        memory.learn(str(n), world.frame(world.view()), None)
    for n, world in enumerate(worlds[:4]):
        (sighting,) = memory.find(world.frame(world.view(20, 0, zoom, gain=0.7)))
        assert sighting.landmark.name == str(n)
        assert sighting.bearing_rad == pytest.approx(-math.atan2(20, world.camera.fx), abs=0.01)
        assert sighting.zoom == pytest.approx(zoom, rel=0.03)


# -- the small picture -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("columns", "target"), [(640, box_at(1)), (320, box_at(1)), (640, None)], ids=str)
def test_a_landmark_can_be_followed_again_in_a_camera_of_another_size(world, columns, target):
    landmark = LandmarkMemory().learn("x", world.frame(world.view()), target)
    tracker, zoom = RecallTracker(landmark), 1.1
    x = seen_at(target, 12, zoom)[0] if target is not None else MIDDLE[0] + 12
    for number in range(1, 4):
        image = world.view(12, 0, zoom, gain=0.8, noise=2)
        if columns == 320:
            image = image.reshape(240, 2, 320, 2).mean((1, 3)).astype(np.uint8)
        camera = PinholeCamera.with_fov(columns, columns * 3 // 4)
        frame = Frame(image=image, number=number, time_s=number / 30, camera=camera)
        if number == 1:
            assert tracker.update(frame).state is TrackingState.INITIALIZING
            tracker.learn(frame, None)
        result = tracker.update(frame)
        assert result.state is TrackingState.TRACKING, result.reason
        assert result.bearing_rad == pytest.approx(-math.atan2(x - MIDDLE[0], world.camera.fx), abs=0.004)
        assert result.zoom == pytest.approx(zoom, rel=0.015)
    assert (result.view_angle_rad is None) == (target is None)


def test_a_landmark_that_is_not_there_is_not_followed(make_world):
    world, other = make_world(0), make_world(1)
    tracker = RecallTracker(LandmarkMemory().learn("door", world.frame(world.view()), box_at(1)))
    tracker.learn(other.frame(other.view()), None)
    for number in range(1, 40):
        result = tracker.update(other.frame(other.view(number), number))
        assert result.state is TrackingState.LOST
        assert "'door' is not in view" in result.reason
    assert tracker.update(world.frame(world.view(5), 40)).state is TrackingState.TRACKING


# -- the file ----------------------------------------------------------------------------------------------------------


def test_what_is_written_is_read(tmp_path, world):
    memory = LandmarkMemory()
    memory.learn("Tür ☺", world.frame(world.view()), box_at(0), learned_depth_m=0.5)
    memory.learn("room", world.frame(world.view()), None)
    path = tmp_path / "landmarks.npz"
    write_landmarks(path, memory.landmarks)
    again = read_landmarks(path)
    for landmark, kept in zip(memory.landmarks, again, strict=True):
        assert (kept.name, kept.camera, kept.box) == (landmark.name, landmark.camera, landmark.box)
        assert kept.learned_depth_m == landmark.learned_depth_m
        for field in ("picture", "step_map"):
            assert np.array_equal(getattr(kept, field), getattr(landmark, field))
    write_landmarks(path, [])
    assert read_landmarks(path) == []
    assert [p.name for p in tmp_path.iterdir()] == ["landmarks.npz"]


def broken(path, world, how: str) -> None:
    """Write a file that is wrong in this way."""
    memory = LandmarkMemory()
    memory.learn("a", world.frame(world.view()), box_at(0))
    write_landmarks(path, memory.landmarks)
    arrays = dict(np.load(path))
    if how == "foreign":
        path.write_bytes(b"hello")
    elif how == "empty":
        path.write_bytes(b"")
    elif how == "cut":
        path.write_bytes(path.read_bytes()[:-900])
    elif how == "flipped":
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 0xFF
        path.write_bytes(data)
    elif how == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("x.txt", "no landmarks")
    elif how == "bomb":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("pictures.npy", bytes(65 << 20))
    elif how == "other arrays":
        np.savez(path, x=np.zeros(3))
    elif how == "pickle":
        np.savez(path, **{**arrays, "names": np.array([{}], object)})
    elif how == "no version":
        np.savez(path, **{**arrays, "version": np.array("x")})
    elif how == "two of one name":
        np.savez(path, **{k: np.concatenate([v, v]) if v.ndim else v for k, v in arrays.items()})
    else:
        field, value = how.split("=")
        arrays[field] = arrays[field].copy()
        arrays[field].flat[0] = float(value)
        np.savez(path, **arrays)


@pytest.mark.parametrize(
    "how",
    [
        "foreign", "empty", "cut", "flipped", "zip", "bomb", "other arrays", "pickle", "no version", "two of one name",
        "step_maps=inf", "cameras=nan", "cameras=-5", "cameras=1e9", "depths_m=-1", "boxes=nan",
        "boxes=1e308",
    ],
)  # fmt: skip
def test_a_broken_file_is_one_sentence(tmp_path, world, how):
    path = tmp_path / "landmarks.npz"
    broken(path, world, how)
    with pytest.raises(StationError, match=r"landmarks\.npz is no file of landmarks, or a damaged one") as error:
        read_landmarks(path)
    assert "\n" not in str(error.value)
    assert "--memory" in str(error.value), "what to do"


def test_a_file_of_version_1_is_read(tmp_path, world):
    """It held descriptors besides."""
    memory, path = LandmarkMemory(), tmp_path / "landmarks.npz"
    memory.learn("a", world.frame(world.view()), box_at(0))
    write_landmarks(path, memory.landmarks)
    np.savez(path, **{**np.load(path), "version": np.array(1), "descriptors": np.zeros((1, 2, 48), np.float32)})
    assert [landmark.name for landmark in read_landmarks(path)] == ["a"]


def test_a_file_of_a_later_version_says_so(tmp_path, world):
    memory, path = LandmarkMemory(), tmp_path / "landmarks.npz"
    memory.learn("a", world.frame(world.view()), box_at(0))
    write_landmarks(path, memory.landmarks)
    np.savez(path, **{**np.load(path), "version": np.array(9)})
    with pytest.raises(StationError, match="is of version 9, and this program reads 1 to 2"):
        read_landmarks(path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(StationError, match="cannot be read") as error:
        read_landmarks(tmp_path / "no.npz")
    assert error.value.usage
    with pytest.raises(StationError, match="cannot be written"):
        write_landmarks(tmp_path / "no" / "landmarks.npz", [])


# -- the kernels against what they mean --------------------------------------------------------------------------------


SIDE, BANDS, DEPTH = 12, 3, 4


def levels_of(shapes, first_rows):
    """Some random levels: their pictures, and what the kernels take: cells and table."""
    rng = np.random.default_rng(0)
    levels = [rng.normal(size=shape).astype(np.float32) for shape in shapes]
    offsets = np.cumsum([0, *(level.size for level in levels)])[:-1]
    table = np.array([(o, *shape, first) for o, shape, first in zip(offsets, shapes, first_rows, strict=True)])
    return levels, np.concatenate([level.ravel() for level in levels]), table


def plain_descriptor(window):
    """What a descriptor means: sums over bands of rows, then of columns, read by WINDOWS, of length 1."""
    bands = [window[b * DEPTH : (b + 1) * DEPTH].sum(0) for b in range(BANDS)]
    bands += [window[:, b * DEPTH : (b + 1) * DEPTH].sum(1) for b in range(BANDS)]
    read = (WINDOWS @ np.stack(bands, 1)).ravel()
    return read / np.sqrt((read**2).sum() + 1e-2)


def test_descriptors_are_what_the_poles_read_of_the_sums_over_bands():
    levels, cells, table = levels_of([(30, 41), (20, 26), (17, 20)], [2, 0, 1])
    rows = np.array([3, -1, 1])
    begins, place = np.full((2, 3, 7), -1), 0
    for n, row in ((0, 3), (2, 1)):
        count = (levels[n].shape[1] - DEPTH) // 2 + 1
        for b in range(BANDS):
            begins[0, n, row + b] = place + b * count
        begins[1, n, row] = place + BANDS * count
        place += 4 * count
    taps = np.empty((SIDE, place), np.float32)
    gather_bands(cells, table, begins, taps)
    read, power = WINDOWS @ taps, np.empty(place, np.float32)
    power_of(read, power)
    starts, out = np.empty(4, np.int64), np.empty((2 * BANDS * FUNCTIONS, 40), np.float32)
    put_together(read, power, table, begins, rows, SIDE, starts, out)
    assert starts.tolist() == [0, 15, 15, 20]
    for n, row in ((0, 3), (2, 1)):
        top = table[n, 3] + DEPTH * row
        for k in range(starts[n + 1] - starts[n]):
            window = levels[n][top : top + SIDE, 2 * k : 2 * k + SIDE]
            assert np.allclose(out[:, starts[n] + k], plain_descriptor(window), atol=1e-5)
            assert np.allclose(descriptor_of(np.ascontiguousarray(window)), plain_descriptor(window), atol=1e-5)


def test_the_best_window_is_that_of_the_largest_product():
    rng = np.random.default_rng(1)
    products = rng.uniform(-0.5, 1, (3, 40)).astype(np.float32)
    starts, low, high = np.array([0, 10, 25, 40]), np.array([1, 1, 2]), np.array([3, 2, 2])
    score, level, column = np.empty(3, np.float32), np.empty(3, np.int64), np.empty(3, np.int64)
    best_windows(products[:, 10:].copy(), 10, starts, low, high, score, level, column)
    for i, cut in enumerate((slice(10, 40), slice(10, 25))):
        assert score[i] == products[i, cut].max()
        assert starts[level[i]] + column[i] // 2 == 10 + products[i, cut].argmax()
    assert (score[2], level[2]) == (-1, -1)


def test_slopes_are_compared_a_cell_further_to_all_sides():
    """Against normalised correlation of np.gradient's inner parts; in a corner of the level as well."""

    def plain_slopes(cells):
        return np.concatenate([(cells[:, 2:] - cells[:, :-2]).ravel(), (cells[2:] - cells[:-2]).ravel()])

    (level,), cells, table = levels_of([(24, 30)], [0])
    places = [(0, 0, 1, 0), (7, 9, -1, 1), (12, 18, 0, -1), (5, 6, 0, 0)]
    known = np.stack([known_slopes(level[y + dy : y + dy + 12, x + dx : x + dx + 12]) for y, x, dx, dy in places])
    top, column = np.array([place[:2] for place in places]).T
    score, off = np.empty(4, np.float32), np.zeros((4, 2), np.int64)
    which = np.arange(4)
    compare_slopes(cells, table, 0 * which, top, column, 0.5 * known, which, score, off)
    assert np.allclose(score, 0.5, atol=1e-4), "the cosine is in proportion to what is known"
    assert off.tolist() == [list(place[2:]) for place in places]
    other = known_slopes(level[2:14, 2:14])
    compare_slopes(cells, table, 0 * which, top, column, other[None], 0 * which, score, off)
    one = plain_slopes(level[2:14, 2:14])
    around = [plain_slopes(level[5 + dy : 17 + dy, 6 + dx : 18 + dx]) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    cosines = [float(one @ two / np.linalg.norm(one) / np.linalg.norm(two)) for two in around]
    assert score[3] == pytest.approx(max(cosines), abs=1e-3)
