"""What the doctor found, and how it is told: a line per part, with the one command that mends it below."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

from robot_agent.errors import AgentError


class Verdict(Enum):
    """OK: as it should be. WARNING: works, but look at it. FAILED: the robot will not follow with this. SKIPPED:
    nothing to look at here."""

    OK = "OK"
    WARNING = "warn"
    FAILED = "FAIL"
    SKIPPED = "-"


@dataclass(frozen=True)
class Finding:
    """One part: what it is, how it does, in words, and the one command (or deed) that mends it."""

    part: str
    verdict: Verdict
    said: str
    mend: str = ""


Check = Callable[[], Iterable[Finding]]


def examine(checks: Sequence[tuple[str, Check]], tell: Callable[[Finding], None]) -> list[Finding]:
    """Run the named checks one after the other and tell each finding as it comes. A check that fails is a finding."""
    found: list[Finding] = []
    for name, check in checks:
        try:
            for finding in check():
                found.append(finding)
                tell(finding)
        except AgentError as error:
            found.append(Finding(name, Verdict.FAILED, str(error)))
            tell(found[-1])
        except Exception as error:  # one part that cannot be looked at must not hide the others
            found.append(Finding(name, Verdict.FAILED, f"cannot be looked at ({type(error).__name__}: {error})"))
            tell(found[-1])
    return found


def line(finding: Finding) -> str:
    """A finding as text: one line, and one more where there is something to do."""
    text = f"{finding.verdict.value:>4}  {finding.part}: {finding.said}"
    return f"{text}\n        -> {finding.mend}" if finding.mend else text


def summary(findings: Sequence[Finding]) -> str:
    """How many of each, in one line."""
    count = {verdict: sum(finding.verdict is verdict for finding in findings) for verdict in Verdict}
    failed, warned = count[Verdict.FAILED], count[Verdict.WARNING]
    if failed:
        parts = ", ".join(dict.fromkeys(finding.part for finding in findings if finding.verdict is Verdict.FAILED))
        return f"{failed} to mend ({parts}), {warned} to look at, {count[Verdict.OK]} OK"
    return f"ready: {count[Verdict.OK]} OK, {warned} to look at"
