"""`ringpose help`: every page, with and without a program that shows manual pages."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from needed import needed_program

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "man").glob("*.[1-9]"))


@pytest.fixture
def programs(tmp_path, monkeypatch) -> Path:
    """The only folder of the path, and empty: there is no man."""
    folder = tmp_path / "bin"
    folder.mkdir()
    monkeypatch.setenv("PATH", str(folder))
    return folder


def description_of(page: Path) -> str:
    return re.search(r"^\.Nd (.*)", page.read_text(), re.MULTILINE)[1]


def program(folder: Path, name: str, *lines: str) -> None:
    path = folder / name
    path.write_text("\n".join(["#!/bin/sh", *lines, ""]))
    path.chmod(0o755)


def test_without_a_topic_every_page_is_listed_with_its_description(run):
    listed = run("help").out

    for page in PAGES:
        topic = page.stem.removeprefix("ringpose-")
        assert any(line.split() == [topic, *description_of(page).split()] for line in listed), page.name


@pytest.mark.parametrize(
    "page",
    [*PAGES[::5], *(pytest.param(page, marks=pytest.mark.slow) for page in PAGES if page not in PAGES[::5])],
    ids=lambda page: page.name,
)
def test_without_man_a_page_is_the_text_that_mandoc_formats(run, monkeypatch, page):
    command = [needed_program("mandoc", "mandoc"), "-T", "utf8", page]
    formatted = re.sub(".\b", "", subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    monkeypatch.setenv("PATH", "")

    shown = run("help", page.stem)

    _, *expected, _ = formatted.strip().splitlines()  # between the lines with the title and the date
    assert shown.status == 0
    assert "".join("".join(shown.out[1:]).split()) == "".join("".join(expected).split())


@pytest.mark.parametrize("words", [["pose"], ["ringpose-pose"], ["ringpose-pose.1"], ["pose.1"]])
def test_a_page_has_several_names(run, programs, words):
    assert "compute the pose of the ring" in " ".join(run("help", *words).out[:6])


def test_a_command_of_two_words_is_in_the_page_of_the_first(run, programs):
    assert run("help", "simulate", "serve").out == run("help", "simulate").out


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["pos"], "did you mean 'pose'?"),
        (["quantum"], "ringpose help"),
        (["bench", "x", "y"], ""),
        (["pose", "limits"], ""),
    ],
)
def test_an_unknown_topic_is_a_usage_error_with_a_remedy(run, words, remedy):
    shown = run("help", *words)

    assert (shown.status, shown.out, len(shown.messages)) == (2, [], 1)
    assert remedy in shown.messages[0]


@pytest.mark.parametrize("viewer", ["man", "mandoc"])
def test_the_installed_viewer_is_given_the_file(run, programs, tmp_path, viewer):
    program(programs, viewer, f'for last; do :; done; echo "$last" > {tmp_path}/shown')

    shown = run("help", "pose")

    assert (shown.status, shown.out) == (0, [])
    assert Path((tmp_path / "shown").read_text().strip()).name == "ringpose-pose.1"


def test_a_man_that_cannot_show_the_page_is_replaced_by_text(run, programs):
    program(programs, "man", "exit 16")

    shown = run("help", "pose")

    assert shown.status == 0
    assert "compute the pose of the ring" in " ".join(shown.out[:6])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_is_packaged_in_the_folder_of_its_section(page):
    data_files = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["data-files"]

    patterns = data_files[f"share/man/man{page.suffix[1:]}"]
    assert any(page in ROOT.glob(pattern) for pattern in patterns)


@pytest.mark.slow
def test_man_finds_the_pages_of_an_installed_wheel(tmp_path):
    tracked = subprocess.run(["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, capture_output=True, text=True)
    for name in tracked.stdout.splitlines():
        if not name.startswith("tests/") and (ROOT / name).is_file():
            (tmp_path / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / "source" / name).write_bytes((ROOT / name).read_bytes())
    python = tmp_path / "venv" / "bin" / "python"
    subprocess.run(["python3", "-m", "venv", tmp_path / "venv"], check=True)
    subprocess.run([python, "-m", "pip", "install", "--quiet", "--no-deps", tmp_path / "source"], check=True)

    for page in PAGES:
        command = [needed_program("man", "man-db"), "-M", tmp_path / "venv" / "share" / "man", "-w", page.stem]
        assert Path(subprocess.run(command, capture_output=True, text=True).stdout.strip()).name == page.name
