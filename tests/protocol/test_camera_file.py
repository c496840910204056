"""A camera's file: what is written is read back, by OpenCV too; what is wrong is said; sizes scale as pixels do."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from protocol import Intrinsics, ProtocolError
from protocol.camera_file import CameraFile, read_camera_file, write_camera_file

CAMERA = CameraFile(
    intrinsics=Intrinsics(fx=530.25, fy=531.5, cx=321.0, cy=238.125, distortion=(-0.28, 0.09, 0.001, -1e-05)),
    size=(640, 480),
)


@pytest.mark.parametrize("distortion", [(), (-0.28, 0.09, 0.001, -1e-05), (-0.28, 0.09, 0.001, -1e-05, 0.02)])
def test_what_is_written_is_read_back(tmp_path, distortion):
    """By this module, and by OpenCV: the camera's numbers as real ones, sizes as whole ones (ORB-SLAM3 checks)."""
    own = CAMERA.intrinsics
    camera = CameraFile(
        intrinsics=Intrinsics(fx=500.0, fy=own.fy, cx=own.cx, cy=own.cy, distortion=distortion), size=(640, 480)
    )
    text = write_camera_file(camera, fps=29.97, notes=("by hand",))
    assert read_camera_file(text) == camera

    file = tmp_path / "camera.yaml"
    file.write_text(text)
    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
    matrix = storage.getNode("camera_matrix").mat()
    assert matrix.tolist() == [[500.0, 0.0, own.cx], [0.0, own.fy, own.cy], [0.0, 0.0, 1.0]]
    coefficients = storage.getNode("distortion_coefficients").mat().ravel()
    assert coefficients == pytest.approx(np.array((*distortion, *[0.0] * 5)[:5]))
    assert storage.getNode("File.version").string() == "1.0"
    assert storage.getNode("Camera.type").string() == "PinHole"
    for key in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"):
        assert storage.getNode(f"Camera1.{key}").isReal(), key
    for key, value in (("width", 640), ("height", 480), ("fps", 30), ("RGB", 1)):
        node = storage.getNode(f"Camera.{key}")
        assert node.isInt() and node.real() == value


def test_older_files_name_the_camera_without_a_number():
    text = "Camera.fx: 500\nCamera.fy: 501.5 # px\nCamera.cx: 320\nCamera.cy: 240\nCamera.k1: 0.0\n"
    assert read_camera_file(text) == CameraFile(intrinsics=Intrinsics(fx=500, fy=501.5, cx=320, cy=240))


def test_sizes_scale_about_the_pictures_edge():
    """The left edge of the picture is at -0.5, whatever its size."""
    half = CAMERA.scaled(320, 240)
    assert (half.fx, half.fy) == (530.25 / 2, 531.5 / 2)
    assert ((half.cx + 0.5) * 2 - 0.5, (half.cy + 0.5) * 2 - 0.5) == (321.0, 238.125)
    assert half.distortion == CAMERA.intrinsics.distortion
    assert CAMERA.scaled(640, 480) == CAMERA.intrinsics
    assert CameraFile(intrinsics=CAMERA.intrinsics).scaled(800, 600) == CAMERA.intrinsics


@pytest.mark.parametrize("size", [(640, 360), (480, 640)])
def test_another_shape_is_another_view(size):
    with pytest.raises(ProtocolError, match="640x480"):
        CAMERA.scaled(*size)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("Camera1.fx: 530.25", "", "does not say Camera.fx"),
        ("530.25", "wide", "Camera1.fx is 'wide', not a number"),
        ("530.25", "-3", "focal lengths must be positive"),
        ("PinHole", "KannalaBrandt8", "type 'kannalabrandt8' is not supported"),
        ("Camera.width: 640", "Camera.width: 0", "a picture of 0x480 px is none"),
        ("Camera.width: 640", "Camera.width: inf", "not a number"),
    ],
)
def test_what_is_wrong_is_said(before, after, said):
    text = write_camera_file(CAMERA, fps=30)
    assert before in text
    with pytest.raises(ProtocolError, match=said):
        read_camera_file(text.replace(before, after, 1))
