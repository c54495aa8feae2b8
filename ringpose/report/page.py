"""A self-contained HTML page of text, tables and pictures, without external resources.

Pictures are drawn by matplotlib (extra `report`) in `figures`, which is imported only for a report: this module must
be importable without matplotlib.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.util import find_spec
from math import isfinite, isnan
from string import Template

from ringpose.errors import UsageError
from ringpose.types.calibration import Grade, Verdict
from ringpose.types.table import Table


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """A picture with a caption that explains it."""

    png: bytes
    caption: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Section:
    """A part of the page."""

    title: str
    text: Sequence[str] = ()
    """Paragraphs."""
    points: Sequence[str] = ()
    """Items of a numbered list."""
    table: Table | None = None
    pictures: Sequence[Picture] = ()


def page(title: str, sections: Sequence[Section]) -> str:
    """The complete page."""
    body = "\n".join(_section(section) for section in sections)
    return _PAGE.substitute(title=escape(title), body=body)


_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>$title</title>
<style>
body { font: clamp(15px, .75vw, 22px)/1.45 sans-serif; color: #222; max-width: 72em; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #ccc; break-after: avoid; }
p { overflow-wrap: anywhere; } .wide, figure { overflow-x: auto; }
table { border-collapse: collapse; }
td, th { padding: .15em .8em; text-align: right; border-bottom: 1px solid #e4e4e4; }
td:first-child, th:first-child { text-align: left; } th { font-weight: 600; }
.good { color: #17692c; } .can-be-improved { color: #9a6700; } .redo { color: #b3261e; }
ol { padding-left: 1.4em; } figure { margin: 1em 0; } img { max-width: 100%; } figcaption { color: #555; }
@media (max-width: 700px) { figure img { max-width: none; width: 700px; } }
</style>
</head>
<body>
<h1>$title</h1>
$body
</body>
</html>
""")


def _section(section: Section) -> str:
    parts = [f"<h2>{escape(section.title)}</h2>"]
    parts += [f"<p>{escape(paragraph)}</p>" for paragraph in section.text]
    if section.points:
        parts += ["<ol>", *(f"<li>{escape(point)}</li>" for point in section.points), "</ol>"]
    parts += [_table(section.table)] if section.table is not None else []
    parts += [_figure(picture) for picture in section.pictures]
    return "\n".join(parts)


def _table(table: Table) -> str:
    head = "".join(f"<th>{escape(heading)}</th>" for heading in table.headings)
    rows = ["".join(_cell(str(cell)) for cell in row) for row in table.rows]
    return "\n".join(['<div class="wide"><table>', *(f"<tr>{cells}</tr>" for cells in (head, *rows)), "</table></div>"])


def _cell(text: str) -> str:
    """A cell; a grade has its colour, by a class of its name."""
    grade = f' class="{text.replace(" ", "-")}"' if text in tuple(Grade) else ""
    return f"<td{grade}>{escape(text)}</td>"


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    caption = escape(picture.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )


def require_matplotlib() -> None:
    """Reject a report, before any computation, if matplotlib is not installed."""
    if find_spec("matplotlib") is None:
        raise UsageError("--report", "matplotlib is not installed", "pip install 'ringpose[report]'")


def verdict_section(verdict: Verdict) -> Section:
    """Grade, advice, and every number beside its limits."""
    rows = []
    for finding in verdict.findings:
        numbers = (finding.value, finding.pass_limit, finding.fail_limit)
        cells = ("unknown" if isnan(number) else f"{number:.4g}" if isfinite(number) else "none" for number in numbers)
        rows.append([f"{finding.place} {finding.name}".strip(), *cells, str(finding.grade)])
    headings = ("quantity", "value", "good limit", "redo limit", "grade")
    table = Table(headings=headings, rows=rows)
    return Section(title=f"Verdict: {verdict.grade}", points=verdict.advice, table=table)
