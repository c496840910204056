"""What is this robot's own and outlives the agent: a JSON file in the user's configuration folder."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

from robot_agent.errors import AgentError


@dataclass(frozen=True, kw_only=True)
class RobotSettings:
    """`trim`: right wheel's speed over left's at equal targets, 0.5..2."""

    trim: float = 1.0


def settings_path() -> Path:
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "zservo" / "robot.json"


def load_robot_settings() -> RobotSettings:
    try:
        return RobotSettings(**json.loads(settings_path().read_text(encoding="utf-8")))
    except FileNotFoundError:
        return RobotSettings()
    except (OSError, ValueError, TypeError) as error:
        raise AgentError(f"{settings_path()} cannot be read ({error}): mend or delete it.") from error


def save_robot_settings(settings: RobotSettings) -> None:
    settings_path().parent.mkdir(parents=True, exist_ok=True)
    settings_path().write_text(json.dumps(asdict(settings)), encoding="utf-8")
