"""The options that the agent's commands share, checked one by one, and what they say about camera, robot and safety."""

from __future__ import annotations

import argparse
import dataclasses
import math

from protocol import FRAME_PORT
from protocol.frames import MAX_SIDE_PX
from robot_agent import __version__
from robot_agent.errors import AgentError
from robot_agent.pantilt.servoblaster import ServoBlasterSettings
from robot_agent.pantilt.slew import PI_PAN
from robot_agent.rig import BUSES, CAMERAS, OWN_CAMERA, PAN_TILTS, ROBOTS, RigOptions
from robot_agent.safety import PRESETS, SafetySettings
from robot_agent.settings_file import MAX_TRIM, MIN_TRIM, RobotSettings
from robot_agent.sim.faults import Faults
from robot_agent.sim.scenarios import SCENARIOS


def _size(text: str) -> tuple[int, int]:
    width, separator, height = text.lower().partition("x")
    if not separator or not width.isdecimal() or not height.isdecimal() or not (int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"{text!r} is no size; write WIDTHxHEIGHT, such as 640x480")
    if max(int(width), int(height)) > MAX_SIDE_PX:
        raise argparse.ArgumentTypeError(f"{text!r} is too large; each side may have {MAX_SIDE_PX} px")
    return int(width), int(height)


def _rows(text: str) -> tuple[int, int]:
    first, separator, past_last = text.partition(":")
    if not separator or not first.isdecimal() or not past_last.isdecimal() or int(first) >= int(past_last):
        raise argparse.ArgumentTypeError(f"{text!r} are no rows; write FIRST:PAST_LAST, such as 208:272")
    return int(first), int(past_last)


def positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < 10_000:
        raise argparse.ArgumentTypeError(f"{text!r} is no positive number")
    return value


def _pulses(text: str) -> tuple[int, int]:
    low, separator, high = text.partition(":")
    if not separator or not low.isdecimal() or not high.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} are no pulses; write US:US, such as 600:2400")
    return int(low), int(high)


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) >= 2**31:
        raise argparse.ArgumentTypeError(f"{text!r} is no seed; give a whole number below 2147483648")
    return int(text)


def _port(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= 65532:
        raise argparse.ArgumentTypeError(f"{text!r} is no port for four in a row; give 1..65532")
    return int(text)


def _trim(text: str) -> float:
    try:
        return RobotSettings(trim=float(text)).trim
    except (ValueError, AgentError):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no trim; give a number from {MIN_TRIM:g} to {MAX_TRIM:g}"
        ) from None


def _device(text: str) -> str:
    if text.startswith("tcp:"):
        host, _, port = text.removeprefix("tcp:").rpartition(":")
        if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
            raise argparse.ArgumentTypeError(f"{text!r} is no address; write tcp:HOST:PORT, such as tcp:pi:33333")
    elif not text:
        raise argparse.ArgumentTypeError("name a serial port, such as /dev/ttyACM0, or tcp:HOST:PORT")
    return text


def _fault(text: str) -> tuple[str, float]:
    names = [field.name for field in dataclasses.fields(Faults)]
    name, _, value = text.partition("=")
    try:
        if name not in names:
            raise ValueError
        Faults(**{name: float(value)})
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: write NAME=VALUE with one of {', '.join(names)}") from None
    except AgentError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return name, float(value)


