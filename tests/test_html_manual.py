"""The manual as HTML: every page is there, every link and picture exists, equations are typeset."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from needed import needed_program

MANUAL = Path(__file__).parents[1] / "man"


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    needed_program("mandoc", "mandoc")
    folder = tmp_path_factory.mktemp("manual")
    subprocess.run([sys.executable, MANUAL / "html" / "build.py", folder], check=True)
    return folder


def test_every_page_is_linked_from_the_start_page(built):
    linked = set(re.findall(r'href="([^"#]*)"', (built / "index.html").read_text()))

    assert {f"{page.name}.html" for page in MANUAL.glob("*.[1-9]")} - linked == set()


def test_every_link_and_picture_exists(built):
    for page in built.glob("*.html"):
        text = page.read_text()
        places = set(re.findall(r'\bid="([^"]*)"', text))
        for target in re.findall(r'(?:href|src)="([^"]*)"', text):
            file, _, place = target.partition("#")
            assert (built / file).exists() if file else place in places, (page.name, target)


def test_equations_are_typeset_and_no_mark_remains(built):
    texts = [page.read_text() for page in built.glob("*.html")]

    stated = sum(page.read_text().count('.\\" equation: ') for page in MANUAL.glob("*.[157]"))
    assert sum(text.count("<math") for text in texts) == stated > 0
    assert not any("mfenced" in text or "<merror" in text for text in texts)
    assert not any("PICTURE-GOES-HERE" in text for text in texts)
