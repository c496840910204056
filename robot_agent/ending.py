"""How the agent's commands end: their exit codes, and the signals that ask them to."""

from __future__ import annotations

import signal
from collections.abc import Callable
from types import FrameType

from robot_agent.errors import AgentError, UsageError

EXIT_DONE, EXIT_FAILED, EXIT_USAGE = 0, 1, 2
END_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def exit_code(error: AgentError) -> int:
    """That of a command which this error ended."""
    return EXIT_USAGE if isinstance(error, UsageError) else EXIT_FAILED


def on_end_signals(act: Callable[[], None]) -> None:
    """From now on a signal that asks this program to end calls `act`. Only in the main thread."""

    def take(_number: int, _frame: FrameType | None) -> None:
        act()

    for number in END_SIGNALS:
        signal.signal(number, take)


def interrupt() -> None:
    """Act on a signal where nothing moves: end what is being done, as Ctrl-C does. Raises KeyboardInterrupt."""
    raise KeyboardInterrupt
