"""`ringpose convert-camera`: formats there and back, statuses."""

import pytest

from ringpose.cli.main import main
from ringpose.files.cameras.formats import read_camera


@pytest.fixture
def camera_file(carried_data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_bytes((carried_data / "rig_b" / "rig.yaml").read_bytes())
    return tmp_path / "rig.yaml"


def convert(source: str, form: str, output: str, *words: str) -> int:
    return main(["convert-camera", source, "--format", form, "--output", output, *words])


def test_an_existing_output_is_replaced_only_with_force(camera_file):
    (camera_file.parent / "a.yaml").write_text("mine")

    assert convert("rig.yaml", "ros", "a.yaml") == 73
    assert (camera_file.parent / "a.yaml").read_text() == "mine"
    assert convert("rig.yaml", "ros", "a.yaml", "--force") == 0
    assert read_camera(camera_file.parent / "a.yaml").image_width == read_camera(camera_file).image_width


def test_unknown_formats_and_files_without_a_camera_are_rejected(camera_file):
    (camera_file.parent / "a.yaml").write_text("a: 1")

    assert convert("rig.yaml", "excel", "a.xls") == 2
    assert convert("a.yaml", "ros", "b.yaml") == 65
