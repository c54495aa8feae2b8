"""`ringpose convert-camera`: formats there and back, statuses."""

import numpy as np
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


def test_a_camera_that_went_through_every_format_is_the_same(camera_file):
    before = read_camera(camera_file)
    steps = [("ros", "a.yaml"), ("opencv", "b.xml"), ("matlab", "c.mat"), ("kalibr", "d.yaml")]
    steps += [("opencv", "f.yml"), ("ringpose", "g.yaml")]
    sources = ["rig.yaml", *(name for _, name in steps)]

    statuses = [convert(source, form, name) for source, (form, name) in zip(sources, steps, strict=False)]

    after = read_camera(camera_file.parent / "g.yaml")
    assert set(statuses) == {0}
    np.testing.assert_array_equal(after.camera_matrix, before.camera_matrix)
    np.testing.assert_array_equal(after.distortion_coefficients, before.distortion_coefficients)


def test_an_existing_output_is_replaced_only_with_force(camera_file):
    (camera_file.parent / "a.yaml").write_text("mine")

    assert convert("rig.yaml", "ros", "a.yaml") == 73
    assert (camera_file.parent / "a.yaml").read_text() == "mine"
    assert convert("rig.yaml", "ros", "a.yaml", "--force") == 0


def test_unknown_formats_and_files_without_a_camera_are_rejected(camera_file):
    (camera_file.parent / "a.yaml").write_text("a: 1")

    assert convert("rig.yaml", "excel", "a.xls") == 2
    assert convert("a.yaml", "ros", "b.yaml") == 65
