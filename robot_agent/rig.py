"""Which camera goes with which robot and pan-tilt: builds them from their names, with the clock that suits them."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field

from protocol import ProtocolError, Scenario
from robot_agent.camera_file import read_calibration
from robot_agent.cameras.base import Camera
from robot_agent.errors import UsageError
from robot_agent.pantilt.base import PanTilt
from robot_agent.pantilt.servoblaster import ServoBlaster, ServoBlasterSettings
from robot_agent.robots.base import Robot
from robot_agent.robots.none import NoRobot
from robot_agent.settings_file import load_robot_settings
from robot_agent.sim.faults import Faults

CAMERAS = ("usb", "picamera2", "replay", "sim", "playground")
ROBOTS = ("sim", "thymio", "thymio-serial", "playground", "none")
OWN_CAMERA = ("sim", "playground")
"""Robots that come with a camera of their own, of the same name: the two are one world."""
BUSES = ("session", "system")
PAN_TILTS = ("none", "servoblaster", "sim")


@dataclass(frozen=True, kw_only=True)
class RigOptions:
    """What the command line says about camera and robot."""

    robot: str
    camera: str
    source: str | None = None
    """Camera device, or the recording to replay."""
    camera_file: str | None = None
    """The camera's calibration."""
    size: tuple[int, int] | None = None
    """Width and height of the picture in px; None: 640x480, or the recording's own."""
    fps: float | None = None
    """None: 30, or the recording's own times."""
    bus: str = "session"
    node: str = "thymio-II"
    """The Thymio's D-Bus bus, and its name in the Aseba network."""
    pan_tilt: str = "none"
    servos: ServoBlasterSettings = field(default_factory=ServoBlasterSettings)
    """Of `servoblaster`; the limits hold for `sim` too."""
    device: str | None = None
    """Where thymio-serial finds it: a serial port, or tcp:HOST:PORT; None: the first serial port there is."""
    trim: float | None = None
    """The Thymio's right wheel over its left one; None: as the robot's settings file says."""
    lockstep: bool = False
    scenario: str = "leader"
    seed: int = 0
    faults: Faults = field(default_factory=Faults)


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A camera, on a pan-tilt or fixed, and a robot. `clock`: what safety goes by; `stepped`: it stands still between
    two lockstep exchanges."""

    camera: Camera
    robot: Robot
    pan_tilt: PanTilt | None = None
    scenario: Scenario | None = None
    clock: Callable[[], float] = time.monotonic
    stepped: bool = False
    bus: str | None = None
    """Address of the D-Bus bus that a playground has for itself."""

    def close(self) -> None:
        """Let go of all of it, the robot first."""
        with ExitStack() as closing:  # the last one named is the first one called
            closing.callback(self.camera.close)
            if self.pan_tilt is not None:
                closing.callback(self.pan_tilt.close)
            closing.callback(self.robot.close)


def check_together(options: RigOptions) -> None:
    """Raises UsageError, in words, when camera, robot and pan-tilt do not go together."""
    for name in OWN_CAMERA:
        if name in (options.robot, options.camera) and options.robot != options.camera:
            raise UsageError(
                f"Camera and robot of {name} are one world: use --robot {name} with --camera {name}, "
                f"not --robot {options.robot} with --camera {options.camera}. To stream pictures without a "
                "robot: --robot none."
            )
    if options.robot in OWN_CAMERA and options.source is not None:
        raise UsageError(
            f"--source {options.source}: --robot {options.robot} has a camera of its own; to stream a recording use "
            "--robot none --camera replay."
        )
    if options.robot in OWN_CAMERA and options.camera_file is not None:
        raise UsageError(
            f"--camera-file {options.camera_file}: the simulated camera of {options.robot} is known; leave "
            "--camera-file out, or name a real --robot and --camera."
        )
    if options.robot == "playground" and options.pan_tilt != "none":
        raise UsageError("The playground's camera is fixed: use --robot sim --pan-tilt sim.")
    if options.pan_tilt == ("servoblaster" if options.robot == "sim" else "sim"):
        raise UsageError(
            f"--pan-tilt {options.pan_tilt} does not turn this camera: use "
            + ("--pan-tilt sim." if options.robot == "sim" else "--pan-tilt servoblaster.")
        )


def build_rig(options: RigOptions) -> Rig:
    """Open camera, robot and pan-tilt. Raises AgentError, in words, when one is not to be had or they do not go
    together."""
    check_together(options)
    if options.robot == "sim":
        return _simulation(options)
    if options.robot == "playground":
        return _playground(options)
    with ExitStack() as opened:
        camera = open_camera(options)
        opened.callback(camera.close)
        pan_tilt = open_servos(options)
        if pan_tilt is not None:
            opened.callback(pan_tilt.close)
        rig = Rig(camera=camera, robot=open_robot(options), pan_tilt=pan_tilt)
        opened.pop_all()
        return rig


def open_robot(options: RigOptions) -> Robot:
    """The robot alone, of those that have no camera of their own. Raises AgentError when it is not to be had."""
    if options.robot == "thymio":
        from robot_agent.robots.thymio import ThymioRobot

        return ThymioRobot(bus=options.bus, node=options.node, trim=_trim(options))
    if options.robot == "thymio-serial":
        from robot_agent.robots.thymio_serial import SerialThymioRobot

        return SerialThymioRobot(device=options.device, node=options.node, trim=_trim(options))
    return NoRobot()


def open_servos(options: RigOptions) -> PanTilt | None:
    """The servos alone, of a camera that is no part of a robot; None: it is fixed. Raises PanTiltError."""
    return ServoBlaster(options.servos) if options.pan_tilt == "servoblaster" else None


def _trim(options: RigOptions) -> float:
    return options.trim if options.trim is not None else load_robot_settings().trim


def open_camera(options: RigOptions) -> Camera:
    """The camera alone, of those that are no part of a robot, with its calibration where there is one. Raises
    AgentError when it is not to be had."""
    calibration = read_calibration(options.camera_file) if options.camera_file is not None else None
    camera = _plain_camera(options)
    if calibration is not None:
        try:
            camera.intrinsics = calibration.scaled(camera.width, camera.height)
        except ProtocolError as error:
            camera.close()
            raise UsageError(f"--camera-file {options.camera_file}: {error}.") from error
    return camera


def _plain_camera(options: RigOptions) -> Camera:
    width, height = options.size or (640, 480)
    fps = options.fps or 30.0
    if options.camera == "usb":
        from robot_agent.cameras.usb import UsbCamera

        return UsbCamera(options.source or "0", width=width, height=height, fps=fps)
    if options.camera == "picamera2":
        from robot_agent.cameras.picamera2 import PiCamera

        return PiCamera(width=width, height=height, fps=fps)
    from robot_agent.cameras.replay import ReplayCamera

    if options.source is None:
        raise UsageError("--camera replay needs a recording: name a video file or a folder with --source.")
    return ReplayCamera(options.source, size=options.size, fps=options.fps, realtime=not options.lockstep)


def _simulation(options: RigOptions) -> Rig:
    from robot_agent.cameras.sim import SimCamera
    from robot_agent.pantilt.sim import SimPanTilt
    from robot_agent.robots.sim import SimRobot
    from robot_agent.sim.world import World

    width, height = options.size or (640, 480)
    world = World(
        scenario=options.scenario,
        seed=options.seed,
        width=width,
        height=height,
        fps=options.fps or 30.0,
        faults=options.faults,
        pan_tilt=options.servos.limits if options.pan_tilt == "sim" else None,
    )
    return Rig(
        camera=SimCamera(world, realtime=not options.lockstep),
        robot=SimRobot(world),
        pan_tilt=SimPanTilt(world) if world.pan_tilt is not None else None,
        scenario=world.scenario,
        clock=(lambda: world.time_s) if options.lockstep else time.monotonic,
        stepped=options.lockstep,
    )


def _playground(options: RigOptions) -> Rig:
    from robot_agent.cameras.playground import PlaygroundCamera
    from robot_agent.playground.world import PlaygroundWorld
    from robot_agent.robots.playground import PlaygroundRobot

    if options.lockstep:
        raise UsageError("The playground keeps its own time: use --rhythm free (or --robot sim for lockstep).")
    faults = options.faults
    if faults != Faults(noise_sigma=faults.noise_sigma):
        raise UsageError("The playground has no such faults: only --fault noise_sigma=VALUE (or use --robot sim).")
    width, height = options.size or (640, 480)
    world = PlaygroundWorld(
        scenario=options.scenario,
        seed=options.seed,
        width=width,
        height=height,
        fps=options.fps or 30.0,
        noise_sigma=faults.noise_sigma,
    )
    try:
        trim = options.trim if options.trim is not None else 1.0  # the settings file is about the real robot
        robot = PlaygroundRobot(bus=world.programs.bus, node=options.node, trim=trim)
    except BaseException:
        world.close()
        raise
    return Rig(camera=PlaygroundCamera(world), robot=robot, scenario=world.scenario, bus=world.programs.bus)
