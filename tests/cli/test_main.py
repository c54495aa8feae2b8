import os
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from ringpose.cli.main import COMMANDS, main


def test_version_is_printed(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"ringpose {version('ringpose')}\n"


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted by Linux's /proc")
def test_linear_algebra_has_one_thread():
    code = (
        "import os, sys; from ringpose.cli import main\n"
        "sys.argv = ['ringpose', '--version']\n"
        "try: main.run()\n"
        "except SystemExit: import numpy; print(len(os.listdir('/proc/self/task')))"
    )
    environment = {name: value for name, value in os.environ.items() if not name.endswith("NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)

    assert done.stdout.splitlines()[1:] == ["1"]


def test_no_words_are_wrong_usage_and_get_the_help(capsys):
    assert main([]) == 2

    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Commands:" in captured.err


def test_messages_name_the_command_and_on_request_the_time(run):
    words = ["pose", "never-read.png", "--rig", "none.yaml"]

    for more, begin in (([], ""), (["--log-times"], r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z "), ([], "")):
        (message,) = run(*words, *more).messages
        assert re.fullmatch(f"{begin}ringpose pose: none.yaml: does not exist", message)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--nonsense"], "ringpose: No such option: --nonsense; see ringpose --help\n"),
        (["nonsense"], "ringpose: No such command 'nonsense'; see ringpose --help\n"),
        (["pose"], "see ringpose pose --help\n"),
        (["pose", "-", "--rig"], "ringpose pose: Option '--rig' requires an argument; see ringpose --help\n"),
        (["detect", "-", "--jobs", "1.5"], "'1.5' is not a whole number; see ringpose detect --help\n"),
        (["track", "-", "--rate", "x"], "'x' is not a number; see ringpose track --help\n"),
        (["pose", "-", "--rig", "rig.yaml", "--method", "guess"], "see ringpose pose --help\n"),
        (["detect", "a.png"], "ringpose detect: --rig is missing; give --rig FILE, or --segments-only for any image\n"),
    ],
)
def test_wrong_words_are_one_line(capsys, words, message):
    assert main(words) == 2

    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.endswith(message)
    assert captured.err.count("\n") == 1


@pytest.mark.parametrize("command", ["detect", "pose"])
def test_every_command_has_its_help(capsys, command):
    assert main([command, "--help"]) == 0
    assert f"Usage: ringpose {command}" in capsys.readouterr().out


def test_the_help_says_in_full_what_each_command_does(run):
    said = " ".join(" ".join(run("--help").out).split())
    assert "..." not in said.partition("Commands:")[2]
    assert "track Track a moving ring through pose records: one JSON record a measurement, or --rate a second." in said


def test_options_are_listed_by_purpose_and_each_once(run):
    lines = run("pose", "--help").out
    titles = [line.removesuffix(":") for line in lines if re.fullmatch(r"\w.*:", line)]
    options = [line.split()[0] for line in lines[lines.index("Options:") :] if line.startswith("  -")]
    assert titles[:2] == ["Arguments", "Options"]
    detect = run("detect", "--help").out
    assert detect.index("Output:") < next(k for k, line in enumerate(detect) if line.startswith("  --points"))
    assert {"What is assumed", "Robot", "Track", "Output"} < set(titles)
    assert len(options) == len(set(options))
    assert lines.index("What is assumed:") < lines.index(
        "  --still                 The target does not move within a shot."
    )


@pytest.mark.parametrize(
    "command",
    ["pose", "detect", "track", "view", "simulate", "simulate console", "bench study", "bench design"]
    + [f"calibrate-{each}" for each in ("camera", "planes", "mount")],
)
def test_options_that_name_outputs_are_listed_together(run, command):
    lines = run(*command.split(), "--help").out
    output = {line.split()[0] for line in lines[lines.index("Output:") :] if line.startswith("  -")}
    options = {line.split()[0] for line in lines if re.match(r"  -.* (FILE|DIR) ", f"{line} ")}
    written = {"-o,", "--overlay", "--report", "--html", "--csv"} & options
    assert written
    assert written | {"--force"} <= output


@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        (["ringpose", "si"], ["simulate"]),
        (["ringpose", "pose", "--rin"], ["--ring", "--rings", "--ring-tolerance"]),
        (["ringpose", "pose", "--frame", ""], ["camera", "tool", "base"]),
    ],
)
def test_a_shell_completes_commands_options_and_values(run, monkeypatch, typed, completed):
    monkeypatch.setenv("_RINGPOSE_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", " ".join(typed))
    monkeypatch.setenv("COMP_CWORD", str(len(typed) - 1))

    shown = run()

    assert (shown.status, shown.out) == (0, completed)


@pytest.mark.parametrize("word", ["nan", "inf"])
@pytest.mark.parametrize(
    "words",
    [
        ["capture", "--camera", "files:.", "--rate"],
        ["capture", "--camera", "files:.", "--duration"],
        ["calibrate-planes", "--board", "board.yaml", "--surround"],
        ["simulate", "serve", "--scene", "scene.yaml", "--after"],
        ["bench", "poses.jsonl", "--max-center-mm"],
    ],
)
def test_numbers_that_are_not_finite_are_refused(words, word, capsys):
    status = main([*words, word])

    assert status == 2
    assert f"'{words[-1]}': {word} is not a finite number; see ringpose {words[0]}" in capsys.readouterr().err


HEAVY = ("numpy", "cv2", "scipy", "yaml", "rich", "jaxtyping", "pydantic")


def test_help_imports_nothing_heavy(started):
    every = f"""
import sys
from ringpose.cli.main import COMMANDS, main
for command in COMMANDS:
    print(command, main([command, "--help"]), *sys.modules.keys() & set({HEAVY!r}), file=sys.stderr)
"""
    with started("--version", before=every) as process:
        _, said = process.communicate(timeout=600)

    assert said.splitlines() == [f"{command} 0" for command in COMMANDS]


RENDERED = Path(__file__).parents[1] / "data" / "rig_b"
NEEDLESS = (
    *("scipy", "rich", "jaxtyping", "pydantic", "asyncio", "unittest", "numpy.ma", "importlib.metadata", "tempfile"),
    *(
        "ringpose.detect.line_segments",
        "ringpose.pose.closed_form",
        "ringpose.pose.transform",
        "ringpose.files.cameras.matlab",
    ),
)


def test_a_shot_imports_nothing_that_its_line_does_not_need(started):
    words = [str(next(RENDERED.rglob("*.npz"))), "--rig", str(RENDERED / "rig.yaml")]
    detected = f"""
import atexit, sys
from ringpose.cli.main import main
atexit.register(lambda: print(*sys.modules.keys() & set({NEEDLESS!r}), file=sys.stderr))
main(["detect", *{words}])
"""
    with started("pose", *words, before=detected) as process:
        printed, said = process.communicate(timeout=600)

    assert (process.returncode, said.split(), printed.count("\n")) == (0, [], 2)


@pytest.mark.parametrize(("interrupted", "printed"), [(True, b""), (False, b"AttributeError")])
def test_an_object_whose_constructor_a_signal_interrupts_leaves_no_message(interrupted, printed):
    program = f"""
import os, signal
from ringpose.cli.main import Interrupts, raise_signals
from ringpose.errors import SignalReceived

class Archive:
    def __init__(self):
        if {interrupted}:
            os.kill(os.getpid(), signal.SIGTERM)
    def __del__(self):
        self.absent

raise_signals(Interrupts())
try:
    Archive()
except SignalReceived:
    pass
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)

    assert printed in done.stderr
    assert bool(done.stderr) is not interrupted


def test_a_module_whose_byte_code_is_cut_off_is_an_error_with_its_place(monkeypatch):
    def loaded(*_):
        raise EOFError("marshal data too short")

    monkeypatch.setattr("ringpose.files.records.write_text", loaded)

    with pytest.raises(EOFError, match="marshal"):
        main(["schema"])
