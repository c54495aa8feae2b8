"""The manual says what the program does: options both ways, exit statuses, examples that run."""

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import typer
from needed import needed_program

from ringpose import errors
from ringpose.cli.app import app
from ringpose.cli.main import COMMANDS
from ringpose.types.detection import NoBreakPoints
from ringpose.types.pose import NoPose, PoseFlag

MANUAL = Path(__file__).parents[1] / "man"
PAGES = sorted(MANUAL.glob("*.[1-9]"))
COMMAND_PAGES = {name: MANUAL / f"ringpose-{name}.1" for name in COMMANDS}
ESCAPES = {r"\&": "", r"\-": "-", r"\e": "\\", r"\(dq": '"', r"\(aq": "'"}


def options_of_command(name: str) -> set[str]:
    """What the command line takes, with and without a second spelling; with it commands of two words."""
    for module in COMMANDS.values():
        import_module(f"ringpose.cli.{module}")
    group = typer.main.get_command(app)
    every = group.commands.items()
    parameters = [param for words, command in every if words.split()[0] == name for param in command.params]
    spellings = [opt for param in parameters for opt in (*param.opts, *param.secondary_opts)]
    return {opt for opt in spellings if opt.startswith("-")} | {"-h", "--help"}


def options_in(text: str) -> set[str]:
    """`Fl Fl name` and `Fl n` of mdoc."""
    return {f"--{name}" for name in re.findall(r"\bFl Fl ([\w-]+)", text)} | {
        f"-{name}" for name in re.findall(r"\bFl (?!Fl\b)(\w)\b", text)
    }


def items_of(page: Path) -> str:
    return "\n".join(line for line in page.read_text().splitlines() if line.startswith(".It"))


def section_of(page: Path, name: str) -> str:
    found = re.search(rf"^\.Sh {name}\n(.*?)(?=^\.Sh |\Z)", page.read_text(), re.DOTALL | re.MULTILINE)
    assert found, f"{page.name} has no {name}"
    return found[1]


def examples_of(page: Path) -> list[str]:
    """Commands after `$ ` in literal displays; a line that ends with | or a backslash goes on in the next."""
    commands: list[str] = []
    for block in re.findall(r"^\.Bd -literal[^\n]*\n(.*?)^\.Ed", page.read_text(), re.DOTALL | re.MULTILINE):
        for mark, character in ESCAPES.items():
            block = block.replace(mark, character)
        commands += re.findall(r"^\$ ((?:[^\n]*[|\\]\n)*[^\n]*)", block, re.MULTILINE)
    return commands


@pytest.fixture
def run_in_example_folder(example_folder):
    """Run a shell command as a user would; bash, so that a status is not lost in a pipe."""

    def run(command: str) -> subprocess.CompletedProcess[str]:
        environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
        return subprocess.run(
            ["bash", "-c", f"set -euo pipefail\n{command}"],
            cwd=example_folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=1200,
        )

    return run


@pytest.mark.parametrize("name", COMMAND_PAGES)
def test_every_option_of_a_command_stands_in_its_page(name):
    assert options_of_command(name) - options_in(items_of(COMMAND_PAGES[name])) == set()


@pytest.mark.parametrize("name", COMMAND_PAGES)
def test_every_option_in_a_page_exists(name):
    assert options_in(COMMAND_PAGES[name].read_text()) - options_of_command(name) == set()


