"""The computer itself: Python and its packages, the serial cable, power, clock."""

from __future__ import annotations

import glob
import grp
import importlib.util
import os
import platform
import pwd
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path

from robot_agent.doctor.findings import Finding, Verdict

_PACKAGES = {
    "numpy": ("numpy", "python3-numpy"),
    "cv2": ("opencv-python-headless", "python3-opencv"),
    "zmq": ("pyzmq", "python3-zmq"),
    "msgpack": ("msgpack", "python3-msgpack"),
    "dbus": ("dbus-python", "python3-dbus"),
    "gi": ("PyGObject<3.51", "python3-gi"),
    "picamera2": ("", "python3-picamera2"),
    "thymiodirect": ("thymiodirect", ""),
    "serial": ("pyserial", "python3-serial"),
    "mujoco": ("mujoco", ""),
    "zeroconf": ("zeroconf", "python3-zeroconf"),
}
"""Module, PyPI's name for it (empty: not from there), Debian's name for it."""
_NEEDED = ("numpy", "zmq", "msgpack")
_NEEDED_BY = {
    "thymio": ("dbus", "gi"),
    "playground": ("dbus", "gi", "mujoco", "cv2"),
    "sim": ("mujoco", "cv2"),
    "thymio-serial": ("thymiodirect", "serial"),
    "usb": ("cv2",),
    "replay": ("cv2",),
    "picamera2": ("picamera2",),
}
THYMIO_USB = {("0617", "000a"): "Thymio II", ("0617", "000c"): "Thymio's wireless dongle"}
"""USB vendor and product, hexadecimal, as the kernel writes them."""
CABLE_ROBOTS = ("thymio", "thymio-serial")
_THROTTLED = {
    0: "too little voltage now",
    1: "clock capped now",
    2: "throttled now",
    3: "too hot now",
    16: "too little voltage since the start",
    17: "clock was capped",
    18: "was throttled",
    19: "was too hot",
}
"""Bits of `vcgencmd get_throttled` (Raspberry Pi documentation)."""
_CALL_S = 5.0
_YOUNGEST_YEAR = 2024


def run(*command: str) -> str | None:
    """What a program prints, or None when it is not there, fails or hangs."""
    if shutil.which(command[0]) is None:
        return None
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_CALL_S, check=False, errors="replace")
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def check_python(robot: str, camera: str) -> Iterator[Finding]:
    """Python, and every package that this robot and camera need."""
    system = f"Python {platform.python_version()} on {platform.system()} {platform.release()} {platform.machine()}"
    yield Finding("python", Verdict.OK, system)
    needed = [*_NEEDED, *_NEEDED_BY.get(robot, ()), *_NEEDED_BY.get(camera, ())]
    there = [module for module in dict.fromkeys(needed) if importlib.util.find_spec(module) is not None]
    missing = [module for module in dict.fromkeys(needed) if module not in there]
    yield Finding("packages", Verdict.OK, ", ".join(f"{module} {_version(module)}" for module in there))
    if missing:
        yield Finding("packages", Verdict.FAILED, f"missing: {', '.join(missing)}", _install(missing))
    if importlib.util.find_spec("zeroconf") is None:
        said = "no zeroconf: `base-station robots` will not find this robot; --host does"
        yield Finding("packages", Verdict.SKIPPED, said, _install(["zeroconf"]))
    if (
        camera == "picamera2"
        and (spec := importlib.util.find_spec("numpy"))
        and "dist-packages" not in str(spec.origin)
    ):
        said = f"numpy is pip's ({spec.origin}), picamera2 needs Debian's"
        yield Finding("packages", Verdict.FAILED, said, "pip uninstall numpy opencv-python-headless")


def _version(module: str) -> str:
    """Three numbers at the most: four would look like an address, and a report leaves those out."""
    return ".".join(_whole_version(module).split(".")[:3])


def _whole_version(module: str) -> str:
    for name in (_PACKAGES[module][0].partition("<")[0], module):
        try:
            return metadata.version(name)
        except (metadata.PackageNotFoundError, ValueError):
            continue
    loaded = sys.modules.get(module)  # Debian's OpenCV brings no metadata
    return str(getattr(loaded, "__version__", "(version unknown)"))


