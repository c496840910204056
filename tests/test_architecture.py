"""The shape of the code base: who may import whom, what is loaded lazily, what a file may say."""

from __future__ import annotations

import ast
import fnmatch
import os
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OURS = ("protocol", "robot_agent", "base_station")
NOT_PRODUCTION = ("tests", "scripts")
TOP_LEVEL_FOLDERS = {".ci", "base_station", "protocol", "robot_agent", "scripts", "tests"}
OPTIONAL = {
    "mujoco": "robot_agent/sim/engine.py",
    "picamera2": "robot_agent/cameras/picamera2.py",
    "dbus": "robot_agent/robots/aseba.py",
    "gi": "robot_agent/robots/aseba.py",
    "zeroconf": ("base_station/discovery.py", "robot_agent/announce.py"),
    "ifaddr": "robot_agent/announce.py",
    "matplotlib": "base_station/evaluation/thesis/plotting.py",
    "pycolmap": "base_station/trackers/slam/libraries.py",
    "gtsam": "base_station/trackers/slam/libraries.py",
    "foxglove": "base_station/recording/foxglove_file.py",
    "mcap": "base_station/recording/mcap_file.py",
    "nicegui": "base_station/console/web.py",
    "fastapi": "base_station/console/web.py",
    "uvicorn": "base_station/console/web.py",
}
"""Heavy or optional modules, each imported in one place of a package at the most, lazily."""
LONGEST_MODULE_LINES = 600


@dataclass(frozen=True)
class Import:
    """One imported module. `lazy`: not when the importing module is loaded."""

    module: str
    lazy: bool


@cache
def our_files() -> tuple[Path, ...]:
    """Every file of the checkout but those that .gitignore names."""
    ignored = [line.rstrip("/") for line in (ROOT / ".gitignore").read_text(encoding="utf-8").split()] + [".git"]

    def kept(name: str) -> bool:
        return not any(fnmatch.fnmatch(name, pattern) for pattern in ignored)

    found = []
    for folder, subfolders, names in os.walk(ROOT):
        subfolders[:] = filter(kept, subfolders)
        found += [Path(folder, name) for name in filter(kept, names)]
    return tuple(sorted(found))


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def modules_under(*folders: str) -> list[Path]:
    """Python files in these folders (or a single file), which must exist."""
    found = [
        path
        for path in our_files()
        if path.suffix == ".py" and any(path.is_relative_to(ROOT / folder) for folder in folders)
    ]
    assert found, f"nothing in {folders}: has it been renamed?"
    return found


