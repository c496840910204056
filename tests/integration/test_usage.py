"""What a person does wrong ends with the right exit code and one clear line, never with a traceback."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from base_station.configuration import read_settings
from base_station.run_command import Run
from tests.helpers import Programs, write_pictures

USAGE, FAILED = 2, 1


def plain(text: str) -> str:
    """What was said, without line breaks and frames."""
    return " ".join(text.replace("│", " ").split())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--tracker", "ztransfrom"], ["ztransfrom", "did you mean ztransform", "z-shift, z-regions, phase"]),
        (["--tracker", "no/such/file.py:Tracker"], ["no/such/file.py", "there is no file"]),
        (["--tracker", "base_station/trackers/example.py:Lamp"], ["no class 'Lamp'", "TorchTracker"]),
        (["--behaviour", "folow"], ["folow", "follow, goto, idle, route, pattern, teleop"]),
        (["--target", "1,2,3"], ["--target 1,2,3", "x,y,width,height"]),
        (["--target", "10,10,0,5"], ["--target 10,10,0,5", "x,y,width,height"]),
        (["--duration", "0"], ["--duration must be positive"]),
        (["--width", "0"], ["--width must be 1..8192"]),
        (["--port", "70000"], ["--port must be 1..65532"]),
        (["--results", "no/such/folder/results.csv"], ["no/such/folder/results.csv", "cannot be written"]),
        (["--summary", "no/such/folder/summary.json"], ["--summary", "no/such/folder"]),
        (["--host", "no.such.host.invalid"], ["no.such.host.invalid"]),
        (["--colour", "red"], ["--colour"]),
    ],
    ids=lambda value: " ".join(value[:2]) if value and value[0].startswith("--") else "",
)
def test_station_options(programs: Programs, port: int, options: list[str], said: list[str]) -> None:
    """A wrong option of base-station run: exit code 2, and the text says what is wrong and what would be right."""
    arguments = options if "--port" in options else [*options, "--port", str(port)]
    station = programs.start(sys.executable, "-m", "base_station", "run", *arguments)

    assert station.exit_code() == USAGE, station.stderr
    for words in said:
        assert words in plain(station.stderr)


def test_station_target_outside_of_the_picture(programs: Programs, port: int, pictures: Path) -> None:
    """A box beside the picture is known only with the first frame: the station says so, and the robot stands."""
    programs.replay(port, pictures)
    station = programs.station(port, "--target", "5000,5000,50,50", "--max-frames", "10")

    assert station.exit_code() == FAILED
    assert "cannot learn this target" in station.stderr
    assert "5000,5000,50,50 was never learned" in station.stderr


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--size", "640"], "'640' is no size"),
        (["--size", "0x480"], "'0x480' is no size"),
        (["--rows", "20:10"], "'20:10' are no rows"),
        (["--fps", "0"], "'0' is no positive number"),
        (["--port", "65533"], "'65533' is no port"),
        (["--fault", "gremlins=3"], "wheel_slip"),
        (["--fault", "wheel_slip=much"], "'wheel_slip=much'"),
        (["--fault", "wheel_slip=0.9"], "wheel_slip must be from 0.0 to 0.45"),
        (["--scenario", "leadr"], "'leader'"),
        (["--robot", "tank"], "'thymio'"),
        (["--camera", "polaroid"], "'replay'"),
        (["--rhythm", "waltz"], "'lockstep'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_agent_options(programs: Programs, options: list[str], said: str) -> None:
    """A wrong option of robot-agent: exit code 2, and the text names it."""
    agent = programs.start(sys.executable, "-m", "robot_agent", *options)

    assert agent.exit_code() == USAGE, agent.stderr
    assert said in plain(agent.stderr)


def failing_agent(programs: Programs, port: int, *options: str, code: int = FAILED) -> str:
    """Start an agent that cannot serve; the one line that it says."""
    agent = programs.start(sys.executable, "-m", "robot_agent", "--port", str(port), *options)
    assert agent.exit_code() == code, agent.stderr
    (line,) = [line for line in agent.stderr.splitlines() if line.startswith("robot-agent: ")]
    return line


def test_rows_outside_of_the_picture(programs: Programs, port: int, pictures: Path) -> None:
    """Rows that the picture does not have: one line that says which it has."""
    replay = ("--robot", "none", "--camera", "replay", "--source", str(pictures))
    line = failing_agent(programs, port, *replay, "--rows", "100:130", code=USAGE)
    assert "100:130" in line and "0:120" in line


def test_network_that_is_none(programs: Programs, port: int, pictures: Path) -> None:
    """--allow with something that is no network."""
    replay = ("--robot", "none", "--camera", "replay", "--source", str(pictures))
    line = failing_agent(programs, port, *replay, "--allow", "my-laptop", code=USAGE)
    assert "my-laptop" in line and "192.168.0.0/24" in line


@pytest.mark.parametrize("taken", [0, 1, 2, 3])
def test_port_in_use(programs: Programs, port: int, pictures: Path, taken: int) -> None:
    """Any of the four ports in use: one line with its number and what to do."""
    with socket.create_server(("127.0.0.1", port + taken)):
        line = failing_agent(programs, port, "--robot", "none", "--camera", "replay", "--source", str(pictures))
    assert f"Port {port + taken}" in line and "--port" in line


def test_second_agent(programs: Programs, port: int, pictures: Path) -> None:
    """The usual cause of a port in use: an agent that runs already. It goes on undisturbed."""
    first = programs.replay(port, pictures)
    line = failing_agent(programs, port, "--robot", "none", "--camera", "replay", "--source", str(pictures))
    assert "another agent may be running" in line
    assert first.alive


def test_camera_that_is_not_there(programs: Programs, port: int) -> None:
    """No such video device: one line that names it and the ones there are."""
    line = failing_agent(programs, port, "--robot", "none", "--camera", "usb", "--source", "/dev/video97")
    assert "/dev/video97" in line and "video devices here" in line


def test_recording_that_is_not_there(programs: Programs, port: int, tmp_path: Path) -> None:
    """A missing folder, an empty one, no --source at all, and a file that is no video."""
    replay = ("--robot", "none", "--camera", "replay")
    missing = tmp_path / "missing"
    assert f"There is no recording {missing}" in failing_agent(programs, port, *replay, "--source", str(missing))
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "No pictures in" in failing_agent(programs, port, *replay, "--source", str(empty))
    assert "--source" in failing_agent(programs, port, *replay, code=USAGE)
    text = tmp_path / "text.avi"
    text.write_text("this is no video")
    assert "no video" in failing_agent(programs, port, *replay, "--source", str(text))


def test_recording_with_a_broken_picture(programs: Programs, port: int, tmp_path: Path) -> None:
    """A picture in the middle that cannot be read ends the agent with its name, exit code 1 and standing wheels."""
    folder = write_pictures(tmp_path / "recording", 6)
    (folder / "00004.png").write_bytes(b"no picture")
    agent = programs.replay(port, folder)
    station = programs.station(port, "--behaviour", "pattern")

    assert agent.exit_code() == FAILED
    assert "00004.png" in agent.stderr
    station.says("lost the robot")


def test_missing_extra(programs: Programs, port: int) -> None:
    """Without MuJoCo the simulated robot names the extra to install."""
    without_mujoco = (
        "import sys; sys.modules['mujoco'] = None\nfrom robot_agent.cli import main; sys.exit(main(sys.argv[1:]))\n"
    )
    agent = programs.start(sys.executable, "-c", without_mujoco, "--robot", "sim", "--port", str(port))

    assert agent.exit_code() == FAILED, agent.stderr
    (line,) = [line for line in agent.stderr.splitlines() if line]
    assert "zservo[sim]" in line


def test_agent_without_the_stations_libraries(programs: Programs, port: int, pictures: Path) -> None:
    """On a Pi there is neither MuJoCo nor numba, tyro or rich: the agent serves a camera without them."""
    on_a_pi = (
        "import sys\n"
        "for name in ('mujoco', 'numba', 'tyro', 'rich', 'picamera2', 'threadpoolctl'): sys.modules[name] = None\n"
        "from robot_agent.cli import main; sys.exit(main(sys.argv[1:]))\n"
    )
    agent = programs.start(
        sys.executable, "-c", on_a_pi, "--robot", "none", "--camera", "replay", "--source", str(pictures),
        "--port", str(port),
    )  # fmt: skip

    agent.says("serving robot none")


def test_results_that_cannot_be_written(programs: Programs, port: int, pictures: Path, tmp_path: Path) -> None:
    """A path that cannot be written is known before the robot is asked for anything."""
    agent = programs.replay(port, pictures)
    station = programs.station(port, "--results", str(tmp_path))

    assert station.exit_code() == USAGE
    assert "cannot be written" in station.stderr
    assert "frames: " not in agent.stderr, "a station connected"


def test_help(programs: Programs) -> None:
    """--help of both programs ends with exit code 0 and names the options that people look for."""
    station = programs.start(sys.executable, "-m", "base_station", "run", "--help")
    agent = programs.start(sys.executable, "-m", "robot_agent", "--help")
    assert station.exit_code() == 0 and agent.exit_code() == 0
    assert "--behaviour" in station.stdout and "--tracker" in station.stdout
    assert "--rhythm" in agent.stdout and "--scenario" in agent.stdout


def test_a_reader_that_has_enough_is_no_mistake() -> None:
    """As `... --help | head` does, once it has its lines."""
    reading, writing = os.pipe()
    os.close(reading)
    command = (sys.executable, "-m", "base_station", "run", "--help")
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (0, b"")


def test_flags_override_the_file(programs: Programs, tmp_path: Path) -> None:
    """The program itself: file, flags over it, and the result printed so that it can be read back."""
    file = tmp_path / "robot.toml"
    file.write_text('tracker = "phase"\nport = 4000\nrows = true\ntarget-width-m = 0.2\nresults = "out.csv"\n')
    run = (sys.executable, "-m", "base_station", "run", "--config")
    first = programs.start(*run, str(file), "--port", "5000", "--no-rows", "--print-config")
    assert first.exit_code() == 0, first.stderr
    second = tmp_path / "printed.toml"
    second.write_text(first.stdout)
    expected = Run(tracker="phase", port=5000, target_width_m=0.2, results=tmp_path / "out.csv")
    assert read_settings(second, Run, "run") == expected

    file.write_text("port = 4000\ntrakcer = 'phase'\n")
    wrong = programs.start(*run, str(file))
    assert wrong.exit_code() == 2
    assert f"{file}, line 2: there is no setting 'trakcer'; did you mean 'tracker'?" in wrong.stderr