def _install(modules: Sequence[str]) -> str:
    """The command that brings these modules: pip in a virtual environment, apt elsewhere."""
    in_venv = sys.prefix != sys.base_prefix
    from_pip = [_PACKAGES[module][0] for module in modules if _PACKAGES[module][0]]
    from_apt = [_PACKAGES[module][1] for module in modules if _PACKAGES[module][1]]
    if in_venv and len(from_pip) == len(modules):
        return f"{sys.prefix}/bin/pip install {' '.join(repr(name) if '<' in name else name for name in from_pip)}"
    if len(from_apt) == len(modules):
        return f"sudo apt install {' '.join(from_apt)}"
    if "mujoco" in modules:
        return "scripts/setup --playground, then .venv/bin/robot-agent (on a PC: a Pi has no use for the simulator)"
    return 'see robot_agent/README.md, "Thymio II", for a virtual environment with thymiodirect'


def check_serial(robot: str) -> Iterator[Finding]:
    """The Thymio's cable: is a device there, and may this user open it."""
    if robot not in CABLE_ROBOTS:
        return
    devices = sorted(glob.glob("/dev/ttyACM*"))
    thymios = {device: kind for device in devices if (kind := THYMIO_USB.get(_usb_id(device)))}
    if not thymios:
        others = f" (other serial devices: {', '.join(devices)})" if devices else ""
        mend = "plug the Thymio's USB cable in and switch it on; `lsusb` must list 0617:000a"
        yield Finding("cable", Verdict.WARNING, f"no Thymio on USB{others}", mend)
    for device, kind in thymios.items():
        if os.access(device, os.R_OK | os.W_OK):
            yield Finding("cable", Verdict.OK, f"{device} ({kind}), readable and writable")
        else:
            yield Finding("cable", Verdict.FAILED, f"{device} ({kind}) may not be opened", _permission(device))


def _usb_id(device: str) -> tuple[str, str]:
    """Vendor and product of a serial device, as the kernel knows them."""
    usb = Path("/sys/class/tty", Path(device).name, "device").resolve().parent
    try:
        return (usb / "idVendor").read_text().strip(), (usb / "idProduct").read_text().strip()
    except OSError:
        return "", ""


def _permission(device: str) -> str:
    group = grp.getgrgid(os.stat(device).st_gid).gr_name
    user = pwd.getpwuid(os.geteuid()).pw_name
    if user in grp.getgrnam(group).gr_mem:
        return f"log out and in again (or reboot): {user} is in the group {group}, but this session began before"
    return f"sudo usermod -aG {group} {user}, then log out and in again"


def check_power() -> Iterator[Finding]:
    """On a Raspberry Pi: voltage and heat. Elsewhere there is nothing to ask."""
    if shutil.which("vcgencmd") is None:
        yield Finding("power", Verdict.SKIPPED, "no vcgencmd here: this is no Raspberry Pi")
        return
    yield power_finding(run("vcgencmd", "get_throttled") or "")


def power_finding(printed: str) -> Finding:
    """What `vcgencmd get_throttled` printed, such as "throttled=0x50005", in words."""
    name, _, number = printed.strip().partition("=")
    try:
        bits = int(number, 16) if name == "throttled" else None
    except ValueError:
        bits = None
    if bits is None:
        return Finding("power", Verdict.WARNING, f"vcgencmd gives no answer ({printed.strip()[:60]!r})")
    troubles = [text for bit, text in _THROTTLED.items() if bits >> bit & 1]
    if not troubles:
        return Finding("power", Verdict.OK, "never throttled since the start")
    now = any(bits >> bit & 1 for bit in range(4))
    mend = "use a 5 V supply or power bank of 2.5 A or more with a short cable; let air to the processor"
    return Finding("power", Verdict.FAILED if now else Verdict.WARNING, ", ".join(troubles), mend)


def check_clock(now_s: float | None = None) -> Iterator[Finding]:
    """The date. Control goes by the monotonic clock, so a wrong date spoils the dates of results only."""
    date = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(time.time() if now_s is None else now_s))
    mend = "sudo timedatectl set-ntp true, or without internet: sudo date -s 'YYYY-MM-DD HH:MM'"
    if int(date[:4]) < _YOUNGEST_YEAR:
        yield Finding("clock", Verdict.WARNING, f"{date} is long ago (a Pi has no clock of its own)", mend)
        return
    synchronised = (run("timedatectl", "show", "-p", "NTPSynchronized", "--value") or "").strip()
    if synchronised == "no":
        yield Finding("clock", Verdict.WARNING, f"{date}, not synchronised", mend)
    else:
        yield Finding("clock", Verdict.OK, date + (", synchronised" if synchronised == "yes" else ""))