def imports_of(source: str, package: str = "") -> list[Import]:
    """Every module that the source imports, in functions and under TYPE_CHECKING too, and by importlib by name.

    `from a import b` counts as a and as a.b, because b may be a module. `package` resolves relative imports.
    """
    tree = ast.parse(source)
    at_top = set()
    pending: list[ast.AST] = [tree]
    while pending:
        node = pending.pop()
        at_top.add(node)
        if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)):
            pending.extend(ast.iter_child_nodes(node))
    found: list[Import] = []
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = package.split(".")
                base = ".".join([*parts[: len(parts) - node.level + 1], *([base] if base else [])])
            names = [base, *(f"{base}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = ast.unparse(node.func).rpartition(".")[2]
            if called in ("import_module", "__import__") and isinstance(node.args[0].value, str):
                names = [node.args[0].value]
        found += [Import(name, lazy=node not in at_top) for name in names]
    return found


@cache
def imports_in(path: Path) -> tuple[Import, ...]:
    package = ".".join(path.relative_to(ROOT).parent.parts)
    return tuple(imports_of(path.read_text(encoding="utf-8"), package))


def within(module: str, *packages: str) -> bool:
    return any(module == package or module.startswith(package + ".") for package in packages)


def offences(folders: tuple[str, ...], forbidden: tuple[str, ...]) -> list[str]:
    return [
        f"{named(path)} imports {found.module}"
        for path in modules_under(*folders)
        for found in imports_in(path)
        if within(found.module, *forbidden)
    ]


def test_the_walk_sees_every_way_to_import():
    """Without this, a test below could pass because it sees nothing."""
    source = """
import a.b, c
from d import e
from . import f
from .g import h
from ..i import j
if True:
    import k
def lazily():
    import l
    importlib.import_module("m.n")
class Holds:
    import o
    def method(self):
        from p import q
"""
    found = imports_of(source, package="base_station.trackers")
    assert {one.module for one in found if not one.lazy} == {
        "a.b", "c", "d", "d.e", "base_station.trackers", "base_station.trackers.f", "base_station.trackers.g",
        "base_station.trackers.g.h", "base_station.i", "base_station.i.j", "k", "o",
    }  # fmt: skip
    assert {one.module for one in found if one.lazy} == {"l", "m.n", "p", "p.q"}
    assert within("base_station.link", "base_station")
    assert not within("base_stationary", "base_station")


@pytest.mark.parametrize(
    ("folders", "forbidden"),
    [
        (("protocol",), ("robot_agent", "base_station")),
        (("robot_agent",), ("base_station",)),
        (("base_station",), ("robot_agent",)),
        (OURS, NOT_PRODUCTION),
        (
            ("base_station/types.py", "base_station/geometry.py"),
            tuple(f"base_station.{name}" for name in ("trackers", "behaviours", "link", "sockets", "station", "cli")),
        ),
        (
            ("base_station/trackers",),
            tuple(f"base_station.{name}" for name in ("behaviours", "station", "link", "sockets", "display", "cli")),
        ),
        (
            ("base_station/behaviours",),
            tuple(f"base_station.{name}" for name in ("trackers", "station", "link", "sockets", "display", "cli")),
        ),
        (("base_station/link.py", "base_station/sockets.py"), ("base_station.trackers", "base_station.behaviours")),
        (("base_station/station.py",), ("base_station.cli", "base_station.display", "base_station.evaluation")),
        (
            ("base_station/watcher.py", "base_station/orders.py"),
            tuple(f"base_station.{name}" for name in ("behaviours", "station", "link", "sockets", "display", "cli")),
        ),
        (("base_station/station.py", "base_station/watcher.py", "base_station/kits.py"), ("base_station.recording",)),
        (("base_station/recording",), ("base_station.cli", "base_station.run_command", "base_station.console")),
        (
            ("base_station/console",),
            tuple(f"base_station.{name}" for name in ("trackers", "behaviours", "station", "watcher", "kits", "link",
            "sockets", "display", "cli", "evaluation", "landmark_shelf", "console_option", "publication.publisher",
            "publication.states", "publication.desk", "publication.service")),
        ),
        (("base_station/publication",), ("base_station.console", "base_station.cli", "base_station.link")),
        (("robot_agent/safety.py",), ("robot_agent", "protocol", "threading", "time", "socket")),
        (
            tuple(f"robot_agent/{name}" for name in ("cameras", "robots", "pantilt", "sim", "playground")),
            tuple(f"robot_agent.{name}" for name in ("agent", "options", "doctor", "cli")),
        ),
        (("robot_agent/doctor",), ("robot_agent.agent", "robot_agent.cli")),
    ],
    ids=lambda value: "+".join(value) if value and "." not in value[0] else None,
)  # fmt: skip
def test_import_direction(folders, forbidden):
    assert offences(folders, forbidden) == []


def test_protocol_needs_the_standard_library_and_msgpack_only_and_does_no_io():
    for path in modules_under("protocol"):
        for found in imports_in(path):
            root = found.module.split(".")[0]
            assert root in sys.stdlib_module_names | {"msgpack", "protocol"}, f"{named(path)} imports {found.module}"
    assert offences(("protocol",), ("socket", "threading", "asyncio", "select", "time", "multiprocessing")) == []


def test_only_the_command_line_knows_the_command_line():
    for package in ("robot_agent", "base_station"):
        importers = [
            path.name
            for path in modules_under(package)
            if any(within(found.module, f"{package}.cli") for found in imports_in(path))
        ]
        assert importers == ["__main__.py"]


@pytest.mark.parametrize("module", OPTIONAL)
def test_an_optional_module_is_imported_in_one_place_and_lazily(module):
    places = {}
    for path in modules_under(*OURS):
        for found in imports_in(path):
            if within(found.module, module):
                places.setdefault(named(path), []).append(found)
    assert all(found.lazy for uses in places.values() for found in uses), places
    expected = OPTIONAL[module]
    if expected is None:
        assert len(places) <= 1, places
    else:
        assert sorted(places) == sorted([expected] if isinstance(expected, str) else expected)


BLOCKED = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"No module named {name!r} (blocked by the test)", name=name)
BLOCKED = set(sys.argv[1].split(","))
sys.meta_path.insert(0, Blocker())
for module in sys.argv[2].split(","):
    __import__(module)
print("loaded")
"""


def loaded_without(blocked: str, modules: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", BLOCKED, blocked, modules], cwd=ROOT, capture_output=True, text=True, timeout=60
    )


def test_everything_loads_without_the_optional_modules():
    modules = "robot_agent,robot_agent.cli,robot_agent.rig,base_station,base_station.cli"
    finished = loaded_without(",".join(OPTIONAL), modules)
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout == "loaded\n"


def test_the_agent_loads_without_what_only_the_station_needs():
    finished = loaded_without("numba,tyro,rich,threadpoolctl,base_station", "robot_agent,robot_agent.cli")
    assert finished.returncode == 0, finished.stderr


def test_blocking_a_module_works_at_all():
    finished = loaded_without("zmq", "robot_agent.cli")
    assert finished.returncode == 1
    assert "blocked by the test" in finished.stderr


def test_a_missing_simulator_is_one_sentence_that_names_the_extra():
    call = "import robot_agent.cli; sys.exit(robot_agent.cli.main(['--robot', 'sim', '--port', '1']))"
    finished = subprocess.run(
        [sys.executable, "-c", BLOCKED + call, "mujoco", "robot_agent.cli"],
        cwd=ROOT, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert finished.returncode == 1
    assert "Traceback" not in finished.stderr
    assert "zservo[sim]" in finished.stderr.splitlines()[-1]


def test_top_level_folders_are_those_of_the_design():
    folders = {path.relative_to(ROOT).parts[0] for path in our_files() if len(path.relative_to(ROOT).parts) > 1}
    assert folders <= TOP_LEVEL_FOLDERS
    assert {"protocol", "robot_agent", "base_station", "scripts", "tests"} <= folders


def test_the_packages_that_are_installed_are_ours():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert settings["tool"]["setuptools"]["packages"]["find"]["include"] == [f"{package}*" for package in OURS]


def test_no_file_tells_of_the_machine_it_was_written_on():
    """Paths that exist on one machine only, and things that lie beside the checkout and are not part of it."""
    hints = re.compile(r"(?<![\w.])/(?:work|root)/|\.\./shared|/home/(?!pi\b)")
    found = []
    for path in our_files():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue  # a picture
        found += [
            f"{named(path)}:{number}: {line.strip()[:80]}"
            for number, line in enumerate(text.splitlines(), 1)
            if path != Path(__file__) and hints.search(line)
        ]
    assert found == []


@pytest.mark.parametrize("path", modules_under(*OURS), ids=named)
def test_a_module_says_what_it_is_for_and_is_not_too_long(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= LONGEST_MODULE_LINES
    docstring = ast.get_docstring(ast.parse(text))
    if path.name != "__init__.py" or text.strip():
        assert docstring, "no docstring"
        assert len(docstring) >= 20


def test_every_module_of_tests_says_what_it_proves():
    for path in modules_under("tests"):
        if path.name.startswith("test_"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            assert ast.get_docstring(tree), f"{named(path)} has no docstring"
