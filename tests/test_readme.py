"""The README: short, its links lead somewhere, its commands print what it shows."""

import json
import os
import re
import shutil
import subprocess
import sys
from decimal import Decimal
from pathlib import Path

import pytest
from needed import needed_program

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
MAX_BYTES = 8000


def blocks_of(text: str) -> list[str]:
    """Indented code blocks that stand after a blank line."""
    return [re.sub(r"^    ", "", block, flags=re.MULTILINE) for block in re.findall(r"(?<=\n\n)(?:    .*\n)+", text)]


def about(shown):
    """What a printed value must equal if the README shows this one, rounded."""
    if isinstance(shown, list):
        return [about(each) for each in shown]
    if isinstance(shown, Decimal):
        return pytest.approx(float(shown), abs=0.6 * 10.0 ** shown.as_tuple().exponent)
    return shown


def test_it_is_short():
    assert len(README.read_bytes()) <= MAX_BYTES


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md"])
def test_links_lead_to_files(page):
    links = re.findall(r"\]\(([^)#:]+)\)", (ROOT / page).read_text())

    assert len(links) > 3
    assert [link for link in links if not (ROOT / link).exists()] == []


@pytest.mark.slow
def test_the_pipeline_prints_the_lines_that_are_shown(tmp_path):
    needed_program("jq", "jq")
    blocks = blocks_of(README.read_text())
    (command,) = [block for block in blocks if block.startswith("ringpose capture --camera files:")]
    (lines,) = [block for block in blocks if block.startswith('{"shot"')]
    shutil.copytree(ROOT / "tests" / "data" / "rig_b", tmp_path / "tests" / "data" / "rig_b")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}

    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, env=environment, capture_output=True, text=True)

    assert done.returncode == 0, done.stderr
    shown = [json.loads(line, parse_float=Decimal) for line in lines.splitlines()]
    printed = [json.loads(line) for line in done.stdout.splitlines()]
    assert [list(line) for line in printed] == [list(line) for line in shown]
    assert [list(line.values()) for line in printed] == [about(list(line.values())) for line in shown]
