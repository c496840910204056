"""scripts/install-pi: what it says it will do, what it writes, and that a second time changes nothing. (Packages,
groups and systemd itself are not touched: those were tried by hand, in a chroot of Debian 12.)"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts/install-pi"
RULES = "etc/udev/rules.d/60-zservo-thymio.rules"
NETWORK = ("--allow", "192.168.0.0/24")

pytestmark = pytest.mark.skipif(shutil.which("systemd-escape") is None, reason="no systemd here")


def install(home: Path, *options: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run it with a home of its own."""
    environment = {"PATH": os.environ["PATH"], "HOME": str(home), **environment}
    return subprocess.run([SCRIPT, *options], env=environment, capture_output=True, text=True, check=False, timeout=60)


def files(*folders: Path) -> dict[str, str]:
    return {str(path): path.read_text() for folder in folders for path in folder.rglob("*") if path.is_file()}


def installed(tmp_path: Path, *options: str) -> dict[str, str]:
    """What it writes, by file name."""
    done = install(tmp_path / "home", "--no-packages", "--prefix", str(tmp_path / "root"), *options)
    assert done.returncode == 0, done.stderr
    return {Path(path).name: text for path, text in files(tmp_path).items()}


def test_dry_run_prints_every_step_and_does_nothing(tmp_path):
    done = install(tmp_path, "--dry-run", *NETWORK)
    assert done.returncode == 0, done.stderr
    for step in ("60-zservo-thymio.rules", "agent.env", "zservo-medulla.service", "zservo-agent.service"):
        assert f"{step}\n    | " in done.stdout
    for step in ("loginctl enable-linger", "systemctl --user daemon-reload", "systemctl --user enable"):
        assert step in done.stdout
    assert 'idVendor}=="0617"' in done.stdout
    assert not files(tmp_path)


def test_a_second_time_changes_nothing_and_keeps_your_options(tmp_path):
    first = installed(tmp_path, *NETWORK)
    assert sorted(first) == ["60-zservo-thymio.rules", "agent.env", "zservo-agent.service", "zservo-medulla.service"]
    assert "--listen 0.0.0.0 --allow 192.168.0.0/24\n" in first["agent.env"]
    mine = tmp_path / "home/.config/zservo/agent.env"
    mine.write_text("ROBOT_AGENT_OPTIONS=--robot none\n")
    again = installed(tmp_path, *NETWORK)
    assert again == first | {"agent.env": "ROBOT_AGENT_OPTIONS=--robot none\n"}
    done = install(tmp_path / "home", "--no-packages", "--prefix", str(tmp_path / "root"), *NETWORK)
    assert "write" not in done.stdout
    assert done.stdout.count("is in place") == 3


def test_without_a_network_to_allow_the_agent_stays_on_the_loopback(tmp_path):
    assert "--listen 127.0.0.1\n" in installed(tmp_path)["agent.env"]


def verify(folder: Path) -> subprocess.CompletedProcess[str]:
    units = sorted(str(path) for path in folder.glob("*.service"))
    assert units
    return subprocess.run(
        ["systemd-analyze", "verify", "--user", *units],
        env=os.environ | {"XDG_RUNTIME_DIR": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


@pytest.mark.skipif(shutil.which("asebamedulla") is None, reason="no asebamedulla here")
@pytest.mark.parametrize("serial", ["/dev/thymio", "/dev/serial/by-id/usb-Mobsya_Thymio-II"])
def test_systemd_accepts_the_units(tmp_path, serial):
    installed(tmp_path, "--serial", serial)
    units = tmp_path / "home/.config/systemd/user"
    good = verify(units)
    assert good.returncode == 0, good.stderr
    assert "Unknown" not in good.stderr
    medulla = (units / "zservo-medulla.service").read_text()
    assert f'"ser:device={serial}"' in medulla
    assert "@" not in medulla.replace("@system", "")
    (units / "zservo-medulla.service").write_text(medulla.replace("/usr/bin/asebamedulla", "/usr/bin/no-such-program"))
    assert verify(units).returncode != 0, "a check that cannot fail is none"


def test_a_robot_that_goes_takes_asebamedulla_with_it(tmp_path):
    """asebamedulla itself neither ends nor looks for its robot again."""
    lines = installed(tmp_path)["zservo-medulla.service"].splitlines()
    assert {"BindsTo=dev-thymio.device", "After=dev-thymio.device", "WantedBy=dev-thymio.device"} <= set(lines)


@pytest.mark.parametrize(
    ("release", "said"),
    [("ID=fedora\nVERSION_ID=40\n", "for Raspberry Pi OS and Debian"), ('ID=debian\nVERSION_ID="10"\n', "too old")],
)
def test_another_system_is_refused_politely(tmp_path, release, said):
    (tmp_path / "os-release").write_text(release)
    refused = install(tmp_path, "--dry-run", ZSERVO_OS_RELEASE=str(tmp_path / "os-release"))
    assert refused.returncode == 1
    assert said in refused.stderr
    assert refused.stdout == ""


@pytest.mark.parametrize(
    "options",
    [
        ("--turbo",),
        ("--allow",),
        ("--allow", "everybody"),
        ("--camera", "webcam"),
        ("--serial", "/dev/x; reboot"),
        ("--serial", "ttyACM0"),
    ],
)
def test_wrong_usage(tmp_path, options):
    wrong = install(tmp_path, "--dry-run", *options)
    assert wrong.returncode == 2
    assert wrong.stderr
    assert not files(tmp_path)


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="no shellcheck here")
def test_shellcheck_finds_nothing():
    checked = subprocess.run(["shellcheck", SCRIPT], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout
