#!/usr/bin/env python3
r"""The manual as HTML pages that link to each other: build.py OUTPUT_FOLDER; needs mandoc.

A comment `.\" figure: FILE: CAPTION` in a page places a picture, whose path is that from the top of the source tree;
`.\" equation: EQN` is the next line typeset, in the language of eqn(7).
"""

import html
import re
import shutil
import subprocess
import sys
from pathlib import Path

MANUAL = Path(__file__).parents[1]
ROOT = MANUAL.parent
FIRST = ("ringpose-quickstart.7", "ringpose-robot.7", "ringpose-troubleshooting.7")
GROUPS = (
    ("First steps", lambda page: page.name in FIRST),
    ("Commands", lambda page: page.suffix == ".1"),
    ("Files and records", lambda page: page.suffix == ".5"),
    ("Background", lambda page: page.suffix == ".7" and page.name not in FIRST),
)
FIGURE = re.compile(r'^\.\\" figure: (\S+): (.*)$', re.MULTILINE)
EQUATION = re.compile(r'^\.\\" equation: (.*)\n.*$', re.MULTILINE)
PICTURE_MARK = "PICTURE-GOES-HERE"


def body_of(page: Path) -> str:
    """What mandoc makes of a page, with its pictures, and links to pages of this manual only."""
    source = EQUATION.sub(r".EQ\n\1\n.EN", page.read_text(encoding="utf-8"))
    source = FIGURE.sub(f".Pp\n{PICTURE_MARK}\n.Pp", source)
    command = ["mandoc", "-T", "html", "-O", "fragment,man=%N.%S.html"]
    text = with_fences(subprocess.run(command, input=source, capture_output=True, text=True, check=True).stdout)  # noqa: S603
    for path, caption in FIGURE.findall(page.read_text(encoding="utf-8")):
        text = re.sub(rf'(<p class="Pp">)?{PICTURE_MARK}(</p>)?', figure(path, caption), text, count=1)
    pages = {f"{each.name}.html" for each in pages_of_manual()}
    return re.sub(
        r'<a class="Xr" href="([^"]*)">(.*?)</a>', lambda link: link[0] if link[1] in pages else link[2], text
    )


def with_fences(text: str) -> str:
    """Brackets as operators, since browsers no longer draw those of `mfenced`; only these stretch."""
    text = re.sub(r"<mo>([()\[\]])</mo>", r'<mo stretchy="false">\1</mo>', text)
    fences = re.compile(r'<mfenced open="([^"]*)" close="([^"]*)">((?:(?!<mfenced).)*?)</mfenced>', re.DOTALL)
    while fences.search(text):  # the innermost first
        text = fences.sub(r"<mrow><mo>\1</mo>\3<mo>\2</mo></mrow>", text)
    return text


def figure(path: str, caption: str) -> str:
    """A picture with its caption; its file is copied beside the pages."""
    name, caption = html.escape(Path(path).name), html.escape(caption)
    return f'<figure><img src="{name}" alt="{caption}"/><figcaption>{caption}</figcaption></figure>'


def pages_of_manual() -> list[Path]:
    """All pages, in the order of sections."""
    return sorted(MANUAL.glob("*.[1-9]"), key=lambda page: (page.suffix, page.name))


def description_of(page: Path) -> str:
    """The line of its NAME section."""
    return re.search(r"^\.Nd (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)[1]


def navigation(current: str) -> str:
    """Links to all pages."""
    parts = ['<p><a href="index.html">ringpose</a></p>']
    for title, holds in GROUPS:
        links = [
            f'<li><a href="{page.name}.html"{" aria-current=page" if page.name == current else ""}>'
            f"{page.stem.removeprefix('ringpose-')}</a></li>"
            for page in pages_of_manual()
            if holds(page)
        ]
        parts.append(f"<p>{title}</p><ul>{''.join(links)}</ul>")
    return "".join(parts)


def contents_of(body: str) -> str:
    """Links to the sections of a page, and to their parts where they have several."""
    headings = re.findall(r'<h([12]) class="S[hs]" id="([^"]*)"><a[^>]*>(.*?)</a></h', body, re.DOTALL)
    items = [f'<li class="level{level}"><a href="#{place}">{title}</a></li>' for level, place, title in headings]
    return f'<details class="contents"><summary>On this page</summary><ul>{"".join(items)}</ul></details>'


def document(title: str, current: str, body: str) -> str:
    """A whole page."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8"/>
<meta name="viewport" content="width=device-width, initial-scale=1"/>
<title>{html.escape(title)}</title>
<link rel="stylesheet" href="style.css"/>
</head>
<body>
<nav id="pages">{navigation(current)}</nav>
<main>
<p class="top"><a href="index.html">ringpose</a> · <a href="#pages">all pages</a></p>
{body}
</main>
</body>
</html>
"""


def start_page() -> str:
    """All pages with their descriptions."""
    parts = [
        "<h1>ringpose</h1>",
        "<p>Pose of a satellite's launch-adapter ring from one camera and line lasers.</p>",
        figure("examples/console.png", "The console: satellite, ring, light planes and the measurement in progress"),
    ]
    for title, holds in GROUPS:
        rows = [
            f'<dt><a href="{page.name}.html">{page.stem}({page.suffix[1:]})</a></dt>'
            f"<dd>{html.escape(description_of(page).replace(chr(92) + '-', '-'))}</dd>"
            for page in pages_of_manual()
            if holds(page)
        ]
        parts.append(f"<h2>{title}</h2><dl>{''.join(rows)}</dl>")
    return document("ringpose: the manual", "", "".join(parts))


def build(output: Path) -> None:
    """Write all pages into a folder, which is created."""
    output.mkdir(parents=True, exist_ok=True)
    shutil.copy(MANUAL / "html" / "style.css", output)
    for page in pages_of_manual():
        body = body_of(page)
        text = document(f"{page.stem}({page.suffix[1:]})", page.name, contents_of(body) + body)
        (output / f"{page.name}.html").write_text(text, encoding="utf-8")
        for path, _ in FIGURE.findall(page.read_text(encoding="utf-8")):
            shutil.copy(ROOT / path, output)
    shutil.copy(ROOT / "examples" / "console.png", output)
    (output / "index.html").write_text(start_page(), encoding="utf-8")


if __name__ == "__main__":
    build(Path(sys.argv[1]))
