"""robot-agent: mistakes at the keyboard end with one clear line and the right exit code, never with a traceback."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from robot_agent import __version__, cli
from robot_agent.cameras.usb import UsbCamera
from robot_agent.ending import EXIT_DONE, EXIT_FAILED, EXIT_USAGE
from robot_agent.errors import AgentError, CameraError
from robot_agent.rig import RigOptions, build_rig
from robot_agent.robots.none import NoRobot
from robot_agent.settings_file import RobotSettings, save_robot_settings


def usage_error(capsys, *arguments: str) -> str:
    """The last line of what a wrong command line is told; checks that the exit code is 2."""
    with pytest.raises(SystemExit) as ended:
        cli.main(list(arguments))
    assert ended.value.code == EXIT_USAGE == 2
    return capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("size", ["640", "640x", "x480", "640x480x3", "0x480", "640x0", "-1x5", "axb", "6.5x4"])
def test_a_size_is_two_positive_numbers(capsys, size):
    assert "is no size; write WIDTHxHEIGHT, such as 640x480" in usage_error(capsys, f"--size={size}")


@pytest.mark.parametrize("rows", ["208", "208:", ":272", "272:208", "5:5", "a:b", "-1:5"])
def test_rows_are_first_and_past_last(capsys, rows):
    assert "are no rows; write FIRST:PAST_LAST, such as 208:272" in usage_error(capsys, f"--rows={rows}")


@pytest.mark.parametrize("option", ["--fps", "--speed-scale"])
@pytest.mark.parametrize("value", ["0", "-3", "nan", "inf", "fast", "1e9"])
def test_rates_and_scales_are_positive_numbers(capsys, option, value):
    assert "is no positive number" in usage_error(capsys, f"{option}={value}")


@pytest.mark.parametrize("trim", ["0.4", "2.1", "nan", "-1", "much", ""])
def test_a_trim_is_a_number_near_1(capsys, trim):
    assert "is no trim; give a number from 0.5 to 2" in usage_error(capsys, f"--trim={trim}")


@pytest.mark.parametrize(
    "device", ["tcp:", "tcp:pi", "tcp:pi:", "tcp::33333", "tcp:pi:0", "tcp:pi:65536", "tcp:pi:http"]
)
def test_a_device_is_a_port_or_a_whole_address(capsys, device):
    assert "is no address; write tcp:HOST:PORT" in usage_error(capsys, f"--device={device}")


def test_the_trim_is_the_option_s_else_the_settings_file_s(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    save_robot_settings(RobotSettings(trim=1.02))
    trims = []
    monkeypatch.setattr(
        "robot_agent.robots.thymio_serial.SerialThymioRobot", lambda **options: trims.append(options["trim"])
    )
    options = RigOptions(robot="thymio-serial", camera="replay", source=recording(tmp_path))
    for asked in (options, replace(options, trim=0.97)):
        build_rig(asked).camera.close()
    assert trims == [1.02, 0.97]


def test_a_broken_settings_file_ends_the_agent_in_one_sentence(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    save_robot_settings(RobotSettings()).write_text("trim: 1.02")
    told = failure(capsys, *replay(tmp_path), "--robot", "thymio-serial", "--device", "tcp:127.0.0.1:1")
    assert "The robot's settings in" in told and "no JSON" in told


@pytest.mark.parametrize("port", ["0", "65533", "-1", "http", "31440.5"])
def test_the_base_port_leaves_room_for_four(capsys, port):
    assert "give 1..65532" in usage_error(capsys, f"--port={port}")


@pytest.mark.parametrize(
    ("option", "valid"),
    [
        ("--robot", ("sim", "none")),
        ("--camera", ("usb", "picamera2", "replay", "sim")),
        ("--rhythm", ("free", "lockstep")),
        ("--safety", ("default", "thesis")),
        ("--scenario", ("poster", "leader", "lights", "plain", "turn")),
    ],
)
def test_an_unknown_name_is_answered_with_the_names_there_are(capsys, option, valid):
    line = usage_error(capsys, option, "nonsense")
    for name in valid:
        assert name in line


@pytest.mark.parametrize("fault", ["gremlins=1", "wheel_slip", "wheel_slip=much", "=1"])
def test_an_unknown_fault_is_answered_with_the_faults_there_are(capsys, fault):
    line = usage_error(capsys, "--fault", fault)
    assert "wheel_slip" in line
    assert "lost_frames" in line


@pytest.mark.parametrize("fault", ["wheel_slip=0.9", "lost_frames=1", "noise_sigma=-1", "blur_s=nan"])
def test_a_fault_out_of_its_range_is_told_the_range(capsys, fault):
    assert f"The fault {fault.partition('=')[0]} must be from" in usage_error(capsys, "--fault", fault)


def test_an_unknown_option_is_wrong_usage(capsys):
    assert "unrecognized arguments: --turbo" in usage_error(capsys, "--turbo")


def test_version_and_help_are_done_with_exit_code_0(capsys):
    for option, expected in (("--version", f"robot-agent {__version__}"), ("--help", "--speed-scale")):
        with pytest.raises(SystemExit) as ended:
            cli.main([option])
        assert ended.value.code == EXIT_DONE == 0
        assert expected in capsys.readouterr().out


def failure(capsys, *arguments: str, code: int = EXIT_FAILED) -> str:
    """The one line of what the agent says when it cannot do what is asked; checks the exit code too."""
    assert cli.main(["--quiet", *arguments]) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("robot-agent: ")
    return line


def test_simulated_and_real_do_not_mix(capsys):
    for robot, camera in (("sim", "usb"), ("none", "sim")):
        line = failure(capsys, "--robot", robot, "--camera", camera, code=EXIT_USAGE)
        assert "use --robot sim with --camera sim" in line
        assert f"not --robot {robot} with --camera {camera}" in line


def test_a_replay_needs_a_recording(capsys):
    assert "with --source" in failure(capsys, "--robot", "none", "--camera", "replay", code=EXIT_USAGE)


def test_a_recording_that_is_not_there_is_named(capsys, tmp_path):
    line = failure(capsys, "--robot", "none", "--camera", "replay", "--source", str(tmp_path / "nowhere"))
    assert "nowhere" in line


def recording(folder) -> str:
    cv2.imwrite(str(folder / "a.png"), np.zeros((24, 32), np.uint8))
    return str(folder)


def replay(folder) -> tuple[str, ...]:
    return ("--robot", "none", "--camera", "replay", "--source", recording(folder))


def test_rows_outside_of_the_picture_are_told_those_there_are(capsys, tmp_path):
    assert "the picture has rows 0:24" in failure(capsys, *replay(tmp_path), "--rows", "20:25", code=EXIT_USAGE)


def test_a_picture_too_large_for_the_wire_is_told_the_bound(capsys, tmp_path):
    with pytest.raises(SystemExit) as ended:
        cli.main([*replay(tmp_path), "--size", "9000x10"])
    assert ended.value.code == EXIT_USAGE
    assert "8192" in capsys.readouterr().err


@pytest.mark.parametrize("seed", ["x", "-1", "99999999999999999999999"])
def test_a_seed_that_telemetry_could_not_carry_is_told_the_bound(capsys, seed):
    with pytest.raises(SystemExit) as ended:
        cli.main([f"--seed={seed}"])
    assert ended.value.code == EXIT_USAGE
    assert "2147483648" in capsys.readouterr().err


def test_a_source_for_a_robot_with_its_own_camera_is_told_the_way(capsys, tmp_path):
    said = failure(capsys, "--source", str(tmp_path), code=EXIT_USAGE)
    assert "--robot none --camera replay" in said


def test_a_network_that_is_none_is_told_an_example(capsys, tmp_path):
    assert "192.168.0.0/24" in failure(capsys, *replay(tmp_path), "--allow", "everybody", code=EXIT_USAGE)


def test_an_address_that_is_not_ours_is_named(capsys, tmp_path):
    assert "192.0.2.1" in failure(capsys, *replay(tmp_path), "--listen", "192.0.2.1")


def test_a_usb_camera_that_is_not_there_lists_those_that_are(capsys):
    with pytest.raises(CameraError, match=r"Camera 97 cannot be opened \(video devices here: .*\): .*--source"):
        UsbCamera("97")
    assert "Camera 97" in failure(capsys, "--robot", "none", "--camera", "usb", "--source", "97")


def test_the_pi_camera_says_which_widths_it_has(capsys):
    assert "multiple of 64, not 500" in failure(capsys, "--robot", "none", "--camera", "picamera2", "--size", "500x400")


def test_a_rig_without_robot_takes_commands_and_moves_nothing(tmp_path):
    rig = build_rig(RigOptions(robot="none", camera="replay", source=recording(tmp_path), lockstep=True))
    assert isinstance(rig.robot, NoRobot)
    rig.robot.set_wheels(100, 100)
    assert rig.robot.state().proximity is None
    assert not rig.stepped
    rig.camera.begin()
    frame = rig.camera.read(0.1)
    assert frame is not None
    assert frame.image.shape == (24, 32)


def test_a_rig_of_half_a_simulation_is_refused():
    with pytest.raises(AgentError, match="one world"):
        build_rig(RigOptions(robot="none", camera="sim"))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--pan-tilt", "servoblaster"], "use --pan-tilt sim."),
        (["--robot", "playground", "--pan-tilt", "sim"], "camera is fixed"),
        (["--robot", "none", "--camera", "replay", "--source", "x", "--pan-tilt", "sim"], "--pan-tilt servoblaster"),
        (["--pan-tilt", "sim", "--pan-pulse", "100:3000"], "from 500 to 2500"),
        (["--pan-tilt", "sim", "--tilt-servo", "0"], "cannot both be servo 0"),
        (["--pan-tilt", "sim", "--pan-servo", "left"], "'left' is no servo"),
    ],
)
def test_a_pan_tilt_that_cannot_be_is_wrong_usage(capsys, options, said):
    assert cli.main(options) == EXIT_USAGE
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


@pytest.mark.parametrize("pulses", ["wide", "600", "600:", ":2400", "-600:2400", "600:2400:1"])
def test_pulses_are_two_whole_numbers(capsys, pulses):
    assert "are no pulses; write US:US, such as 600:2400" in usage_error(capsys, f"--pan-pulse={pulses}")
