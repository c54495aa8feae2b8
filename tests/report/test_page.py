"""HTML pages: self-contained, texts escaped."""

import base64
import re
import subprocess
import sys
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
from needed import needed_module, needed_program

from ringpose.errors import UsageError
from ringpose.report.figures import canvas, drawn, png_of
from ringpose.report.page import Picture, Section, page, require_matplotlib, verdict_section
from ringpose.report.poses import QUANTITIES, pose_report
from ringpose.types.calibration import Check, Verdict
from ringpose.types.table import Table


class Tags(HTMLParser):
    """Checks that each tag that is opened is closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_texts_are_escaped_and_nothing_is_loaded():
    table = Table(headings=["<i>"], rows=[["1 < 2"]])
    html = page("a < b", [Section(title="c & d", text=["<script>"], points=["first <a>", "second"], table=table)])

    parser = Tags()
    parser.feed(html)
    assert parser.open == []
    assert all(text in parser.text for text in ("a < b", "c & d", "<script>", "<i>", "1 < 2"))
    assert "<ol>\n<li>first &lt;a&gt;</li>\n<li>second</li>\n</ol>" in html
    assert re.findall(r"https?://|<script|<link", html) == []


@pytest.mark.slow
def test_a_page_with_long_words_and_a_wide_table_fits_a_narrow_window(tmp_path):
    path = needed_program("chromium", "chromium")
    api = needed_module("playwright.sync_api", "ringpose[dev]")
    table = Table(headings=[f"column_{n}" for n in range(20)], rows=[[1.0] * 20])
    figure = canvas(8, 1)
    pictures = [Picture(png=png_of(figure), caption="empty")]
    file = tmp_path / "page.html"
    file.write_text(page("t", [Section(title="s", text=["f" * 200], table=table, pictures=pictures)]))

    with api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        shown = browser.new_page(viewport={"width": 400, "height": 800})
        shown.goto(file.as_uri())
        width = shown.evaluate("document.documentElement.scrollWidth")
        browser.close()

    assert width == 400


def test_a_picture_is_inside_the_page():
    figure = canvas(2, 1)
    figure.subplots().plot([0, 1])

    html = page("t", [Section(title="s", pictures=[Picture(png=png_of(figure), caption="a line")])])

    data = re.search(r'src="data:image/png;base64,([^"]+)"', html)
    assert data
    image = cv2.imdecode(np.frombuffer(base64.b64decode(data[1]), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert image.shape == (110, 220)
    assert image.min() < 200


def test_a_verdict_shows_each_number_with_its_limits():
    finding = Check(
        name="tilt_deg", value=5.0, pass_limit=20.0, fail_limit=-np.inf, advice="tilt the board", place="left"
    )

    section = verdict_section(Verdict(findings=(finding,)))

    assert section.title == "Verdict: can be improved"
    assert section.points == ("tilt the board",)
    assert section.table.rows == [["left tilt_deg", "5", "20", "none", "can be improved"]]


def test_a_missing_matplotlib_is_reported_with_its_remedy(monkeypatch):
    monkeypatch.setattr("ringpose.report.page.find_spec", lambda name: None)

    with pytest.raises(UsageError, match=r"matplotlib is not installed; pip install 'ringpose\[report\]'"):
        require_matplotlib()


@pytest.mark.parametrize("name", ["caf\udce9", "$x", "$\\frac$", "_hidden", "日本", "two\nlines"])
def test_names_of_any_letters_are_drawn_and_in_the_legend(name):
    figure = canvas(3, 2)
    axes = figure.subplots()
    axes.plot([0, 1], label=drawn(name))
    axes.set_xticks([0], [drawn(name)])

    legend = figure.legend()
    png_of(figure)

    assert len(legend.get_texts()) == 1


def test_a_page_is_imported_without_matplotlib():
    code = "import sys; sys.modules['matplotlib'] = None; import ringpose.report.page, ringpose.cli.calibrate.outputs"

    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_report_of_no_shots_is_a_page(monkeypatch):
    monkeypatch.setattr("ringpose.report.poses.QUANTITIES", QUANTITIES[:1])  # each has a figure, for 0.2 s

    html = pose_report([], [], "no shots", ["Rig: rig.yaml."])

    assert html.startswith("<!DOCTYPE html>")
    assert "no shots" in html
