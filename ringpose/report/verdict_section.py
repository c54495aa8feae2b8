"""A verdict as a section of the page."""

from ringpose.report.page import Section, Table
from ringpose.types.verdict import Finding, Verdict


def verdict_section(verdict: Verdict) -> Section:
    """Grade, advice, and every number beside its limits."""
    return Section(
        title=f"Verdict: {verdict.grade}",
        points=verdict.advice,
        table=Table(
            headings=("quantity", "value", "good limit", "redo limit", "grade"),
            rows=[_row(finding) for finding in verdict.findings],
        ),
    )


def _row(finding: Finding) -> list[str]:
    limits = (finding.value, finding.good_limit, finding.redo_limit)
    return [f"{finding.place} {finding.name}".strip(), *map(_number, limits), str(finding.grade)]


def _number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < float("inf") else "none"
