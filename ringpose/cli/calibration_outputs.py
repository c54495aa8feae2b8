"""What the calibrating commands write and say."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ringpose.types.verdict import Verdict


def refuse_existing_outputs(output: Path, report: Path | None, force: bool, read: Iterable[Path]) -> None:
    """Before long work: refuse what exists already or is read, and a report that nothing can draw."""
    from ringpose.errors import UsageError
    from ringpose.files.atomic import refuse_existing, refuse_inputs
    from ringpose.report.page import require_matplotlib

    refuse_inputs((output, report), read)
    refuse_existing(output, force)
    if report is not None:
        if report.resolve() == output.resolve():
            raise UsageError("--report", f"{report} is the output, too", "give each its own file")
        require_matplotlib()
        refuse_existing(report, force)


def say_verdict(verdict: "Verdict", summary: Sequence[str], *, quiet: bool) -> int:
    """The summary on stderr, of which no wish for quiet hides that all is to be done again; the exit status."""
    from ringpose.calibrate.verdict_text import verdict_lines
    from ringpose.cli import messages
    from ringpose.errors import NO_POSE
    from ringpose.types.verdict import Grade

    bad = verdict.grade is Grade.REDO
    for line in verdict_lines(verdict)[:bad] if quiet else summary:
        messages.say(line)
    return NO_POSE if bad else 0
