"""What a test needs and the machine lacks: skipped on a developer's machine, failed in CI."""

import pytest
from needed import missing, needed_module, needed_program

IN_CI, AT_A_DESK = pytest.fail.Exception, pytest.skip.Exception


@pytest.fixture(params=["1", ""], ids=["in CI", "at a desk"])
def outcome(request, monkeypatch) -> type[BaseException]:
    """The outcome of a test that lacks something."""
    monkeypatch.setenv("CI", request.param)
    return IN_CI if request.param else AT_A_DESK


@pytest.mark.parametrize("name", ["chromium", "mandoc"])
def test_a_program_that_is_not_on_the_path_is_named_with_its_package(outcome, monkeypatch, tmp_path, name):
    monkeypatch.setenv("PATH", str(tmp_path))

    with pytest.raises(outcome, match=rf"^{name} is not installed \(apt install its-package\)$"):
        needed_program(name, "its-package")


def test_a_program_on_the_path_is_found(outcome, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    program = tmp_path / "mandoc"
    program.touch(mode=0o755)

    assert needed_program("mandoc", "mandoc") == str(program)


def test_a_module_that_is_not_installed_is_named_with_its_package(outcome):
    with pytest.raises(outcome, match=r"^absent_module is not installed \(pip install 'its-package'\)$"):
        needed_module("absent_module", "its-package")


def test_a_module_that_is_installed_and_broken_is_an_error_everywhere(outcome, monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "broken_module.py").write_text("import absent_module\n")

    with pytest.raises(ImportError, match="absent_module"):
        needed_module("broken_module", "its-package")


def test_what_may_be_absent_in_ci_is_skipped_there(outcome):
    with pytest.raises(AT_A_DESK, match=r"^no shared data$"):
        missing("no shared data", allowed=True)
