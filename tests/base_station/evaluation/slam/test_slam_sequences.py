"""Recorded sequences for SLAM in three layouts: times, camera and truth as they are, and damage in one sentence."""

from __future__ import annotations

import numpy as np
import pytest

from base_station.errors import StationError
from base_station.evaluation.slam.camera_files import (
    freiburg_camera,
    read_euroc_sensor,
    read_kitti_calibration,
    read_orbslam,
)
from base_station.evaluation.slam.sequence import read_gray, read_sequence
from base_station.evaluation.slam.trajectory_errors import associate
from tests.base_station.evaluation.slam.sequences import (
    FRAMES,
    HEIGHT,
    ORBSLAM_YAML,
    WIDTH,
    path,
    write_euroc_sequence,
    write_kitti_sequence,
    write_tum_sequence,
)

WRITERS = {"TUM": write_tum_sequence, "EuRoC": write_euroc_sequence, "KITTI": write_kitti_sequence}


@pytest.fixture(params=WRITERS)
def layout(request):
    return request.param


def test_every_layout_tells_the_same(tmp_path, layout):
    folder = WRITERS[layout](tmp_path / "dataset" / "sequences" / "07")
    sequence = read_sequence(folder)
    assert (sequence.layout, sequence.name, len(sequence)) == (layout, "07", FRAMES)
    assert sequence.times_s - sequence.times_s[0] == pytest.approx(np.arange(FRAMES) / 20, abs=1e-5)
    camera = sequence.camera
    assert (camera.width_px, camera.height_px, camera.fx, camera.fy, camera.cx, camera.cy) == (
        WIDTH, HEIGHT, 80.0, 81.0, 47.0, 36.0,
    )  # fmt: skip
    distortion = {"TUM": (-0.1, 0.01, 0.0, 0.0), "EuRoC": (-0.28, 0.07, 0.00019, 1.76e-05), "KITTI": ()}
    assert camera.distortion == distortion[layout]
    assert all(read_gray(picture).shape == (HEIGHT, WIDTH) for picture in sequence.pictures)
    assert read_gray(sequence.pictures[7])[0, 0] == 35, "not in order"
    pairs = associate(sequence.times_s, sequence.truth.times_s, 1e-4)
    assert len(pairs) == FRAMES
    expected, found = path().world_from_cam, sequence.truth.world_from_cam
    assert found[sorted(pairs[:, 1])] == pytest.approx(expected, abs=1e-5), "not the camera's poses"


def test_the_first_frames_only(tmp_path, layout):
    folder = WRITERS[layout](tmp_path / "dataset" / "sequences" / "07")
    assert len(read_sequence(folder, max_frames=5)) == 5


def test_another_camera_and_none(tmp_path, layout):
    folder = WRITERS[layout](tmp_path / "dataset" / "sequences" / "07")
    other = tmp_path / "other.yaml"
    other.write_text(ORBSLAM_YAML.replace("80.0", "99.5"))
    assert read_sequence(folder, camera=str(other)).camera.fx == 99.5
    assumed = read_sequence(folder, camera="none")
    assert assumed.camera.fx == pytest.approx(WIDTH / 2 / np.tan(np.radians(31.1)))
    assert assumed.camera_source == "assumed: 62.2 degrees"
    assert assumed.truth is not None


def test_a_yaml_in_the_folder_stands_in_for_the_calibration_of_the_format(tmp_path):
    for folder, calibration in (
        (write_euroc_sequence(tmp_path / "V1"), "mav0/cam0/sensor.yaml"),
        (write_kitti_sequence(tmp_path / "dataset" / "sequences" / "03"), "calib.txt"),
    ):
        (folder / calibration).unlink()
        assert read_sequence(folder).camera_source.startswith("assumed")
        (folder / "EuRoC.yaml").write_text(ORBSLAM_YAML)
        assert read_sequence(folder).camera.distortion == (-0.1, 0.01, 0.0, 0.0)


