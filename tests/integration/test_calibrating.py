"""base-station calibrate from end to end: a simulated board before a simulated robot, and the file that comes out."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from base_station.calibration.board import CalibrationBoard
from base_station.cli import main
from protocol.camera_file import read_camera_file
from tests.base_station.calibration.boards import MATRIX, SIZE, drawn_pose, picture
from tests.helpers import Operator, Programs, free_ports, write_pictures

WITHIN = 0.005


def test_the_simulated_camera_is_recovered(programs: Programs, port: int, tmp_path: Path) -> None:
    """From the live stream: fx, fy, cx, cy within 0.5 % of the camera that rendered it; OpenCV reads the file too."""
    agent = programs.agent(port, "--scenario", "calibration", "--rhythm", "lockstep")
    file = tmp_path / "camera.yaml"
    station = programs.start(
        sys.executable, "-m", "base_station", "calibrate", "--port", str(port), "--square-mm", "20", "-o", str(file)
    )
    assert station.exit_code(120.0) == 0, station.stderr
    assert "lost the robot" not in station.stderr and agent.alive
    assert "reprojection error" in station.stderr and "field of view" in station.stderr
    assert "careful" not in station.stderr

    camera = read_camera_file(file.read_text())
    own, focal_px = camera.intrinsics, 320 / np.tan(np.radians(31.1))
    assert camera.size == (640, 480)
    assert (own.fx, own.fy) == pytest.approx((focal_px, focal_px), rel=WITHIN)
    assert own.cx == pytest.approx(319.5, rel=WITHIN) and own.cy == pytest.approx(239.5, rel=WITHIN)
    assert max(map(abs, own.distortion)) < 0.03

    storage = cv2.FileStorage(str(file), cv2.FILE_STORAGE_READ)
    matrix = storage.getNode("camera_matrix").mat()
    assert matrix == pytest.approx(np.array([[own.fx, 0, own.cx], [0, own.fy, own.cy], [0, 0, 1]]), rel=1e-6)
    assert storage.getNode("distortion_coefficients").mat().ravel()[:4] == pytest.approx(own.distortion, rel=1e-6)


def calibration(folder: Path, width: int, height: int) -> Path:
    file = folder / "camera.yaml"
    file.write_text(
        'File.version: "1.0"\nCamera.type: "PinHole"\n'
        f"Camera1.fx: 300.0\nCamera1.fy: 310.0\nCamera1.cx: {width / 2}\nCamera1.cy: {height / 2 - 10}\n"
        f"Camera1.k1: -0.2\nCamera1.k2: 0.05\nCamera1.p1: 0.0\nCamera1.p2: 0.0\n"
        f"Camera.width: {width}\nCamera.height: {height}\n"
    )
    return file


def test_the_agent_tells_of_its_calibration_scaled_to_its_pictures(
    programs: Programs, port: int, pictures: Path, tmp_path: Path, operator: Operator
) -> None:
    """Calibrated at 320x240, pictures of 160x120: hello has half the focal length."""
    programs.replay(port, pictures, "--camera-file", str(calibration(tmp_path, 320, 240)))
    found = operator.hello().intrinsics
    assert found is not None
    assert (found.fx, found.fy) == (150.0, 155.0)
    assert (found.cx, found.cy) == (160.5 / 2 - 0.5, 110.5 / 2 - 0.5)
    assert found.distortion == (-0.2, 0.05, 0.0, 0.0)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--camera-file", "missing.yaml"], "missing.yaml cannot be read"),
        (["--camera-file", "{camera}"], "it is for pictures of 640x360 px, these are 160x120"),
        (["--camera-file", "{empty}"], "it does not say Camera.fx"),
    ],
    ids=["missing", "shape", "empty"],
)
def test_a_calibration_that_cannot_be(programs: Programs, pictures: Path, tmp_path: Path, options, said) -> None:
    """The agent ends with exit code 2 and says which file and why; and so does the station with --camera."""
    empty = tmp_path / "empty.yaml"
    empty.write_text("# nothing\n")
    options = [word.format(camera=calibration(tmp_path, 640, 360), empty=empty) for word in options]
    replay = ("--robot", "none", "--camera", "replay", "--source", str(pictures))
    agent = programs.start(sys.executable, "-m", "robot_agent", "--port", str(free_ports()), *replay, *options)
    assert agent.exit_code() == 2, agent.stderr
    assert said in agent.stderr

    port = free_ports()
    programs.replay(port, pictures)
    station = programs.station(port, "--camera", options[1], "--max-frames", "3")
    assert station.exit_code() == 2, station.stderr
    assert said in station.stderr


@pytest.mark.parametrize("layout", ["folder", "video"])
def test_from_pictures(capsys, tmp_path: Path, layout: str) -> None:
    """A folder of pictures, and a video in which the board is held still now and then: the lens's camera comes out."""
    rng, board = np.random.default_rng(3), CalibrationBoard()
    shown = [picture(board, *drawn_pose(rng, board)) for _ in range(10)]
    source = tmp_path / ("pictures" if layout == "folder" else "board.avi")
    if layout == "folder":
        source.mkdir()
        for number, image in enumerate(shown):
            cv2.imwrite(str(source / f"{number:02d}.png"), image)
    else:
        video = cv2.VideoWriter(str(source), cv2.VideoWriter_fourcc(*"MJPG"), 30, SIZE)
        for image in shown:
            for _ in range(2):
                video.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
        video.release()
    file = tmp_path / "camera.yaml"
    assert main(["calibrate", "--images", str(source), "-o", str(file)]) == 0
    said = capsys.readouterr().err
    assert "10 of 10" in said and "careful: the views lack something" in said
    own = read_camera_file(file.read_text()).intrinsics
    assert (own.fx, own.fy) == pytest.approx((MATRIX[0, 0], MATRIX[1, 1]), rel=0.01)
    assert own.distortion[0] == pytest.approx(-0.28, abs=0.04)


def test_usage(capsys, tmp_path: Path) -> None:
    """What a person does wrong with calibrate ends with one line and the right exit code."""
    pictures = write_pictures(tmp_path / "pictures", 3)
    for options, code, said in (
        (["--squares", "7"], 2, "COLUMNSxROWS"),
        (["--square-mm", "0"], 2, "1..1000 mm"),
        (["--images", "no/such"], 2, "no folder and no video no/such"),
        (["--images", str(pictures)], 1, "There are 0 views of the board"),
        (["--output", "no/such/camera.yaml"], 2, "there is no folder no/such"),
        (["board", str(tmp_path / "board.doc")], 2, ".pdf or .png"),
        (["board", "--square-mm", "90", str(tmp_path / "board.pdf")], 2, "does not fit on A4"),
    ):
        assert main(["calibrate", *options]) == code, options
        assert said in " ".join(capsys.readouterr().err.split())
