"""Failures of the station that a person can mend."""

EXIT_INTERRUPTED = 130
"""As a shell says it of Ctrl-C (128 and the signal's number): what was asked for is not there."""


class StationError(Exception):
    """The text is what happened, then what to do. `usage` marks a mistake on the command line (exit code 2)."""

    def __init__(self, text: str, *, usage: bool = False) -> None:
        super().__init__(text)
        self.usage = usage


def never_learned(target: object) -> StationError:
    """Of a target that no frame let learn."""
    return StationError(f"The target {target} was never learned: it must lie in the picture and have texture.")


def counted(number: int, one: str, several: str = "") -> str:
    """ "1 picture", "2 pictures"."""
    return f"{number} {one if number == 1 else several or one + 's'}"
