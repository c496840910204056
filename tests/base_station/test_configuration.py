"""Settings from a TOML file: what it says is taken, what it says wrong is named with what would be right."""

from __future__ import annotations

import dataclasses
import tomllib
from pathlib import Path
from typing import Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from base_station.configuration import as_toml, config_file, read_settings
from base_station.errors import StationError
from base_station.run_command import Run


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """One setting of each kind that a command may have."""

    config: Path | None = None
    print_config: bool = False
    name: str = "z"
    target_width_m: float | None = None
    count: int | None = None
    on: bool = True
    file: Path | None = None
    memory: Path = Path("landmarks.npz")
    how: Literal["fast", "slow"] = "slow"


def read(tmp_path: Path, text: str) -> Settings:
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    return read_settings(path, Settings, "run")


def test_keys_are_the_flags_names(tmp_path):
    """With - or _, at the top or in the command's table; a whole number is a number too."""
    found = read(tmp_path, 'name = "slam"\ntarget-width-m = 1\n[run]\ncount = 3\non = false\nhow = "fast"\n')
    assert found == Settings(name="slam", target_width_m=1.0, count=3, on=False, how="fast")
    assert read(tmp_path, "target_width_m = 0.2").target_width_m == 0.2
    assert read(tmp_path, "") == Settings()


def test_paths_are_relative_to_the_file(tmp_path):
    """Those to files, and that of a tracker of one's own; a tracker's name is no path."""
    found = read(tmp_path, 'file = "out/x.csv"\nname = "mine.py:Tracker"\nmemory = "/kept/l.npz"')
    assert found.file == tmp_path / "out/x.csv"
    assert found.name == f"{tmp_path}/mine.py:Tracker"
    assert found.memory == Path("/kept/l.npz")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("\n\nnmae = 1", ["robot.toml, line 3: there is no setting 'nmae'; did you mean 'name'?"]),
        ("colour = 1", ["no setting 'colour'; there are name, target-width-m, count"]),
        ("[rnu]\nname = 1", ["line 1: there is no table 'rnu'; did you mean 'run'?"]),
        ("[run]\nrun = 1", ["line 1: there is no setting 'run'; there are name"]),
        ("name = 5", ["line 1: name must be text in quotes", "not 5"]),
        ("on = 1", ["on must be true or false, not 1"]),
        ("count = 1.5", ["count must be a whole number, not 1.5"]),
        ("count = true", ["count must be a whole number, not true"]),
        ("target-width-m = '2'", ['target-width-m must be a number, not "2"']),
        ("target-width-m = nan", ["target-width-m must be a number"]),
        ("file = [1]", ["file must be a path in quotes"]),
        ("how = 'swift'", ['how must be one of "fast", "slow", not "swift"']),
        ("name = 'a'\n[run]\nname = 'b'", ["'name' is set twice"]),
        ("config = 'other.toml'", ["'config' can be a flag only"]),
        (r'file = "a\u0000b"', ["file must be text without a zero byte"]),
        ("name = ", ["is no TOML"]),
        ("a = " + "[" * 100_000, ["is no TOML"]),
    ],
    ids=lambda value: value.strip()[:20] if isinstance(value, str) else "",
)
def test_a_mistake_is_named(tmp_path, text, said):
    with pytest.raises(StationError) as caught:
        read(tmp_path, text)
    assert caught.value.usage
    for words in said:
        assert words in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    for path in (tmp_path / "missing.toml", tmp_path):
        with pytest.raises(StationError, match=f"{path.name} cannot be read"):
            read_settings(path, Settings, "run")
    binary = tmp_path / "robot.toml"
    binary.write_bytes(b"\xff\xfe")
    with pytest.raises(StationError, match="UTF-8"):
        read_settings(binary, Settings, "run")
    with pytest.raises(StationError, match="too large"):  # it never ends
        read_settings(Path("/dev/zero"), Settings, "run")


def test_the_mark_that_some_editors_begin_a_file_with_is_no_mistake(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_bytes(b"\xef\xbb\xbfname = 'slam'")
    assert read_settings(path, Settings, "run").name == "slam"


texts = st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"))
"""What a flag can hold: no zero byte."""


@given(
    settings=st.builds(
        Settings,
        name=texts.filter(lambda text: ".py:" not in text),
        target_width_m=st.none() | st.floats(allow_nan=False, allow_infinity=False),
        count=st.none() | st.integers(-(2**62), 2**62),
        on=st.booleans(),
        file=st.none() | st.builds(Path, st.just("/a"), texts.filter(lambda text: "/" not in text and text != "..")),
        how=st.sampled_from(("fast", "slow")),
    )
)
def test_what_is_printed_is_read_back(tmp_path_factory, settings):
    path = tmp_path_factory.getbasetemp() / "printed.toml"
    path.write_text(as_toml(settings, "run"), encoding="utf-8", newline="")
    assert read_settings(path, Settings, "run") == settings


def test_every_setting_of_run_can_be_printed_and_said():
    """A new flag of a type that files cannot say fails here; its default stands in a comment."""
    printed = as_toml(Run(), "run")
    assert tomllib.loads(printed) == {"run": {}}
    for field in dataclasses.fields(Run):
        said = f"# {field.name.replace('_', '-')} " in printed
        assert said == (field.name not in ("config", "print_config"))


def test_the_file_is_found_among_the_arguments():
    assert config_file(["--port", "1", "--config", "a.toml"]) == Path("a.toml")
    assert config_file(["--config=a.toml", "--config", "b.toml"]) == Path("b.toml")
    assert config_file(["--config"]) is None
    assert config_file([]) is None
