"""The commands of examples/cron have options that exist, and the units name each other."""

import re
import shlex
from importlib import import_module
from pathlib import Path

import typer

from ringpose.cli.app import app
from ringpose.cli.main import COMMANDS

CRON = Path(__file__).parents[1] / "examples" / "cron"


def commands():
    lines = [*(CRON / "crontab").read_text().splitlines(), *(CRON / "ringpose-study.service").read_text().splitlines()]
    return [shlex.split(line[line.index("ringpose bench") :]) for line in lines if "ringpose bench" in line]


def test_every_option_of_the_commands_exists():
    import_module(f"ringpose.cli.{COMMANDS['bench']}")
    known = typer.main.get_command(app).commands

    assert len(commands()) == 3
    for words in commands():
        name = "bench study" if words[2] == "study" else "bench"
        options = {option for parameter in known[name].params for option in parameter.opts}
        assert {word for word in words if word.startswith("-")} <= options


def test_the_timer_starts_the_service_of_its_name():
    names = {path.stem for path in CRON.iterdir() if path.suffix in (".timer", ".service")}

    assert names == {"ringpose-study"}
    assert re.search(r"^OnCalendar=", (CRON / "ringpose-study.timer").read_text(), re.MULTILINE)
