"""The settings of one robot: kept whole, and a file that a person broke is told in one sentence."""

from __future__ import annotations

import pytest

from robot_agent.errors import AgentError
from robot_agent.settings_file import RobotSettings, load_robot_settings, robot_settings_path, save_robot_settings


@pytest.fixture(autouse=True)
def config(tmp_path, monkeypatch):
    """A configuration folder of the test's own."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    return tmp_path


def test_what_is_saved_is_loaded(config):
    assert load_robot_settings() == RobotSettings(trim=1.0)
    path = save_robot_settings(RobotSettings(trim=1.02))
    assert path == robot_settings_path() == config / "zservo" / "robot.json"
    assert load_robot_settings() == RobotSettings(trim=1.02)
    save_robot_settings(RobotSettings(trim=0.97))
    assert load_robot_settings().trim == 0.97
    assert [entry.name for entry in path.parent.iterdir()] == ["robot.json"], "nothing else is left there"


def test_without_the_variable_it_is_in_the_home_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    for value in ("", "relative/folder"):
        monkeypatch.setenv("XDG_CONFIG_HOME", value)
        assert robot_settings_path() == tmp_path / ".config" / "zservo" / "robot.json"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"trim = 1.02", "no JSON"),
        (b"", "no JSON"),
        (b"\xff\xfe", "no JSON"),
        (b"[" * 60_000, "no JSON"),
        (b"[1.02]", "no JSON object"),
        (b'{"trim": 3}', "from 0.5 to 2, not 3"),
        (b'{"trim": 0.4}', "not 0.4"),
        (b'{"trim": NaN}', "not nan"),
        (b'{"trim": "1.02"}', "not '1.02'"),
        (b'{"trim": true}', "not True"),
        (b'{"trim": null}', "not None"),
        (b'{"tirm": 1.0}', "'tirm'"),
        (b'{"trim": 1.0}' + b" " * 70_000, "more than 65536 bytes"),
    ],
)
def test_a_broken_file_is_one_sentence(config, text, said):
    path = robot_settings_path()
    path.parent.mkdir()
    path.write_bytes(text)
    with pytest.raises(AgentError) as told:
        load_robot_settings()
    message = str(told.value)
    assert said in message and str(path) in message and "\n" not in message and len(message) < 400


def test_a_folder_that_cannot_be_made_is_told(config, monkeypatch):
    (config / "file").touch()
    monkeypatch.setenv("XDG_CONFIG_HOME", str(config / "file"))
    with pytest.raises(AgentError, match="cannot be written"):
        save_robot_settings(RobotSettings(trim=1.1))
    with pytest.raises(AgentError, match="cannot be read"):
        load_robot_settings()
