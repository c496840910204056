"""Settings from a TOML file (`--config robot.toml`): the flags' names as keys, checked before anything is opened.

A file's settings take the place of a command's defaults, so flags override them. Keys may stand at the top or in the
table of the command (`[run]`); `-` and `_` mean the same. Relative paths are relative to the file's folder.
"""

from __future__ import annotations

import dataclasses
import difflib
import itertools
import json
import math
import os
import re
import tomllib
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from base_station.errors import StationError

MOST_BYTES = 1 << 20
NOT_IN_A_FILE = ("config", "print_config")
"""What only flags can say."""
OWN_CODE = re.compile(r".+\.py:[A-Za-z_]\w*")
"""A tracker of one's own is named by its file: a path too."""

KINDS: dict[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: 'text in quotes, such as "abc"',
    Path: 'a path in quotes, such as "folder/file"',
}

Settings = TypeVar("Settings")


def config_file(arguments: Sequence[str]) -> Path | None:
    """What --config names among these arguments, the last one where there are several; None without it."""
    found = None
    for flag, following in itertools.zip_longest(arguments, arguments[1:]):
        if flag == "--":
            break
        if flag == "--config" and following is not None:
            found = Path(following)
        elif flag.startswith("--config="):
            found = Path(flag.removeprefix("--config="))
    return found


def read_settings(path: Path, kind: type[Settings], table: str) -> Settings:
    """The defaults of `kind` (a dataclass of settings) with what the file says instead. `table`: the command's name.

    Raises StationError, naming file, line and what would be right.
    """
    text = _text(path)
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise StationError(f"{path} is no TOML: {error}.", usage=True) from error
    hints = _types(kind)
    values: dict[str, Any] = {}
    for key, value in _entries(document, table):
        where = f"{path}{_line(text, key)}"
        name = key.replace("-", "_")
        if name not in hints:
            raise StationError(f"{where}: {_unknown(key, value, [*map(_flag, hints)], table)}", usage=True)
        if name in values:
            raise StationError(f"{where}: {_flag(name)!r} is set twice.", usage=True)
        try:
            values[name] = _checked(value, hints[name], path.parent)
        except ValueError as error:
            raise StationError(f"{where}: {_flag(name)} must be {error}, not {_shown(value)}.", usage=True) from None
    return kind(**values)


def as_toml(settings: Any, table: str) -> str:
    """The settings as a file that `read_settings` reads back. What is at its default stands in a comment."""
    lines = [f"[{table}]"]
    for field in dataclasses.fields(settings):
        if field.name in NOT_IN_A_FILE:
            continue
        value = getattr(settings, field.name)
        if value != field.default:
            lines.append(f"{_flag(field.name)} = {_literal(value)}")
        elif value is None:
            lines.append(f"# {_flag(field.name)} is not set")
        else:
            lines.append(f"# {_flag(field.name)} = {_literal(value, moved=False)}")
    return "\n".join(lines) + "\n"


def _text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(MOST_BYTES + 1)
        if len(data) > MOST_BYTES:
            raise StationError(f"{path} is too large for settings.", usage=True)
        return data.decode("utf-8-sig")  # some editors begin a file with a mark
    except OSError as error:
        raise StationError(f"--config {path} cannot be read ({error.strerror}).", usage=True) from error
    except UnicodeDecodeError as error:
        raise StationError(f"{path} is no TOML: it is not in UTF-8.", usage=True) from error


def _types(kind: type) -> dict[str, Any]:
    return {name: hint for name, hint in typing.get_type_hints(kind).items() if name not in NOT_IN_A_FILE}


def _entries(document: Mapping[str, Any], table: str) -> Iterator[tuple[str, Any]]:
    for key, value in document.items():
        if key == table and isinstance(value, dict):
            yield from value.items()
        else:
            yield key, value


def _unknown(key: str, value: Any, settings: list[str], table: str) -> str:
    name = key.replace("_", "-")
    if name in map(_flag, NOT_IN_A_FILE):
        return f"{key!r} can be a flag only."
    is_table = isinstance(value, dict)
    close = difflib.get_close_matches(name, [table, *settings] if is_table else settings, 1)
    meant = (
        f"did you mean {close[0]!r}?" if close else f"there are {', '.join([f'[{table}]'] if is_table else settings)}."
    )
    return f"there is no {'table' if is_table else 'setting'} {key!r}; {meant}"


def _line(text: str, key: str) -> str:
    """Where the key stands, for a message. Empty where it is written in an unusual way."""
    written = re.compile(rf"""\s*\[?\s*["']?{re.escape(key)}["']?\s*[\]=.]""")
    numbers = [number for number, line in enumerate(text.splitlines(), 1) if written.match(line)]
    return f", line {numbers[0]}" if numbers else ""


def _checked(value: Any, hint: Any, folder: Path) -> Any:
    """The value as this type. Raises ValueError with what it should be."""
    wanted = _members(hint)
    choices = [choice for one in wanted if typing.get_origin(one) is typing.Literal for choice in typing.get_args(one)]
    if choices:
        if value not in choices:
            raise ValueError("one of " + ", ".join(map(_shown, choices)))
        return value
    if isinstance(value, str) and "\0" in value:
        raise ValueError("text without a zero byte")
    if Path in wanted and isinstance(value, str):
        return _moved(value, folder)
    if str in wanted and isinstance(value, str):
        return str(_moved(value, folder)) if OWN_CODE.fullmatch(value) else value
    if bool in wanted and isinstance(value, bool):
        return value
    if int in wanted and isinstance(value, int) and not isinstance(value, bool):
        return value
    if float in wanted and isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    raise ValueError(" or ".join(text for kind, text in KINDS.items() if kind in wanted))


def _members(hint: Any) -> tuple[Any, ...]:
    """The types that a setting may have, without None."""
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        return tuple(one for one in typing.get_args(hint) if one is not types.NoneType)
    return (hint,)


def _moved(text: str, folder: Path) -> Path:
    return folder / Path(text).expanduser()


def _shown(value: Any) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 40 else text[:37] + "..."


def _flag(name: str) -> str:
    return name.replace("_", "-")


def _literal(value: Any, *, moved: bool = True) -> str:
    """As TOML. Paths are made absolute where `moved`: the file may be kept in another folder."""
    if moved and (isinstance(value, Path) or (isinstance(value, str) and OWN_CODE.fullmatch(value))):
        value = os.path.abspath(value)
    if isinstance(value, bool | int | float):
        return json.dumps(value)
    return json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")
