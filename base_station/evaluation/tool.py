"""A benchmark as a command of its own: options in, exit code out, and what went wrong in one sentence."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

import tyro

from base_station.errors import EXIT_INTERRUPTED, StationError

Options = TypeVar("Options")


def run_tool(
    kind: type[Options],
    prog: str,
    arguments: Sequence[str] | None,
    run: Callable[[Options, Sequence[str]], None],
) -> int:
    """Parse `arguments` (None: the command line's) into options of this dataclass and call `run` with both.

    Returns the exit code: 0 done, 1 failed, 2 wrong usage, 130 interrupted.
    """
    try:
        options = tyro.cli(kind, prog=prog, args=arguments, config=(tyro.conf.OmitArgPrefixes,))
    except SystemExit as end:  # after --help, or after having said what was wrong
        return 2 if end.code else 0
    try:
        run(options, sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt:
        print(f"{prog}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except (StationError, OSError) as error:
        print(f"{prog}: {error}", file=sys.stderr)
        return 2 if isinstance(error, StationError) and error.usage else 1
    return 0
