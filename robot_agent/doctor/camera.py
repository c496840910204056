"""The camera: opens, gives the size that was asked for, and as many pictures a second."""

from __future__ import annotations

import getpass
import glob
import os
import time
from collections.abc import Callable, Iterator

from robot_agent.cameras.base import Camera
from robot_agent.doctor.findings import Finding, Verdict

WARM_UP_S = 3.0
"""A camera may need so long for its first picture."""
MEASURE_S = 1.5
GOOD_RATE = 0.9
DARK, BRIGHT, FLAT = 10.0, 245.0, 2.0
"""Gray levels: a mean outside of the first two, or a deviation below the third, is a lid or a lamp."""


def check_camera(
    camera: Camera, asked_fps: float, clock: Callable[[], float] = time.monotonic, *, simulated: bool = False
) -> Iterator[Finding]:
    """Reads for some seconds. The camera stays open."""
    camera.begin()
    first = None
    deadline_s = clock() + WARM_UP_S
    while first is None and clock() < deadline_s:
        first = camera.read(0.2)
    if first is None:
        yield Finding(
            "camera", Verdict.FAILED, f"opens, but gives no picture within {WARM_UP_S:.0f} s", "unplug it, plug it in"
        )
        return
    height, width = first.image.shape
    times_s = [first.capture_s]
    deadline_s = clock() + MEASURE_S
    while clock() < deadline_s:
        frame = camera.read(0.2)
        if frame is not None:
            times_s.append(frame.capture_s)
            first = frame
    span_s = times_s[-1] - times_s[0]
    fps = (len(times_s) - 1) / span_s if span_s > 0 else 0.0
    said = f"{type(camera).__name__} gives {width}x{height} at {fps:.1f} pictures a second ({asked_fps:.0f} asked)"
    if fps >= GOOD_RATE * asked_fps:
        yield Finding("camera", Verdict.OK, said)
    else:
        slow = "end other programs (this computer draws the pictures)" if simulated else "more light (dark is slow)"
        mend = f"{slow}, or ask for what it gives: --fps {max(1, int(fps))}"
        yield Finding("camera", Verdict.WARNING, said, mend)
    mean, deviation = float(first.image.mean()), float(first.image.std())
    if not DARK <= mean <= BRIGHT or deviation < FLAT:
        said = f"the picture is all of one gray (mean {mean:.0f}, deviation {deviation:.1f} of 255)"
        yield Finding("picture", Verdict.WARNING, said, "take the lid off, switch the light on")
    else:
        yield Finding("picture", Verdict.OK, f"mean gray {mean:.0f}, deviation {deviation:.0f}")


def missing_camera(kind: str) -> str:
    """What brings a camera that cannot be opened, as far as this machine can tell."""
    devices = sorted(glob.glob("/dev/video*"))
    closed = [device for device in devices if not os.access(device, os.R_OK | os.W_OK)]
    if closed:
        return f"sudo usermod -aG video {getpass.getuser()}, then log out and in again ({closed[0]} may not be opened)"
    if kind == "picamera2":
        return "sudo apt install python3-picamera2, and seat the ribbon cable; rpicam-hello must show a picture"
    if kind == "usb" and not devices:
        return "plug a USB camera in; ls /dev/video* must list it"
    return "name one that is there with --source; is another program (an agent) using it?"
