"""What is true of this one robot and does not change from run to run: `~/.config/zservo/robot.json`.

The folder is `$XDG_CONFIG_HOME/zservo` where that is set. A person may write the file by hand, so it is checked in all
that it says; without a file the defaults hold.
"""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robot_agent.errors import AgentError

MIN_TRIM, MAX_TRIM = 0.5, 2.0
MAX_BYTES = 64 * 1024


@dataclass(frozen=True, kw_only=True)
class RobotSettings:
    """Raises AgentError when a value is out of range."""

    trim: float = 1.0
    """Speed of the right wheel over the left one's at equal targets; from 0.5 to 2."""

    def __post_init__(self) -> None:
        trim: Any = self.trim
        if isinstance(trim, bool) or not isinstance(trim, (int, float)) or not MIN_TRIM <= trim <= MAX_TRIM:
            raise AgentError(f"trim must be a number from {MIN_TRIM:g} to {MAX_TRIM:g}, not {trim!r:.40}")


def robot_settings_path() -> Path:
    """Where the settings are kept."""
    configured = os.environ.get("XDG_CONFIG_HOME", "")
    home = Path(configured) if os.path.isabs(configured) else Path.home() / ".config"
    return home / "zservo" / "robot.json"


def load_robot_settings() -> RobotSettings:
    """The settings of this robot; the defaults without a file. Raises AgentError, naming the file and what is wrong."""
    path = robot_settings_path()
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return RobotSettings()
    except OSError as error:
        raise AgentError(f"The robot's settings in {path} cannot be read ({error.strerror}).") from error
    try:
        return _checked(data)
    except AgentError as error:
        raise AgentError(f"The robot's settings in {path} are broken ({error}): mend or remove the file.") from error


def save_robot_settings(settings: RobotSettings) -> Path:
    """Keep these settings, whole or not at all; where they are. Raises AgentError when they cannot be written."""
    path = robot_settings_path()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, prefix=".robot", delete=False) as file:
            json.dump(dataclasses.asdict(settings), file, indent=2)
            file.write("\n")
        os.replace(file.name, path)
    except OSError as error:
        raise AgentError(f"The robot's settings cannot be written to {path} ({error.strerror}).") from error
    return path


def _checked(data: bytes) -> RobotSettings:
    if len(data) > MAX_BYTES:
        raise AgentError(f"it has more than {MAX_BYTES} bytes")
    try:
        values = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise AgentError(f"it is no JSON: {str(error)[:80]}") from error
    if not isinstance(values, dict):
        raise AgentError("it is no JSON object")
    known = [field.name for field in dataclasses.fields(RobotSettings)]
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise AgentError(f"it names {unknown[0]!r:.40}; there are {', '.join(known)}")
    return RobotSettings(**values)
