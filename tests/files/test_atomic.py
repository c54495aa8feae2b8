import os
import signal
import subprocess
import sys
import textwrap

import pytest

from ringpose.errors import CannotCreateError, InputOutputError
from ringpose.files.atomic import replacing


def write(path, content: bytes, force=False, error: Exception | None = None):
    with replacing(path, force) as stream:
        stream.write(content)
        if error is not None:
            raise error


def test_a_written_file_has_the_permissions_of_the_umask(tmp_path):
    write(tmp_path / "a", b"new")

    mask = os.umask(0)
    os.umask(mask)
    assert (tmp_path / "a").stat().st_mode & 0o777 == 0o666 & ~mask


@pytest.mark.parametrize("exists", [True, False])
def test_the_target_of_a_symbolic_link_is_written(tmp_path, exists):
    if exists:
        (tmp_path / "a").write_bytes(b"old")
    (tmp_path / "link").symlink_to("a")

    write(tmp_path / "link", b"new", force=exists)

    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "a").read_bytes() == b"new"


@pytest.mark.parametrize(
    ("name", "finding"),
    [
        (300 * "a", "file name too long"),
        ("link", "link"),
        (".", "is a folder"),
        ("file/a", "cannot be written"),
        ("missing/a", "cannot be written"),
    ],
)
def test_a_file_that_cannot_be_created_is_an_error_even_with_force(tmp_path, name, finding):
    (tmp_path / "link").symlink_to("link")
    (tmp_path / "file").touch()

    with pytest.raises(CannotCreateError, match=finding):
        write(tmp_path / name, b"new", force=True)


def test_pipe_is_not_replaced_even_with_force(tmp_path):
    os.mkfifo(tmp_path / "pipe")

    with pytest.raises(CannotCreateError, match="is a device or a pipe, must be a file"):
        write(tmp_path / "pipe", b"new", force=True)

    assert (tmp_path / "pipe").is_fifo()


@pytest.mark.parametrize(
    ("error", "raised", "finding"),
    [
        (ZeroDivisionError(), ZeroDivisionError, None),
        (OSError(28, "No space left on device"), InputOutputError, "writing broke off: no space left on device"),
    ],
)
def test_a_failure_keeps_the_old_file_and_leaves_no_temporary_one(tmp_path, error, raised, finding):
    (tmp_path / "a").write_bytes(b"old")

    with pytest.raises(raised, match=finding):
        write(tmp_path / "a", b"half", force=True, error=error)

    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"old"}


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_killed_process_leaves_no_incomplete_file_under_the_final_name(tmp_path, number):
    program = textwrap.dedent(
        """
        import sys, time
        from pathlib import Path
        from ringpose.files.atomic import replacing
        with replacing(Path(sys.argv[1]), False) as stream:
            stream.write(b"half"); stream.flush(); print("now", flush=True); time.sleep(600)
        """
    )
    with subprocess.Popen([sys.executable, "-c", program, str(tmp_path / "a")], stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        process.send_signal(number)

    assert not (tmp_path / "a").exists()
