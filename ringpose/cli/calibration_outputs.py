"""Files that the calibrating commands write."""

from pathlib import Path


def refuse_existing_outputs(output: Path, report: Path | None, force: bool) -> None:
    """Before long work: refuse what exists already, and a report that nothing can draw."""
    from ringpose.errors import UsageError
    from ringpose.files.atomic import refuse_existing
    from ringpose.report.requirement import require_matplotlib

    refuse_existing(output, force)
    if report is not None:
        if report.resolve() == output.resolve():
            raise UsageError("--report", f"{report} is the output, too", "give each its own file")
        require_matplotlib()
        refuse_existing(report, force)