SECTIONS = {"5", "7"}
"""Of the manual, to which pages refer beside the exit statuses."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_exit_statuses_in_a_page_exist(page):
    known = {"0", "1", "3", "129", "130", "141", "143"} | {
        str(kind.status) for kind in errors.RingposeError.__subclasses__()
    }
    mentioned = (
        set(re.findall(r"\b\d+\b", section_of(page, "EXIT STATUS"))) if "EXIT STATUS" in page.read_text() else set()
    )

    assert {number for number in mentioned if int(number) < 256} - known - SECTIONS == set()


def test_the_conventions_list_every_status_that_an_error_has():
    listed = set(
        re.findall(
            r"\d+",
            "\n".join(
                re.findall(
                    r"^\.It ([\d, ]+)$", section_of(MANUAL / "ringpose-conventions.7", "EXIT STATUS"), re.MULTILINE
                )
            ),
        )
    )

    kinds = errors.RingposeError.__subclasses__()
    signals = {str(128 + number) for number in (1, 2, 13, 15)}
    assert listed == {"0", "1", str(errors.NO_POSE)} | {str(kind.status) for kind in kinds} | signals


@pytest.mark.parametrize("name", COMMAND_PAGES)
def test_every_command_has_an_example(name):
    assert examples_of(COMMAND_PAGES[name]) != []


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if page.stem != "ringpose-quickstart" and examples_of(page)],  # it has a test of its own
    ids=lambda page: page.name,
)
def test_the_examples_of_a_page_run(page, run_in_example_folder):
    results = [(command, run_in_example_folder(command)) for command in examples_of(page)]

    failed = [(command, done.returncode, done.stderr) for command, done in results if done.returncode]
    assert failed == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_is_clean_mdoc(page):
    done = subprocess.run(
        [needed_program("mandoc", "mandoc"), "-T", "lint", "-W", "warning", page], capture_output=True, text=True
    )

    assert done.stdout == ""


def wide_tables(page: Path) -> list[str]:
    """Rows of tables whose cells do not fit into their columns, or leave less than 20 of 80 characters to the last."""
    found = []
    for head, rows in re.findall(r"^\.Bl (-column [^\n]*)\n(.*?)^\.El", page.read_text(), re.DOTALL | re.MULTILINE):
        widths = [len(width) for width in re.findall(r'"([^"]*)"', head)][:-1]
        for row in re.findall(r"^\.It (.*)", rows, re.MULTILINE):
            plain = re.sub(r"(?<!\S)(?:Em|Va|Cm|Li|No|Fl|Ar) ", "", row)
            *cells, last = [cell.strip() for cell in plain.split("Ta ")]
            is_cut = any(len(cell) > width for cell, width in zip(cells, widths, strict=True))
            if is_cut or sum(widths) + min(len(last), 20) > 65:
                found.append(row)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_fit_into_80_columns(page):
    assert wide_tables(page) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pages_that_are_referred_to_exist(page):
    referred = re.findall(r"^\.Xr (ringpose\S*) (\d)", page.read_text(), re.MULTILINE)

    assert [f"{name}.{number}" for name, number in referred if not (MANUAL / f"{name}.{number}").exists()] == []


def test_paths_that_the_page_on_extending_names_exist():
    root = MANUAL.parent
    paths = re.findall(r"^\.(?:Pa|Pq Pa) ([\w/.]+)", (MANUAL / "ringpose-extending.7").read_text(), re.MULTILINE)

    assert len(paths) > 15
    missing = [path for path in paths if "/" in path and not (root / path.rstrip(":,;")).exists()]
    assert missing == []


TROUBLESHOOTING = MANUAL / "ringpose-troubleshooting.7"


def messages_explained() -> list[str]:
    return re.findall(r'^\.It Li "(.*)"$', TROUBLESHOOTING.read_text(), re.MULTILINE)


@pytest.mark.parametrize("reasons", [NoBreakPoints, NoPose])
def test_every_reason_for_no_pose_is_explained(reasons):
    assert {reason.value for reason in reasons} - set(messages_explained()) == set()


def test_every_message_that_is_explained_stands_in_the_source():
    sources = [path.read_text() for path in sorted((MANUAL.parent / "ringpose").rglob("*.py"))]
    texts = re.sub(r'"\s*\n\s*f?"', "", "\n".join(sources)).replace('\\"', '"')

    parts = [
        part.strip(" :") for message in messages_explained() for part in message.split("...") if part.strip(" :()")
    ]
    assert [part for part in parts if part.removeprefix("standard input ") not in texts] == []


def test_every_flag_is_in_the_page_on_troubleshooting():
    text = TROUBLESHOOTING.read_text()

    assert [flag.name for flag in PoseFlag if str(flag.name).lower() not in text] == []
