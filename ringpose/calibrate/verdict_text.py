"""A calibration's verdict as keys of a file and as lines of text."""

from typing import Any

from ringpose.types.calibration import Check, Grade, Verdict


def verdict_values(verdict: Verdict) -> dict[str, Any]:
    """The key `verdict` of a calibration file: grade, advice, every value with its limits."""
    findings = []
    for finding in verdict.findings:
        values: dict[str, Any] = {"place": finding.place} if finding.place else {}
        limits = {"good_limit": finding.pass_limit, "redo_limit": finding.fail_limit}
        findings.append(
            values | {"name": finding.name, "value": finding.value} | limits | {"grade": str(finding.grade)}
        )
    return {"grade": str(verdict.grade), "advice": list(verdict.advice), "findings": findings}


def verdict_lines(verdict: Verdict) -> list[str]:
    """Lines of text: the grade with the values that are not good, then the advice."""
    poor = [finding for finding in verdict.findings if finding.grade is not Grade.GOOD]
    reasons = "; ".join(finding_text(finding) for finding in poor) or "every number is within its limit"
    return [f"verdict: {verdict.grade}: {reasons}", *(f"advice: {sentence}" for sentence in verdict.advice)]


def finding_text(finding: Check) -> str:
    """A check as text: `left held_out_rms_m 0.0004 (limit 0.0002)`."""
    place = f"{finding.place} " if finding.place else ""
    value = "unknown" if finding.value != finding.value else f"{finding.value:.4g}"
    return f"{place}{finding.name} {value} (limit {finding.pass_limit:.4g})"