def test_old_and_new_keys_of_orbslam(tmp_path):
    file = tmp_path / "TUM1.yaml"
    file.write_text(
        "%YAML:1.0\n# Camera Parameters\nCamera.fx: 517.306408\nCamera.fy: 516.469215\nCamera.cx: 318.643040\n"
        "Camera.cy: 255.313989\n\nCamera.k1: 0.262383\nCamera.k2: -0.953104\nCamera.p1: -0.005358\n"
        "Camera.p2: 0.002628\nCamera.k3: 1.163314\n\nCamera.fps: 30.0\n"
    )
    found = read_orbslam(file)
    assert found.intrinsics == (517.306408, 516.469215, 318.643040, 255.313989)
    assert found.distortion == (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
    assert found.size is None
    assert found.camera(640, 480).distortion[4] == 1.163314
    file.write_text(ORBSLAM_YAML)
    assert read_orbslam(file).size == (96, 72)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("Camera1.fx: 80.0  # px", "", "does not say Camera.fx"),
        ("80.0  # px", "wide", "Camera1.fx is 'wide', not a number"),
        ("80.0  # px", "nan", "not a number"),
        ("PinHole", "KannalaBrandt8", "'kannalabrandt8' is not supported"),
        ("Camera.width: 96", "Camera.width: 752", "is for pictures of 752x72 px, these are 96x72"),
        ("80.0  # px", "-80", "focal lengths must be positive"),
        ("cx: 47.0", "cx: 470.0", "outside of the picture"),
    ],
)
def test_a_wrong_calibration_is_one_sentence(tmp_path, old, new, said):
    folder = write_tum_sequence(tmp_path / "toy", yaml=ORBSLAM_YAML.replace(old, new))
    with pytest.raises(StationError, match=said):
        read_sequence(folder)


def test_cameras_of_other_formats(tmp_path):
    file = tmp_path / "sensor.yaml"
    file.write_text("camera_model: pinhole\nintrinsics: [1, 2, 3]\n")
    with pytest.raises(StationError, match="intrinsics must be 4 numbers"):
        read_euroc_sensor(file)
    file.write_text("camera_model: pinhole\nintrinsics: [1, 2, 3, 4]\ndistortion_model: equidistant\n")
    with pytest.raises(StationError, match="equidistant distortion is not supported"):
        read_euroc_sensor(file)
    file.write_text("P0: 1 2 3\n")
    with pytest.raises(StationError, match="no line 'P0:'"):
        read_kitti_calibration(file, 0)
    fr2 = freiburg_camera("rgbd_dataset_freiburg2_desk")
    assert fr2 is not None and fr2.intrinsics[0] == 520.9 and fr2.size == (640, 480)
    assert freiburg_camera("desk") is None


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda folder: (folder / "rgb.txt").unlink(), "is no sequence: rgb.txt"),
        (lambda folder: (folder / "rgb.txt").write_text("# nothing\n"), "lists 0 pictures"),
        (lambda folder: (folder / "rgb.txt").write_text("1.0 rgb/a.png\n"), "lists 1 picture; at"),
        (lambda folder: (folder / "rgb.txt").write_text("1.0\n"), "entry 1: a time and a file"),
        (lambda folder: (folder / "rgb.txt").write_text("soon rgb/a.png\n"), "entry 1: 'soon' is not a time"),
        (lambda folder: (folder / "rgb.txt").write_text("2 a.png\n1 b.png\n"), "times of the pictures must rise"),
        (lambda folder: (folder / "rgb.txt").write_text("1 a.png\n2 b.png\n"), "none of the 2 pictures can be read"),
        (lambda folder: (folder / "groundtruth.txt").write_text("1 2 3\n"), "8 numbers are expected"),
        (lambda folder: (folder / "groundtruth.txt").write_text("1,2,3,4,5,6,7,8\n"), "with spaces between them"),
        (lambda folder: (folder / "orbslam3.yaml").rename(folder / "a.yaml") and (folder / "b.yaml").touch(),
         "several camera files"),
    ],
)  # fmt: skip
def test_a_damaged_folder_is_one_sentence(tmp_path, damage, said):
    folder = write_tum_sequence(tmp_path / "toy", 4)
    damage(folder)
    with pytest.raises(StationError, match=said):
        read_sequence(folder)


def test_what_is_missing_besides_pictures(tmp_path):
    folder = write_tum_sequence(tmp_path / "toy", 4, yaml=None)
    (folder / "groundtruth.txt").unlink()
    sequence = read_sequence(folder)
    assert sequence.truth is None
    assert sequence.camera_source.startswith("assumed")
    kitti = write_kitti_sequence(tmp_path / "dataset" / "sequences" / "01", 4)
    (kitti / "times.txt").write_text("0\n1\n")
    with pytest.raises(StationError, match="2 times for 4 pictures"):
        read_sequence(kitti)
    (kitti / "image_0").rename(kitti / "pictures")
    with pytest.raises(StationError, match="no pictures in image_0"):
        read_sequence(kitti)
    with pytest.raises(StationError, match="no folder"):
        read_sequence(tmp_path / "nothing")
