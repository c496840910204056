"""Everything of the agent but its two simulated worlds loads with what a Raspberry Pi has, and alone."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SIMULATED = ("sim", "playground")
"""Folders and modules of these names need MuJoCo."""
NOT_ON_A_PI = ("mujoco", "numba", "scipy", "tyro", "rich")


def test_everything_but_the_simulated_worlds_loads() -> None:
    """Each module by its name; nothing that is not in Debian's packages comes along."""
    paths = [
        path.relative_to(ROOT) for package in ("protocol", "robot_agent") for path in (ROOT / package).rglob("*.py")
    ]
    kept = [path for path in paths if not set(path.with_suffix("").parts) & set(SIMULATED) and path.stem != "__main__"]
    modules = sorted(".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in kept)
    assert len(modules) > 25, modules
    code = (
        f"import importlib, sys\nfor name in {modules!r}: importlib.import_module(name)\n"
        f"print(*[name for name in {NOT_ON_A_PI!r} if name in sys.modules])"
    )
    finished = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout.split() == []


def test_the_command_line_loads_no_opencv() -> None:
    """Debian's takes 130 MiB: only cameras and recordings that need it load it."""
    code = "import sys, robot_agent.cli\nprint('cv2' in sys.modules)"
    finished = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert finished.stdout == "False\n", finished.stderr
