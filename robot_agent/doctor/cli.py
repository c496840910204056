"""The doctor's command: takes the very options that the agent is started with, and looks at all that they need."""

from __future__ import annotations

import argparse
import contextlib
import getpass
import logging
import re
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from protocol import RobotLimits
from robot_agent import __version__
from robot_agent.access import AllowList
from robot_agent.doctor import calibration, machine
from robot_agent.doctor import link as network
from robot_agent.doctor.camera import check_camera, missing_camera
from robot_agent.doctor.findings import Check, Finding, Verdict, examine, line, summary
from robot_agent.doctor.thymio import check_thymio
from robot_agent.ending import EXIT_DONE, EXIT_FAILED, exit_code, interrupt, on_end_signals
from robot_agent.errors import AgentError, UsageError
from robot_agent.options import agent_parser, positive, rig_options, safety_settings
from robot_agent.rig import OWN_CAMERA, RigOptions, build_rig, check_together, open_camera, open_robot, open_servos
from robot_agent.robots.base import Robot
from robot_agent.settings_file import load_robot_settings, save_robot_settings

AGENT_UNIT = "zservo-agent.service"
READY_S = 3.0
LONGEST_RUN_S = 60.0


def _peer(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":") if text.count(":") == 1 else (text, "", "")
    if not host or (port and not (port.isdecimal() and 1 <= int(port) <= 65535)):
        raise argparse.ArgumentTypeError(f"{text!r}: write HOST or HOST:PORT")
    return host, int(port) if port else 0


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) <= 10_000:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of centimetres")
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="robot-agent doctor",
        parents=[agent_parser(add_help=False)],
        description="Checks all that the agent needs with these options and names the command that mends it. "
        "No wheel turns, but with --calibrate-wheels.",
    )
    doctor = parser.add_argument_group("doctor")
    doctor.add_argument("--report", type=Path, metavar="FILE", help="write what was found to a text file, to send it")
    doctor.add_argument("--peer", type=_peer, metavar="HOST[:PORT]", help="measure the way to the PC that runs --sink")
    doctor.add_argument("--sink", action="store_true", help="on the PC: take the bytes that a robot's --peer sends")
    trim = parser.add_argument_group("wheel trim")
    trim.add_argument(
        "--calibrate-wheels", action="store_true", help="drive straight, ask where it ended, store the trim"
    )
    trim.add_argument("--yes", action="store_true", help="drive without asking first")
    trim.add_argument("--run-s", type=positive, default=12.0, metavar="S", help="how long to drive (default: 12)")
    trim.add_argument("--run-speed", type=positive, default=200.0, metavar="V", help="motor units (default: 200)")
    trim.add_argument(
        "--ran-cm", type=_number, metavar="CM", help="with --veered-cm: a run done before; nothing drives"
    )
    trim.add_argument(
        "--veered-cm", type=_number, metavar="CM", help="how far left of the line it ended (right: below 0)"
    )
    return parser


def main(arguments: Sequence[str]) -> int:
    """Returns the exit code: 0 all is well, 1 something is to be mended, 2 wrong usage."""
    parser = _parser()
    options = parser.parse_args(arguments)
    on_end_signals(interrupt)
    logging.basicConfig(level=logging.ERROR, format="robot-agent doctor: %(message)s")
    try:
        if options.sink:
            return _sink(options)
        if options.calibrate_wheels:
            return _calibrate(options)
        return _examine(options)
    except KeyboardInterrupt:
        print("robot-agent doctor: interrupted", file=sys.stderr)
        return EXIT_FAILED
    except AgentError as error:
        print(f"robot-agent doctor: {error}", file=sys.stderr)
        return exit_code(error)


# -- looking -------------------------------------------------------------------------------------------------------


def _examine(options: argparse.Namespace) -> int:
    if options.report is not None and not options.report.parent.is_dir():
        raise UsageError(f"--report: there is no folder {options.report.parent}.")
    check_together(rig_options(options))
    findings = examine(_checks(options), lambda finding: print(line(finding), flush=True))
    print(summary(findings))
    if options.report is not None:
        _write_report(options.report, options, findings)
    return EXIT_FAILED if any(finding.verdict is Verdict.FAILED for finding in findings) else EXIT_DONE


def _checks(options: argparse.Namespace) -> list[tuple[str, Check]]:
    rig = rig_options(options)
    width, height = options.size or (640, 480)
    first, past_last = options.rows or (0, height)
    rows, fps = max(1, min(past_last, height) - first), options.fps or 30.0
    needed = network.needed_mbit_s(width, rows, fps)
    peer = None if options.peer is None else (options.peer[0], options.peer[1] or options.port)
    checks: list[tuple[str, Check]] = [
        ("python", lambda: machine.check_python(rig.robot, rig.camera)),
        ("ports", lambda: network.check_ports(options.listen, options.port, AGENT_UNIT)),
        ("cable", lambda: machine.check_serial(rig.robot)),
    ]
    if rig.robot in OWN_CAMERA:
        checks.append((rig.robot, lambda: _check_own_world(rig, fps)))
    else:
        checks.append(("camera", lambda: _check_camera(rig, fps)))
        checks.append(("robot", lambda: _check_robot(rig)))
        checks.append(("pan-tilt", lambda: _check_servos(rig)))
    checks += [
        ("wifi", lambda: network.check_wifi(needed)),
        ("link", lambda: network.check_link(peer, needed, width * rows)),
        ("power", machine.check_power),
        ("clock", machine.check_clock),
    ]
    return checks


def _check_camera(rig: RigOptions, fps: float) -> Iterator[Finding]:
    try:
        camera = open_camera(rig)
    except AgentError as error:
        yield Finding("camera", Verdict.FAILED, str(error), missing_camera(rig.camera))
        return
    with contextlib.closing(camera):
        yield from check_camera(camera, rig.fps or (camera.fps if rig.camera == "replay" else fps))


def _check_robot(rig: RigOptions) -> Iterator[Finding]:
    if rig.robot == "none":
        yield Finding("robot", Verdict.SKIPPED, "--robot none: nothing drives")
    elif rig.robot == "thymio":
        yield from check_thymio(rig.bus, rig.node)
    else:
        with contextlib.closing(open_robot(rig)) as robot:
            yield _await_ready(robot)


def _check_servos(rig: RigOptions) -> Iterator[Finding]:
    """Servos do not answer: a person has to look where the camera looks."""
    if (servos := open_servos(rig)) is None:
        return
    with contextlib.closing(servos):
        said = f"{rig.servos.device} takes pulses, the camera is centred"
        yield Finding("pan-tilt", Verdict.OK, said, "does it look straight ahead? If not: --pan-pulse, --tilt-pulse")


def _check_own_world(options: RigOptions, fps: float) -> Iterator[Finding]:
    """A robot whose camera is part of its world: both come up together."""
    rig = build_rig(options)
    with contextlib.closing(rig):
        yield from check_camera(rig.camera, fps, simulated=True)
        yield _await_ready(rig.robot)
        if rig.bus is not None:
            yield from check_thymio(rig.bus, options.node)


def _await_ready(robot: Robot) -> Finding:
    """The driver's own word, as soon as it has heard from the robot."""
    deadline_s = time.monotonic() + READY_S
    while (state := robot.state()).problem and time.monotonic() < deadline_s:
        time.sleep(0.05)
    if state.problem:
        return Finding("robot", Verdict.FAILED, f"{robot.kind}: {state.problem}", "switch it on, check its cable")
    return Finding("robot", Verdict.OK, f"{robot.kind} answers, proximity {list(state.proximity or ())}")


def _write_report(path: Path, options: argparse.Namespace, findings: Sequence[Finding]) -> None:
    rig = rig_options(options)
    size = "x".join(map(str, options.size or (640, 480)))
    head = [
        f"zservo robot-agent {__version__}, doctor's report",
        f"{time.strftime('%Y-%m-%d %H:%M:%S', time.gmtime())} UTC",
        f"robot {rig.robot}, camera {rig.camera}, size {size}, {options.fps or 30:g} pictures a second",
    ]
    text = "\n".join([*head, "", *map(line, findings), "", summary(findings), ""])
    try:
        path.write_text(without_names(text, str(Path.home()), getpass.getuser()), encoding="utf-8")
    except OSError as error:
        raise AgentError(f"{path} cannot be written ({error.strerror}).") from error
    print(f"report: {path} (names and addresses are left out)")


def without_names(text: str, home: str, user: str) -> str:
    """A report that may be sent: no addresses or names of machines but the loopback's, no user's name."""
    if len(home) > 1:
        text = text.replace(home, "~")
    if user:
        text = re.sub(rf"\b{re.escape(user)}\b", "USER", text)
    text = re.sub(r"tcp:[^;\s]*", "tcp:(host)", text)
    return re.sub(r"\b(?!127\.)(?!0\.0\.0\.0\b)\d{1,3}(?:\.\d{1,3}){3}\b", "(address)", text)