def agent_parser(*, add_help: bool = True) -> argparse.ArgumentParser:
    """The agent's options. Without `add_help`: for a parser that has them too (argparse's `parents`)."""
    parser = argparse.ArgumentParser(
        prog="robot-agent",
        add_help=add_help,
        description="Streams gray frames (TCP 31440) and obeys wheel commands (TCP 31441); telemetry and control on "
        "the two ports after these. Without options: the simulated robot.",
        epilog="`robot-agent doctor` with the same options checks everything that they need, and measures wheel trim.",
    )
    add = parser.add_argument
    add("--robot", choices=ROBOTS, default="sim", help="what drives (default: %(default)s)")
    add("--camera", choices=CAMERAS, help="where pictures come from (default: a simulated robot's own, else usb)")
    add("--source", metavar="WHAT", help="camera number or device; for replay a video file or a folder of pictures")
    add("--camera-file", metavar="FILE", help="the camera's calibration, as base-station calibrate wrote it")
    add("--size", type=_size, metavar="WxH", help="size of the picture (default: 640x480; a replay's own)")
    add("--fps", type=positive, help="pictures per second (default: 30; a replay's own times)")
    add("--rows", type=_rows, metavar="A:B", help="send only rows A to B-1: the same wire with fewer bytes")
    add("--rhythm", choices=("free", "lockstep"), default="free", help="lockstep: one frame, one command (the thesis)")
    add("--speed-scale", type=positive, default=1.0, metavar="X", help="motor units per wire unit (default: 1)")
    add("--listen", default="127.0.0.1", metavar="ADDRESS", help="(default: %(default)s; a real robot: 0.0.0.0)")
    add("--port", type=_port, default=FRAME_PORT, metavar="BASE", help="first of the four ports (default: %(default)s)")
    add("--allow", action="append", default=[], metavar="CIDR", help="only these networks may connect; repeatable")
    add("--announce", action="store_true", help="let `base-station robots` find it on the loopback too")
    add("--safety", choices=tuple(PRESETS), default="default", help="thesis: the obstacle rule of listing A.1")
    add("--no-edge-stop", action="store_true", help="do not stop at a table's edge (dark floors look like one)")
    add("--no-tilt-stop", action="store_true", help="do not stop when picked up or tilted")
    add("--quiet", action="store_true", help="say only what goes wrong")
    add("--version", action="version", version=f"robot-agent {__version__}")
    thymio = parser.add_argument_group("thymio")
    thymio.add_argument("--bus", choices=BUSES, default="session", help="D-Bus bus of asebamedulla (default: session)")
    thymio.add_argument("--node", default="thymio-II", help="the robot's name there (default: %(default)s)")
    thymio.add_argument(
        "--device", type=_device, help="thymio-serial: serial port or tcp:HOST:PORT (default: the first /dev/ttyACM*)"
    )
    thymio.add_argument(
        "--trim",
        type=_trim,
        metavar="X",
        help="right wheel's speed over left's (default: the settings file's, else 1)",
    )
    servos = ServoBlasterSettings()
    turning = parser.add_argument_group("pan-tilt").add_argument
    turning("--pan-tilt", choices=PAN_TILTS, default="none", help="what turns the camera (default: %(default)s)")
    turning("--slew", type=positive, default=math.degrees(PI_PAN.slew_rad_s), metavar="DEG_S", help="(default: 300)")
    turning("--servo-device", default=servos.device, metavar="FIFO", help="ServoBlaster's (default: %(default)s)")
    turning("--pan-servo", default=servos.pan_servo, metavar="SERVO", help="number or pin (default: %(default)s)")
    turning("--tilt-servo", default=servos.tilt_servo, metavar="SERVO", help="number or pin (default: %(default)s)")
    turning("--pan-pulse", type=_pulses, default=servos.pan_pulse_us, metavar="US:US", help="90 degrees right and left")
    turning("--tilt-pulse", type=_pulses, default=servos.tilt_pulse_us, metavar="US:US", help="55 degrees down and up")
    simulation = parser.add_argument_group("simulation")
    simulation.add_argument("--scenario", choices=tuple(SCENARIOS), default="leader", help="(default: %(default)s)")
    simulation.add_argument("--seed", type=_seed, default=0, help="of textures, courses, noise (default: %(default)s)")
    simulation.add_argument("--faults", action="store_true", help="slip, lost frames, blur and noise all at once")
    simulation.add_argument("--fault", type=_fault, action="append", default=[], metavar="NAME=VALUE", help="one fault")
    return parser


def rig_options(options: argparse.Namespace) -> RigOptions:
    """What the options say about robot and camera."""
    return RigOptions(
        robot=options.robot,
        camera=options.camera or (options.robot if options.robot in OWN_CAMERA else "usb"),
        source=options.source,
        camera_file=options.camera_file,
        size=options.size,
        fps=options.fps,
        bus=options.bus,
        node=options.node,
        device=options.device,
        trim=options.trim,
        pan_tilt=options.pan_tilt,
        servos=_servos(options),
        lockstep=options.rhythm == "lockstep",
        scenario=options.scenario,
        seed=options.seed,
        faults=dataclasses.replace(Faults.standard() if options.faults else Faults(), **dict(options.fault)),
    )


def _servos(options: argparse.Namespace) -> ServoBlasterSettings:
    return ServoBlasterSettings(
        device=options.servo_device,
        pan_servo=options.pan_servo,
        tilt_servo=options.tilt_servo,
        pan_pulse_us=options.pan_pulse,
        tilt_pulse_us=options.tilt_pulse,
        limits=dataclasses.replace(PI_PAN, slew_rad_s=math.radians(options.slew)),
    )


def safety_settings(options: argparse.Namespace) -> SafetySettings:
    """What the options say about safety."""
    settings = PRESETS[options.safety]
    if options.no_edge_stop:
        settings = dataclasses.replace(settings, edge=None)
    if options.no_tilt_stop:
        settings = dataclasses.replace(settings, tilt_rad=None)
    return settings
