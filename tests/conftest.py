"""Fixtures for all tests: seeded generators, the shared data, floating-point traps."""

import gc
import os
import shutil
import signal
import socket
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shape_checks
from hypothesis import HealthCheck, settings
from needed import missing

os.environ.setdefault("OPENCV_FOR_THREADS_NUM", "1")  # its threads mostly wait for each other beside other tests

gc.disable()  # until the tests are collected: going through the modules, which stay, takes a tenth of the time

_TIMED = [HealthCheck.too_slow]  # says how busy the machine is
settings.register_profile("ringpose", derandomize=True, deadline=None, max_examples=50, suppress_health_check=_TIMED)
settings.register_profile("fast", settings.get_profile("ringpose"), max_examples=10)
settings.load_profile("ringpose")

for _number in (signal.SIGINT, signal.SIGHUP):  # inherited as ignored from nohup or a background job
    if signal.getsignal(_number) == signal.SIG_IGN:
        signal.signal(_number, signal.SIG_DFL)

CARRIED_DATA = Path(__file__).parent / "data"
EXAMPLES = Path(__file__).parents[1] / "examples"
SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A generator seeded by the test's own name."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))


@pytest.fixture(autouse=True)
def _floating_point_traps() -> Iterator[None]:
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        yield


@pytest.fixture(scope="session")
def shared_data(request: pytest.FixtureRequest) -> Path:
    """The folder of photographs and rendered shots from outside the project."""
    if not SHARED_DATA.is_dir():
        missing(f"the shared data are not at {SHARED_DATA}", allowed=request.config.getoption("--without-shared-data"))
    return SHARED_DATA


@pytest.fixture(scope="session")
def rig_of_rendered_boards(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Path of a rig.yaml calibrated by the commands from the rendered boards (calib_b)."""
    from ringpose.cli.main import main

    boards = shared_data / "rendered" / "calib_b"
    folder = tmp_path_factory.mktemp("rendered_boards")
    camera, rig = str(folder / "camera.yaml"), folder / "rig.yaml"
    board = ["--board", str(boards / "camera_board.yaml")]
    main(["calibrate-camera", str(boards / "camera"), *board, "--output", camera])
    board = ["--board", str(boards / "plane_board.yaml")]
    main(["calibrate-planes", str(boards / "planes"), *board, "--camera", camera, "--output", str(rig)])
    return rig


@pytest.fixture(scope="session")
def carried_data() -> Path:
    """The rendered shots and board views in the repository (tests/data/README.md)."""
    return CARRIED_DATA


@pytest.fixture
def loopback_address(request: pytest.FixtureRequest) -> str:
    """A loopback address used by this test process only, since the port of GigE cameras is fixed."""
    name = zlib.crc32(f"{request.node.nodeid} {os.getpid()}".encode())
    return f"127.{1 + (name >> 16) % 254}.{(name >> 8) & 0xFF}.{1 + name % 254}"


@pytest.fixture(scope="session")
def _aravis() -> None:
    """Skip tests of a library that is not installed; in CI, fail."""
    from ringpose.capture.cameras.aravis_library import PACKAGE, library

    if library() is None:
        missing(f"libaravis is not installed (apt install {PACKAGE})")


@pytest.fixture(scope="session")
def forker() -> Iterator[socket.socket]:
    """A process that has imported the command and forks for each job."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    # a signal may arrive between the opening of a file and its `with` block
    flags = ("-W", "error", "-W", "ignore::ResourceWarning")
    words = [sys.executable, *flags, str(Path(__file__).with_name("forker.py")), str(theirs.fileno())]
    with subprocess.Popen(words, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL):
        theirs.close()
        yield ours
        ours.close()


@pytest.fixture(autouse=True, scope="session")
def _commands_built_once() -> Iterator[None]:
    """Build what parses the command lines once, not at each of some 900 calls of `main`: 12 ms of CPU time each.

    A process of a user builds its own command only, once. A module that is imported later adds its command.
    """
    import typer.main

    build, built = typer.main.get_command, {}

    def once(app: typer.Typer) -> Any:
        key = (app, len(app.registered_commands))
        if key not in built:
            built[key] = build(app)
        return built[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", once)
        yield


@pytest.fixture
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder of this test, with nothing in it."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def example_folder(tmp_path: Path, carried_data: Path) -> Path:
    """A working folder as the manual and the examples assume: a rig, shots with truth, board views, a scene.

    The scene has half of the example's board views, which take most of the time to simulate it.
    """
    for source in (carried_data / "rig_b", carried_data / "calib_b"):
        shutil.copytree(source, tmp_path, dirs_exist_ok=True)
    shutil.copytree(carried_data / "rig_b", tmp_path / "data_set")
    shutil.copy(EXAMPLES / "scene-rig.yaml", tmp_path)
    scene = (EXAMPLES / "scene.yaml").read_text()
    (tmp_path / "scene.yaml").write_text(
        scene.replace("{count: 12,", "{count: 7,").replace("{count: 10,", "{count: 4,")
    )
    return tmp_path


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One for each core: each process more imports and collects all tests again, 5 s of CPU time."""
    return min(8, os.cpu_count() or 1)


@pytest.hookimpl(trylast=True)  # without those that -m and -k leave out
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Let each worker begin with tests of whole jobs: some take minutes, for which the others would wait at the end."""
    workers = getattr(config, "workerinput", {}).get("workercount", 1)
    jobs = [item for item in items if item.path.parent == Path(__file__).parent]
    parts = [item for item in items if item.path.parent != Path(__file__).parent]
    share = -(-len(parts) // workers)
    items[:] = [
        item
        for worker in range(workers)
        for item in (*jobs[worker::workers], *parts[worker * share : (worker + 1) * share])
    ]


def pytest_collection_finish() -> None:
    """Let no later garbage collection go through what the test modules hold: a million objects, for good."""
    gc.freeze()
    gc.enable()
    gc.set_threshold(100_000)  # as the command does


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Run before all fixtures of the test."""
    shape_checks.begin()


def pytest_configure(config: pytest.Config) -> None:
    """Draw fewer examples where shapes are not checked either, in `make test`: the other runs have them all."""
    if not config.getoption("jaxtyping_packages"):
        settings.load_profile("fast")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--without-shared-data", action="store_true", help="skip, even in CI, what needs the shared data")
