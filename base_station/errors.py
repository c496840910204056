"""Failures of the station that a person can mend."""


class StationError(Exception):
    """The text is what happened, then what to do. `usage` marks a mistake on the command line (exit code 2)."""

    def __init__(self, text: str, *, usage: bool = False) -> None:
        super().__init__(text)
        self.usage = usage
