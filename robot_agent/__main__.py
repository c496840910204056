"""The command robot-agent; also python -m robot_agent."""

import signal
import sys


def main() -> int:
    """Returns the exit code."""
    interrupted = signal.getsignal(signal.SIGINT)
    if interrupted is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # while the program loads, Ctrl-C ends it without a word
    from robot_agent.cli import main as command

    signal.signal(signal.SIGINT, interrupted)
    return command()


if __name__ == "__main__":
    sys.exit(main())
