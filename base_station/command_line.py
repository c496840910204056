"""Reads a command line: which command, with which settings; and says in one sentence what was mistyped.

tyro does the reading, of one command alone: what it says is then about this command and not about its neighbours.
"""

from __future__ import annotations

import dataclasses
import difflib
import types
import typing
from collections.abc import Iterator, Sequence
from typing import Any

import tyro

from base_station.errors import StationError

CONFIG = (tyro.conf.OmitSubcommandPrefixes, tyro.conf.OmitArgPrefixes)


def read_settings_of(kind: type, arguments: Sequence[str], prog: str, **options: Any) -> Any:
    """The settings of this kind (a dataclass) out of a command's arguments. `prog`: the command with its program;
    `options`: more for tyro.

    Raises StationError, a mistake of usage, for an option that there is not; SystemExit after help and after a value
    that is none: tyro has told it.
    """
    actions = _actions(kind)
    if arguments and arguments[0] in actions:
        prog_of_action = f"{prog} {arguments[0]}"
        flags = [*_flags(kind), *_flags(actions[arguments[0]])]
    elif actions and arguments and not arguments[0].startswith("-"):
        raise no_command(arguments[0], list(actions), prog)
    else:
        prog_of_action = prog
        flags = [*_flags(kind), *(flag for action in actions.values() for flag in _flags(action))]
    for argument in arguments:
        if argument == "--":
            break
        flag = argument.partition("=")[0].replace("_", "-")
        if flag.startswith("--") and flag not in (*flags, "--help"):
            raise StationError(_no_option(argument, flags, prog_of_action), usage=True)
    found, unknown = tyro.cli(
        kind, prog=prog, args=list(arguments), config=CONFIG, return_unknown_args=True, **options
    )  # fmt: skip
    if unknown and unknown[0].startswith("-"):
        raise StationError(_no_option(unknown[0], flags, prog_of_action), usage=True)
    if unknown:
        raise StationError(f"{unknown[0]!r} is too much here. {prog_of_action} --help tells what there is.", usage=True)
    return found


def no_command(name: str, commands: Sequence[str], prog: str) -> StationError:
    """There is none of this name."""
    if name.startswith("-"):
        return StationError(
            f"Name a command before {name}: {', '.join(commands)}. {prog} --help tells more.", usage=True
        )
    close = difflib.get_close_matches(name, commands, 1)
    meant = f"did you mean {close[0]}?" if close else f"there are {', '.join(commands)}."
    return StationError(f"There is no command {name!r}; {meant} {prog} --help tells more.", usage=True)


def _no_option(argument: str, flags: Sequence[str], prog: str) -> str:
    name = argument.partition("=")[0]
    close = difflib.get_close_matches(name.replace("_", "-"), flags, 1)
    meant = f"; did you mean {close[0]}?" if close else "."
    return f"There is no option {name}{meant} {prog} --help lists them."


def _flags(kind: type) -> Iterator[str]:
    """The long options of a dataclass of settings, and of those within it."""
    for name, hint in typing.get_type_hints(kind, include_extras=True).items():
        plain, notes = _bare(hint)
        if dataclasses.is_dataclass(plain):
            yield from _flags(typing.cast(type, plain))
        elif tyro.conf.Positional not in notes and not _members(plain):
            flag = "--" + name.replace("_", "-")
            yield flag
            if plain is bool:
                yield flag.replace("--", "--no-", 1)


def _actions(kind: type) -> dict[str, type]:
    """By name, if this command is one of several: `calibrate live`, `calibrate board`."""
    found = {}
    for hint in typing.get_type_hints(kind, include_extras=True).values():
        for member in _members(_bare(hint)[0]):
            plain, notes = _bare(member)
            names = [note.name for note in notes if getattr(note, "name", None)]
            found[names[0] if names else plain.__name__.lower()] = plain
    return found


def _members(hint: Any) -> list[Any]:
    """Of a choice between dataclasses."""
    if typing.get_origin(hint) not in (typing.Union, types.UnionType):
        return []
    return [member for member in typing.get_args(hint) if dataclasses.is_dataclass(_bare(member)[0])]


def _bare(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """A type, and what it was annotated with."""
    if typing.get_origin(hint) is typing.Annotated:
        plain, *notes = typing.get_args(hint)
        return plain, tuple(notes)
    return hint, ()
