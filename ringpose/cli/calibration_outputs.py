"""Files that the calibrating commands write."""

from pathlib import Path


def refuse_existing_outputs(output: Path, report: Path | None, force: bool) -> None:
    """Before long work: refuse what exists already, and a report that nothing can draw."""
    from ringpose.files.atomic import refuse_existing
    from ringpose.report.requirement import require_matplotlib

    refuse_existing(output, force)
    if report is not None:
        require_matplotlib()
        refuse_existing(report, force)