# -- the link's other end --------------------------------------------------------------------------------------------


def _sink(options: argparse.Namespace) -> int:
    allow = AllowList(tuple(options.allow))
    with network.open_sink(options.listen, options.port) as listening:
        print(f"taking bytes on {options.listen}, port {options.port}, until Ctrl-C; on the robot:", flush=True)
        print(f"    robot-agent doctor --peer ADDRESS_OF_THIS_MACHINE:{options.port}", flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            network.serve_sink(listening, allow, lambda: False, lambda text: print(text, flush=True))
    return EXIT_DONE


# -- wheel trim --------------------------------------------------------------------------------------------------------


def _calibrate(options: argparse.Namespace) -> int:
    if options.robot in (*OWN_CAMERA, "none"):
        raise UsageError("--calibrate-wheels needs a robot on the floor: --robot thymio or --robot thymio-serial.")
    if options.run_s > LONGEST_RUN_S:
        raise UsageError(f"--run-s {options.run_s:g}: at most {LONGEST_RUN_S:g} s.")
    if (options.ran_cm is None) != (options.veered_cm is None):
        raise UsageError("--ran-cm and --veered-cm belong together.")
    old, speed = load_robot_settings(), round(options.run_speed)
    if not 1 <= speed <= RobotLimits().max_units / 2:
        raise UsageError(f"--run-speed {options.run_speed:g}: from 1 to {RobotLimits().max_units // 2} motor units.")
    measured = None if options.ran_cm is None else (options.ran_cm, options.veered_cm)
    if measured is None:
        if not options.yes:
            _confirm(speed, options.run_s)
        _drive(options, speed)
        ran_cm = _ask("How many cm did it come along the line? ")
        measured = ran_cm, _ask("How many cm beside the line did it end (left of it positive, right negative)? ")
    ratio = calibration.wheel_ratio(measured[0], measured[1], wheel_base_cm=100 * RobotLimits().wheel_base_m)
    in_force = options.trim if options.trim is not None else old.trim
    trim = calibration.new_trim(ratio, in_force, speed)
    path = save_robot_settings(replace(old, trim=trim))
    print(f"trim {trim:.3f} stored in {path} (it was {old.trim:.3f}); right wheel over left in this run: {ratio:.3f}")
    print("Start the agent again, or measure once more: the robot should now keep to the line.")
    return EXIT_DONE


def _confirm(speed: int, run_s: float) -> None:
    way_cm = calibration.expected_cm(speed, run_s, RobotLimits().metres_per_unit_s)
    print(
        f"The robot will drive straight on for {run_s:g} s, about {way_cm:.0f} cm. Put it on a free floor with its "
        "axle on a line, pointing along another line (a seam of the floor, a taped string). Ctrl-C, its centre "
        "button or a hand that lifts it stops it."
    )
    if _read("Drive now? [y/N] ").lower() not in ("y", "yes"):
        raise AgentError("Nothing was driven.")


def _drive(options: argparse.Namespace, speed: int) -> None:
    """Drives; the driver's `close` reads back that the wheels stand, whatever happened."""
    stopping = threading.Event()
    rig = rig_options(options)
    with contextlib.closing(open_robot(rig)) as robot:
        ready = _await_ready(robot)
        if ready.verdict is not Verdict.OK:
            raise AgentError(f"The robot is not ready: {ready.said}.")
        on_end_signals(stopping.set)
        print(f"driving for {options.run_s:g} s", flush=True)
        calibration.drive_straight(robot, speed, options.run_s, stopping.is_set, safety=safety_settings(options))
    on_end_signals(interrupt)


def _ask(question: str) -> float:
    while True:
        answer = _read(question)
        with contextlib.suppress(argparse.ArgumentTypeError):
            return _number(answer.replace(",", "."))
        print(f"{answer!r} is no number of centimetres; write one such as 93.5")


def _read(question: str) -> str:
    try:
        return input(question).strip()
    except EOFError:
        raise AgentError(
            "Nobody is there to answer (no terminal), nothing was stored. Drive with --yes; then store the result with "
            "robot-agent doctor --calibrate-wheels --robot thymio --ran-cm 93 --veered-cm 4 (your figures)."
        ) from None
