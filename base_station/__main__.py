"""The command base-station; also python -m base_station."""

import signal
import sys


def main() -> int:
    """Returns the exit code."""
    interrupted = signal.getsignal(signal.SIGINT)
    if interrupted is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # while the program loads, Ctrl-C ends it without a word
    try:
        from base_station.cli import main as command
    except ModuleNotFoundError as error:
        how = "run scripts/setup, then .venv/bin/base-station."
        sys.exit(f"base-station: {error.name} is not installed for this Python: {how}")
    signal.signal(signal.SIGINT, interrupted)
    return command()


if __name__ == "__main__":
    sys.exit(main())
